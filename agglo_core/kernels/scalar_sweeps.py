"""Sweeps over the rows of a CSR matrix with sorted columns: Gauss–Seidel, forward from zero and backward."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import kernel

__all__ = ["backward_sweep", "diagonal_places", "first_sweep"]


@kernel
def diagonal_places(indptr, indices):
    """Where the diagonal entry of each row stands, −1 if it is not stored."""
    n = len(indptr) - 1
    places = np.full(n, -1, np.int64)
    for i in range(n):
        for k in range(indptr[i], indptr[i + 1]):
            if indices[k] == i:
                places[i] = k
    return places


@kernel(reorder_sums=True)
def first_sweep(indptr, indices, data, places, inverse, b):
    """x = (D + L)⁻¹ b, a forward sweep from zero, and b − A x = −U x: each entry of A is read once."""
    n = len(indptr) - 1
    x = np.empty_like(b)
    r = np.empty_like(b)
    for i in range(n):
        s = b[i]
        for k in range(indptr[i], places[i]):
            s -= data[k] * x[indices[k]]
        x[i] = s * inverse[i]
    for i in range(n):
        s = data[0] * 0
        for k in range(places[i] + 1, indptr[i + 1]):
            s -= data[k] * x[indices[k]]
        r[i] = s
    return x, r


@kernel(reorder_sums=True)
def backward_sweep(indptr, indices, data, inverse, b, x):
    """A backward sweep of A x = b, in place."""
    for i in range(len(indptr) - 2, -1, -1):
        s = b[i]
        for k in range(indptr[i], indptr[i + 1]):
            s -= data[k] * x[indices[k]]
        x[i] += s * inverse[i]
