"""Block Gauss–Seidel sweeps, and inverses of diagonal blocks.

Matrices with equal blocks are stored as ``scipy.sparse.bsr_array``, matrices with blocks of unequal size as
``csr_array`` with part offsets. Indices need not be sorted. Matrices are symmetric, except in ``sweep``,
which requires transposed inverses of diagonal blocks.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from agglo_core.compiled.compiling import kernel
from agglo_core.multigrid.kernels.block_vectors import add_dots, add_product

UNROLLED = 16
"""Maximum block size with a separate kernel, 1.5 to 3 times as fast as the common kernel.

A larger value means more kernels to compile (benchmarks/solve.py).
"""

Sweep = Callable[..., Any]


@cache
def block_sweeps(width: int) -> tuple[Sweep, Sweep]:
    """Return two compiled block Gauss–Seidel sweeps for a block size: with and without residual.

    ``residual_sweep(indptr, indices, data, inverses, r, x)``
        A forward sweep that updates x and its residual r. Block (i, j) serves as transpose of (j, i), so
        that one pass through the matrix does both.
    ``sweep(indptr, indices, data, inverses, b, x, order)``
        A sweep without residual, forward (``order`` 1) or backward (−1).

    Blocks and inverse diagonal blocks are stored in flat arrays.
    """
    if not 1 < width <= UNROLLED:
        return _residual_sweep, _sweep

    @kernel(reorder_sums=True)
    def residual_sweep(indptr, indices, data, inverses, r, x):
        step = np.empty(width, x.dtype)
        for i in range(len(indptr) - 1):
            # x_i += D_i⁻¹ r_i, then r_j −= A_ijᵀ (change of x_i) for all j, including i.
            start = i * width
            for q in range(width):
                step[q] = 0
            add_product(width, r, start, 1, inverses, start * width, step, 0)
            for q in range(width):
                x[start + q] += step[q]
                step[q] = -step[q]
            for k in range(indptr[i], indptr[i + 1]):  # unsigned: no test for negative indices
                add_product(width, step, 0, 1, data, k * width * width, r, np.uint32(indices[k]) * width)
            for q in range(width):
                r[start + q] = 0  # zero except for rounding

    @kernel(reorder_sums=True)
    def sweep(indptr, indices, data, inverses, b, x, order):
        rows, residual = len(indptr) - 1, np.empty(width, x.dtype)
        for turn in range(rows):
            # x_i += D_i⁻¹ (b_i − Σ_j A_ij x_j), with j over the whole row.
            i = turn if order > 0 else rows - 1 - turn
            start = i * width
            for q in range(width):
                residual[q] = 0
            first = indptr[i] if order > 0 else indptr[i + 1] - 1  # read memory in one direction
            for h in range(indptr[i + 1] - indptr[i]):
                k = first + order * h
                add_dots(width, data, k * width * width, x, np.uint32(indices[k]) * width, residual, 0)
            for q in range(width):
                residual[q] = b[start + q] - residual[q]
            add_product(width, residual, 0, 1, inverses, start * width, x, start)

    return residual_sweep, sweep


@kernel(reorder_sums=True)
def _residual_sweep(indptr, indices, data, inverses, r, x):
    # As above for any block size, with loops over the contiguous rows of a block.
    n = len(x) // (len(indptr) - 1)
    step = np.empty(n, x.dtype)
    for i in range(len(indptr) - 1):
        start = i * n
        for q in range(n):
            step[q] = 0
        for c in range(n):
            t, row = r[start + c], (start + c) * n
            for q in range(n):
                step[q] += inverses[row + q] * t
        for q in range(n):
            x[start + q] += step[q]
        for k in range(indptr[i], indptr[i + 1]):
            at = np.uint32(indices[k]) * n
            for c in range(n):
                t, row = step[c], (k * n + c) * n
                for q in range(n):
                    r[at + q] -= data[row + q] * t
        for q in range(n):
            r[start + q] = 0


@kernel(reorder_sums=True)
def _sweep(indptr, indices, data, inverses, b, x, order):
    rows = len(indptr) - 1
    n = len(x) // rows
    residual = np.empty(n, x.dtype)
    # As above for any block size: x_i += D_i⁻¹ (b_i − Σ_j A_ij x_j).
    for turn in range(rows):
        i = turn if order > 0 else rows - 1 - turn
        start = i * n
        for q in range(n):
            residual[q] = b[start + q]
        for k in range(indptr[i], indptr[i + 1]):
            at = np.uint32(indices[k]) * n
            for q in range(n):
                t, row = residual[q], (k * n + q) * n
                for c in range(n):
                    t -= data[row + c] * x[at + c]
                residual[q] = t
        for c in range(n):
            t, row = residual[c], (start + c) * n
            for q in range(n):
                x[start + q] += inverses[row + q] * t


@cache
def block_product(width: int) -> Any:
    """Return the compiled product A x, a function of ``(indptr, indices, data, x)``.

    Blocks have 2 to 16 unknowns and are stored in a flat array.
    """

    @kernel(reorder_sums=True)
    def product(indptr, indices, data, x):
        # y_i += A_ij x_j, block by block.
        y = np.zeros_like(x)
        for i in range(len(indptr) - 1):
            for k in range(indptr[i], indptr[i + 1]):
                add_dots(width, data, k * width * width, x, np.uint32(indices[k]) * width, y, i * width)
        return y

    return product


@kernel(reorder_sums=True)
def sweep_parts(indptr, indices, data, offsets, places, inverses, b, x, order):
    """Update x by a block Gauss–Seidel sweep over unequal parts, forward (``order`` 1) or backward (−1).

    Part p has the rows ``offsets[p]:offsets[p + 1]`` of a CSR matrix, and its inverse diagonal block is
    stored by rows from ``inverses[places[p]]``.
    """
    parts = len(offsets) - 1
    residual = np.empty(len(b), x.dtype)
    for turn in range(parts):
        p = turn if order > 0 else parts - 1 - turn
        # First the residual in all rows of the part, as x_p must not change before.
        first, n = offsets[p], offsets[p + 1] - offsets[p]
        for q in range(n):
            t = b[first + q]
            for k in range(indptr[first + q], indptr[first + q + 1]):
                t -= data[k] * x[indices[k]]
            residual[q] = t
        # Then x_p += D_p⁻¹ residual.
        for q in range(n):
            t = x[first + q]
            for c in range(n):
                t += inverses[places[p] + q * n + c] * residual[c]
            x[first + q] = t


@kernel
def invert_blocks(offsets, blocks):
    """Invert symmetric positive definite matrices, stored consecutively by rows, by Cholesky factors.

    Matrix p has ``offsets[p + 1] - offsets[p]`` rows. Lower triangles are read, and inverses overwrite the
    matrices. Returns the first matrix that is not positive definite to rounding, or −1.
    """
    at = 0
    for p in range(len(offsets) - 1):
        n = offsets[p + 1] - offsets[p]
        a = blocks[at : at + n * n].reshape(n, n)
        at += n * n
        # 1. a = L Lᵀ with L in the lower triangle. A pivot below 1e-15 of its entry is rounding.
        for j in range(n):
            pivot = a[j, j]
            least = 1e-15 * abs(pivot)
            for k in range(j):
                pivot -= a[j, k] * a[j, k]
            if not (pivot > least and np.isfinite(pivot)):
                return p
            pivot = np.sqrt(pivot)
            a[j, j] = pivot
            for i in range(j + 1, n):
                t = a[i, j]
                for k in range(j):
                    t -= a[i, k] * a[j, k]
                a[i, j] = t / pivot
        # 2. L⁻¹ overwrites L column by column. Diagonal entries below column j still belong to L.
        for j in range(n):
            a[j, j] = 1.0 / a[j, j]
            for i in range(j + 1, n):
                t = 0.0
                for k in range(j, i):
                    t -= a[i, k] * a[k, j]
                a[i, j] = t / a[i, i]
        # 3. L⁻ᵀ L⁻¹ in the upper triangle, where entry (i, j) needs rows ≥ j of L⁻¹ only. Then mirror.
        for i in range(n):
            for j in range(i, n):
                t = 0.0
                for k in range(j, n):
                    t += a[k, i] * a[k, j]
                a[i, j] = t
        for i in range(n):
            for j in range(i):
                a[i, j] = a[j, i]
    return -1


@kernel(reorder_sums=True)
def both_products(indptr, indices, data, v):
    """Return A v and Aᵀ v in one pass, for a matrix with the blocks ``data (·, n, n)``."""
    n = data.shape[1]
    straight, transposed = np.zeros(len(v)), np.zeros(len(v))
    for i in range(len(indptr) - 1):
        # Use each block for both products.
        start = i * n
        for k in range(indptr[i], indptr[i + 1]):
            at = indices[k] * n
            for q in range(n):
                t, u = 0.0, v[start + q]
                for c in range(n):
                    t += data[k, q, c] * v[at + c]
                    transposed[at + c] += data[k, q, c] * u
                straight[start + q] += t
    return straight, transposed


@kernel
def clear_tiny(values, least):
    """Set entries with magnitude below ``least`` to 0."""
    for k in range(len(values)):
        if abs(values[k]) < least:
            values[k] = 0
