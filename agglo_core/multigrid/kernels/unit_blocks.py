"""Scaling of a block matrix to identity diagonal blocks."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.multigrid.kernels.block_vectors import add_product

_UNROLLED = 16
"""Maximum block size with a separate kernel by vector instructions. Larger blocks share a kernel.

A larger value means more kernels to compile (benchmarks/solve.py).
"""


@cache
def scale_blocks(width: int) -> Any:
    """Return the compiled scaling of a block matrix to identity diagonal blocks, for a block size.

    Its arguments are ``(indptr, indices, data)``, with ``data (·, n, n)``.

    The kernel returns the first part with a missing or not positive definite diagonal block (or −1), T
    ``(parts, n, n)`` (the inverse Cholesky factors L⁻¹ of the diagonal blocks), Lᵀ in equal storage, and the
    blocks of T A Tᵀ in the positions of A's blocks.
    """
    if not 1 < width <= _UNROLLED:
        return _scale_blocks

    @kernel(reorder_sums=True)
    def scaled_by_rows(indptr, indices, data):
        square, count = width * width, len(indptr) - 1
        bad_part, T, LT = _factors(indptr, indices, data)
        scaled = np.zeros(data.shape)
        if bad_part >= 0:
            return bad_part, T, LT, scaled
        # 1. ``right``: the transposes Tᵀ, because ``add_product`` combines rows.
        T_flat, scaled_flat, blocks = T.reshape(-1), scaled.reshape(-1), data.reshape(-1)
        right, half = np.empty(count * square), np.empty(square)
        for i in range(count):
            for r in range(width):
                for q in range(width):
                    right[i * square + q * width + r] = T[i, r, q]
        # 2. T_i A_ij T_jᵀ row by row: first row r of T_i A_ij, then its product with T_jᵀ.
        for i in range(count):
            for h in range(indptr[i], indptr[i + 1]):
                column_start = np.uint32(indices[h]) * square
                for k in range(square):
                    half[k] = 0.0
                for r in range(width):
                    row = r * width
                    add_product(width, T_flat, i * square + row, 1, blocks, h * square, half, row)
                    add_product(width, half, row, 1, right, column_start, scaled_flat, h * square + row)
        return -1, T, LT, scaled

    return scaled_by_rows


@helper(allocates=True)
def _factors(indptr, indices, data):
    """Factorise the diagonal blocks as L Lᵀ.

    Returns the first part with a block that is not positive definite (or −1), T = L⁻¹, and Lᵀ.
    """
    n, count = data.shape[1], len(indptr) - 1
    T, LT = np.zeros((count, n, n)), np.zeros((count, n, n))
    for i in range(count):
        inverse, upper = T[i], LT[i]
        for h in range(indptr[i], indptr[i + 1]):
            if indices[h] == i:
                for r in range(n):
                    for c in range(n):
                        upper[r, c] = data[h, r, c]
        # 1. Cholesky by rows: upper becomes Lᵀ. A missing block is 0 and fails here.
        for j in range(n):
            if not upper[j, j] > 0.0:
                return i, T, LT
            scale = 1.0 / np.sqrt(upper[j, j])
            for c in range(j):
                upper[j, c] = 0.0
            for c in range(j, n):
                upper[j, c] *= scale
            for r in range(j + 1, n):
                for c in range(r, n):
                    upper[r, c] -= upper[j, r] * upper[j, c]
        # 2. Row r of L⁻¹ from the previous rows: L_rr (L⁻¹)_r = e_r − Σ_k<r L_rk (L⁻¹)_k.
        for r in range(n):
            for k in range(r):
                for c in range(k + 1):
                    inverse[r, c] -= upper[k, r] * inverse[k, c]
            for c in range(r):
                inverse[r, c] /= upper[r, r]
            inverse[r, r] = 1.0 / upper[r, r]
    return -1, T, LT


@kernel(reorder_sums=True)
def _scale_blocks(indptr, indices, data):
    n, count = data.shape[1], len(indptr) - 1
    bad_part, T, LT = _factors(indptr, indices, data)
    half, scaled = np.empty((n, n)), np.zeros(data.shape)
    if bad_part >= 0:
        return bad_part, T, LT, scaled
    for i in range(count):
        T_i = T[i]
        # ``half`` is T_i A_ij, then multiplied by T_jᵀ. Zeros of the lower triangles T are skipped.
        for h in range(indptr[i], indptr[i + 1]):
            T_j, block, product = T[indices[h]], data[h], scaled[h]
            for r in range(n):
                row = half[r]
                for q in range(n):
                    row[q] = 0.0
                for c in range(r + 1):
                    for q in range(n):
                        row[q] += T_i[r, c] * block[c, q]
            # Row q of T_j is column q of T_jᵀ.
            for r in range(n):
                for q in range(n):
                    value = 0.0
                    for c in range(q + 1):
                        value += half[r, c] * T_j[q, c]
                    product[r, q] = value
    return -1, T, LT, scaled
