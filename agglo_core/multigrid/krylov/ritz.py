"""What the coefficients of conjugate gradients tell about the matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np


@dataclass(eq=False)
class RitzValue:
    """Smallest eigenvalue that takes part in a run of conjugate gradients, as the run sees it.

    The coefficients of the iteration are those of the Lanczos process, whose smallest Ritz value falls to
    that eigenvalue. What it fell by in the latter half of the iterations it is taken to fall by once more.

    Attributes
    ----------
    steps, ratios : list of float
        Length of each step, and r·r after it over that before.
    least : float
        The value when it was last asked for by :meth:`refresh`.
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
        count = len(self.steps)
        if count != self._at:
            lowest, before = (
                _lowest(self.steps[:n], self.ratios[: n - 1]) for n in (count, (count + 1) // 2)
            )
            self.least, self._at = min(self.least, lowest * min(1.0, lowest / before)), count
        return self.least


def _lowest(steps: Sequence[float], ratios: Sequence[float]) -> float:
    """Smallest eigenvalue of the tridiagonal matrix of some iterations."""
    from scipy.linalg import eigvalsh_tridiagonal

    inverse, falls = 1.0 / np.array(steps), np.array(ratios)
    diagonal, beside = inverse.copy(), np.sqrt(falls) * inverse[:-1]
    diagonal[1:] += falls * inverse[:-1]
    return float(eigvalsh_tridiagonal(diagonal, beside, select="i", select_range=(0, 0))[0])
