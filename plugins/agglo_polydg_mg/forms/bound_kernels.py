"""Small matrices: their Cholesky factors, and upper bounds of their largest eigenvalues, many at a time.

For the bounds ``LANES`` are taken at a time, so that their powers are computed side by side: the matrices
themselves are too small for fast loops.
"""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_polydg_mg.space.legendre_kernels import LANES

SQUARINGS = 5  # the bound exceeds the eigenvalue by n^(1/64) at most: 5 % for n = 27, 1 % for n = 2


@helper
def factorise(matrix, n, tolerance):
    """Cholesky factor in place, in the lower half, its diagonal inverted; False where a pivot is rounding."""
    for j in range(n):
        diagonal = matrix[j, j]
        pivot = diagonal
        for k in range(j):
            pivot -= matrix[j, k] * matrix[j, k]
        if not pivot > tolerance * diagonal:
            return False
        matrix[j, j] = 1.0 / np.sqrt(pivot)
        for i in range(j + 1, n):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = value * matrix[j, j]
    return True


@helper
def square(lanes, scaled, traces, inverse):
    """Divide symmetric matrices by their ``traces``, which come out, and square them: the lower halves."""
    n = len(lanes)
    for lane in range(LANES):
        traces[lane] = 0.0
    for i in range(n):
        for lane in range(LANES):
            traces[lane] += lanes[i, i, lane]
    for lane in range(LANES):
        inverse[lane] = 1.0 / traces[lane] if traces[lane] > 0.0 else 0.0
    for i in range(n):
        for j in range(i + 1):
            for lane in range(LANES):
                scaled[i, j, lane] = scaled[j, i, lane] = inverse[lane] * lanes[i, j, lane]
    for i in range(n):
        for j in range(i + 1):
            out, left, right = lanes[i, j], scaled[i], scaled[j]
            for lane in range(LANES):
                out[lane] = 0.0
            for k in range(0, n - 3, 4):  # by fours: sums stay in registers
                for lane in range(LANES):
                    out[lane] += (
                        left[k, lane] * right[k, lane]
                        + left[k + 1, lane] * right[k + 1, lane]
                        + left[k + 2, lane] * right[k + 2, lane]
                        + left[k + 3, lane] * right[k + 3, lane]
                    )
            for k in range(n - n % 4, n):
                for lane in range(LANES):
                    out[lane] += left[k, lane] * right[k, lane]


@helper
def complete(lanes, scaled, traces, inverse, bounds):
    """The ``bounds`` from matrices that have been squared once and their first ``traces``."""
    for step in range(1, SQUARINGS):
        square(lanes, scaled, traces[step], inverse)
    for lane in range(LANES):
        bounds[lane] = 0.0
    for i in range(len(lanes)):
        for j in range(i + 1):
            twice = 1.0 if i == j else 2.0
            for lane in range(LANES):
                bounds[lane] += twice * lanes[i, j, lane] * lanes[i, j, lane]
    for lane in range(LANES):
        bound = np.sqrt(bounds[lane])
        for step in range(SQUARINGS - 1, -1, -1):
            bound = traces[step, lane] * np.sqrt(bound)
        bounds[lane] = bound


@kernel
def largest_bounds(lanes, bounds):
    """Upper ``bounds (LANES,)`` of the largest eigenvalues of symmetric positive semidefinite matrices.

    λ^(2^k) is an eigenvalue of the 2^k-th power, and none of these exceeds its Frobenius norm. ``lanes``
    holds the lower halves ``(n, n, LANES)`` and is overwritten.
    """
    scaled, traces, inverse = np.empty(lanes.shape), np.empty((SQUARINGS, LANES)), np.empty(LANES)
    square(lanes, scaled, traces[0], inverse)
    complete(lanes, scaled, traces, inverse, bounds)
