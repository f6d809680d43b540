"""Gauss points on intervals, triangles and tetrahedra."""

from __future__ import annotations

from functools import cache

import numpy as np

from agglo_core.arrays import Float, frozen_float


@cache
def gauss(n: int) -> tuple[Float, Float]:
    """Return Gauss nodes and weights ``(n,)`` on [−1, 1], exact up to degree 2n − 1."""
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return frozen_float(nodes), frozen_float(weights)


@cache
def simplex_rule(dim: int, n: int) -> tuple[Float, Float]:
    """Return points ``(nᵈ, d)`` and weights on the unit simplex, exact up to degree 2n − 1.

    The rule folds a cube onto the simplex.
    """
    from scipy.special import roots_jacobi

    x, wx = gauss(n)
    points, weights = (0.5 * (1 + x))[:, None], 0.5 * wx
    for axis in range(1, dim):
        y, wy = roots_jacobi(n, float(axis), 0.0)
        t = 0.5 * (1 + y)
        folded = (1 - t)[:, None, None] * points
        last = np.broadcast_to(t[:, None, None], (n, len(points), 1))
        points = np.concatenate((folded, last), axis=2).reshape(-1, axis + 1)
        weights = (0.5 ** (axis + 1) * wy[:, None] * weights).ravel()
    return frozen_float(points), frozen_float(weights)
