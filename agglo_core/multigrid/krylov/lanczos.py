"""Smallest Ritz value and curvatures: what the coefficients of conjugate gradients show of the matrix."""

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
                ritz_value(self.steps[:n], self.ratios[: n - 1]) for n in (count, (count + 1) // 2)
            )
            self.least, self._at = min(self.least, lowest * min(1.0, lowest / before)), count
        return self.least


def ritz_value(steps: Sequence[float], ratios: Sequence[float], *, largest: bool = False) -> float:
    """Smallest or largest eigenvalue of the tridiagonal matrix of some iterations of conjugate gradients.

    Parameters
    ----------
    steps, ratios : sequence of float
        α of k iterations and β of all but the last.
    largest : bool
    """
    from scipy.linalg import eigvalsh_tridiagonal

    inverse, falls = 1.0 / np.array(steps), np.array(ratios)
    diagonal, beside = inverse.copy(), np.sqrt(falls) * inverse[:-1]
    diagonal[1:] += falls * inverse[:-1]
    at = len(diagonal) - 1 if largest else 0
    return float(eigvalsh_tridiagonal(diagonal, beside, select="i", select_range=(at, at))[0])


_FLAT = 1e-8
"""Part of the largest curvature of the directions so far below which one may be a null vector."""
_NULL = 1e-6
"""Part of |A| |p| that A p of a null vector p is below: the square root of rounding, and some more."""


@dataclass(eq=False)
class Curvatures:
    """Curvatures p·A p of directions p, relative to p·M⁻¹p.

    Attributes
    ----------
    flat : bool
        The last one is so far below the largest that its direction may be a null vector of A.
    """

    flat: bool = False
    _largest: float = 0.0

    def add(self, curvature: float, size: float) -> bool:
        """Take the curvature of the next direction and p·M⁻¹p; return whether it is flat."""
        self._largest = max(self._largest, curvature / size)
        self.flat = curvature <= _FLAT * self._largest * size
        return self.flat


def failure(p: Float, Ap: Float, magnitudes: Float) -> Ended:
    """Failure that a flat direction p shows: a singular or indefinite matrix; empty if there is none.

    A null vector of A to rounding makes it singular.

    Parameters
    ----------
    p, Ap : (n,) float
    magnitudes : (n,) float
        |A| |p|, or 0 if A is not known entry by entry: then no vector is called a null vector.

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
