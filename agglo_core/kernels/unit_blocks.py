"""Unknowns of a block matrix scaled so that its diagonal blocks become identities."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import kernel

__all__ = ["scale_blocks"]


@kernel(reorder_sums=True)
def scale_blocks(indptr, indices, data):
    """Blocks of T A Tᵀ; T of each part, the inverse of the Cholesky factor L of its diagonal block; and Lᵀ.

    Returned first is the first part whose
    diagonal block is missing or not positive definite, −1 if there is none.
    """
    n, count = data.shape[1], len(indptr) - 1
    T, LT = np.zeros((count, n, n)), np.zeros((count, n, n))
    scaled = np.zeros(data.shape)
    for i in range(count):
        inverse, upper = T[i], LT[i]
        for h in range(indptr[i], indptr[i + 1]):
            if indices[h] == i:
                upper[:] = data[h]
        for j in range(n):  # Cholesky by rows: upper becomes Lᵀ
            if not upper[j, j] > 0.0:
                return i, T, LT, scaled
            scale = 1.0 / np.sqrt(upper[j, j])
            for c in range(j):
                upper[j, c] = 0.0
            for c in range(j, n):
                upper[j, c] *= scale
            for r in range(j + 1, n):
                for c in range(r, n):
                    upper[r, c] -= upper[j, r] * upper[j, c]
        for r in range(n):  # row r of L⁻¹ from those above
            for k in range(r):
                for c in range(k + 1):
                    inverse[r, c] -= upper[k, r] * inverse[k, c]
            for c in range(r):
                inverse[r, c] /= upper[r, r]
            inverse[r, r] = 1.0 / upper[r, r]
    half = np.empty((n, n))
    for i in range(count):
        left = T[i]
        for h in range(indptr[i], indptr[i + 1]):
            right, block, out = T[indices[h]], data[h], scaled[h]
            for r in range(n):
                row = half[r]
                for q in range(n):
                    row[q] = 0.0
                for c in range(r + 1):
                    for q in range(n):
                        row[q] += left[r, c] * block[c, q]
            for r in range(n):
                for q in range(n):
                    value = 0.0
                    for c in range(q + 1):
                        value += half[r, c] * right[q, c]
                    out[r, q] = value
    return -1, T, LT, scaled
