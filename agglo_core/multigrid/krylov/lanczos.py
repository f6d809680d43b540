"""Smallest Ritz value and curvatures from the coefficients of conjugate gradients."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from agglo_core.arrays import Float
from agglo_core.problems.iteration_history import Ended
from agglo_core.problems.residuals.backward_error import LIMIT
from agglo_core.problems.residuals.sizes import two_norm


@dataclass(eq=False)
class RitzValue:
    """Estimate of the smallest eigenvalue present in the residual, from conjugate gradients.

    The coefficients are those of the Lanczos process, with a smallest Ritz value that decreases to this
    eigenvalue. The estimate extrapolates by the reduction over the second half of the iterations.

    Attributes
    ----------
    steps, ratios : list of float
        Step lengths, and the ratios of r·r after and before.
    least : float
        Value at the last :meth:`refresh`.
    """

    steps: list[float] = field(default_factory=list)
    ratios: list[float] = field(default_factory=list)
    least: float = np.inf
    _at: int = 0

    def add(self, step: float, ratio: float) -> None:
        """Append the step length and the residual ratio of an iteration."""
        self.steps.append(step)
        self.ratios.append(ratio)

    def restart(self) -> None:
        """Discard the coefficients before a restart, but keep the eigenvalue estimate."""
        self.steps, self.ratios, self._at = [], [], 0

    def refresh(self) -> float:
        """Update and return the eigenvalue estimate, ∞ before the first iteration."""
        count = len(self.steps)
        if count != self._at:
            lowest, before = (
                ritz_value(self.steps[:n], self.ratios[: n - 1]) for n in (count, (count + 1) // 2)
            )
            self.least, self._at = min(self.least, lowest * min(1.0, lowest / before)), count
        return self.least


def ritz_value(steps: Sequence[float], ratios: Sequence[float], *, largest: bool = False) -> float:
    """Return the smallest or largest eigenvalue of the Lanczos matrix given by conjugate gradients.

    Parameters
    ----------
    steps, ratios : sequence of float
        α of k iterations, and β of all except the last.
    largest : bool
    """
    from scipy.linalg import eigvalsh_tridiagonal

    inverse, falls = 1.0 / np.array(steps), np.array(ratios)
    diagonal, off_diagonal = inverse.copy(), np.sqrt(falls) * inverse[:-1]
    diagonal[1:] += falls * inverse[:-1]
    at = len(diagonal) - 1 if largest else 0
    return float(eigvalsh_tridiagonal(diagonal, off_diagonal, select="i", select_range=(at, at))[0])


_FLAT = 1e-8
"""Curvature below this factor times the largest curvature suggests a null vector.
Benchmark: benchmarks/constants.py."""
_NULL = 1e-6
"""For a null vector p, A p is below this factor times |A| |p|: slightly above the square root of rounding.
Benchmark: benchmarks/constants.py."""


@dataclass(eq=False)
class Curvatures:
    """Curvatures p·A p of directions p, relative to p·M⁻¹p.

    Attributes
    ----------
    flat : bool
        True if the last curvature is so far below the largest that p may be a null vector of A.
    """

    flat: bool = False
    _largest: float = 0.0

    def add(self, curvature: float, size: float) -> bool:
        """Record the curvature p·A p of the next direction, and return True if it nearly vanishes."""
        self._largest = max(self._largest, curvature / size)
        self.flat = curvature <= _FLAT * self._largest * size
        return self.flat


def failure(p: Float, Ap: Float, magnitudes: Float) -> Ended:
    """Return the failure that a direction p of tiny curvature reveals: a singular or indefinite matrix.

    The text is empty if there is none.

    A null vector of A, up to rounding, makes A singular.

    Parameters
    ----------
    p, Ap : (n,) float
    magnitudes : (n,) float
        |A| |p|, or 0 if A has no entries. Then no vector counts as null vector.

    Examples
    --------
    >>> import numpy as np
    >>> A, p = np.array([[1.0, -1.0], [-1.0, 1.0]]), np.ones(2)
    >>> failure(p, A @ p, abs(A) @ abs(p))
    'singular matrix'
    """
    curvature, rounding = float(p @ Ap), LIMIT * float(np.abs(p) @ magnitudes)
    if abs(curvature) <= rounding > 0.0 and two_norm(Ap) <= _NULL * two_norm(magnitudes):
        return "singular matrix"
    if curvature > 0.0:
        return ""
    return "matrix not finite" if np.isnan(curvature) else "indefinite matrix"
