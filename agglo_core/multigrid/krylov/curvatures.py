"""Curvatures of directions of conjugate gradients, and what they show to be wrong with a matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agglo_core.arrays import Float
from agglo_core.problems.backward_error import LIMIT
from agglo_core.problems.iteration_history import Ended
from agglo_core.problems.sizes import two_norm

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
