"""What the coefficients of conjugate gradients tell about the matrix."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

__all__ = ["RitzValue"]


@dataclass(eq=False)
class RitzValue:
    """Smallest Ritz value of a run of conjugate gradients.

    The coefficients of the iteration are those of the Lanczos process: its smallest Ritz value falls to the
    smallest eigenvalue that takes part, usually long before the iteration converges.

    Attributes
    ----------
    steps, ratios : list of float
        Length of each step, and r·r after it over that before.
    least : float
        The value when it was last :meth:`refresh`-ed; at most too large.
    """

    steps: list[float] = field(default_factory=list)
    ratios: list[float] = field(default_factory=list)
    least: float = np.inf
    _at: int = 0

    def add(self, step: float, ratio: float) -> None:
        """Take the coefficients of an iteration."""
        self.steps.append(step)
        self.ratios.append(ratio)

    def restart(self) -> None:
        """Begin with a new run of the same matrix; what is known of the value is kept."""
        self.steps, self.ratios, self._at = [], [], 0

    def refresh(self) -> float:
        """The value with all iterations so far; infinite without any."""
        if self.steps and self._at != len(self.steps):
            from scipy.linalg import eigvalsh_tridiagonal

            inverse, ratios = 1.0 / np.array(self.steps), np.array(self.ratios[:-1])
            diagonal, beside = inverse.copy(), np.sqrt(ratios) * inverse[:-1]
            diagonal[1:] += ratios * inverse[:-1]
            lowest = eigvalsh_tridiagonal(diagonal, beside, select="i", select_range=(0, 0))[0]
            self.least, self._at = min(self.least, float(lowest)), len(self.steps)
        return self.least
