"""Block Gauss–Seidel sweeps, and inverses of diagonal blocks.

Matrices with equal blocks are stored as ``scipy.sparse.bsr_array``, matrices with blocks of unequal size as
``csr_array`` with part offsets. Indices need not be sorted. Matrices are symmetric, except in ``sweep``,
which requires inverses stored by columns.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.multigrid.kernels.block_vectors import add_dots, add_product

UNROLLED = 16
"""Maximum block size with a separate kernel, 1.5 to 3 times as fast as the common kernel.

A larger value means more kernels to compile (benchmarks/solve.py).
"""

Sweep = Callable[..., Any]


@cache
def block_sweeps(width: int) -> tuple[Sweep, Sweep]:
    """Return two compiled block Gauss–Seidel sweeps over part groups: with and without residual.

    Group g has the parts ``parts[offsets[g]:offsets[g + 1]]``, for cells a single one. The inverse of the
    matrix on a group is stored by columns from ``starts[g]``. The matrix has the blocks ``data (entries,
    width, width)``, with rows in the order of ``parts``. ``x`` and the columns have the original order. A
    forward sweep reads all data from begin to end: for groups beyond the cache, any other order takes two to
    three times as long.

    ``residual_sweep(offsets, parts, starts, inverses, indptr, indices, data, r, x)``
        A forward sweep through disjoint groups that updates x and its residual r. Block (i, j) serves as
        transpose of (j, i), so that one pass through the matrix does both.
    ``sweep(offsets, parts, starts, inverses, indptr, indices, data, b, x, order)``
        A sweep without residual, forward (``order`` 1) or backward (−1), also for groups that overlap and
        matrices that are not symmetric.
    """
    if not 1 < width <= UNROLLED:
        return _residual_sweep, _sweep

    @kernel(reorder_sums=True)
    def residual_sweep(offsets, parts, starts, inverses, indptr, indices, data, r, x):
        n, blocks = width, data.reshape(-1)
        step, (residual, solution) = np.empty(n, x.dtype), _room(offsets, n, x)
        for g in range(len(offsets) - 1):
            # 1. The inverse times the residual of the group, before any part changes it.
            #    A single part leaves this product to step 2.
            first, size = offsets[g], offsets[g + 1] - offsets[g]
            if size > 1:
                _gather(r, parts[first : first + size], n, residual)
                _solve(inverses[starts[g] :], residual, size * n, solution)
            # 2. Part by part: x_i takes its step, then r_j −= A_ijᵀ step for all j, including i.
            for a in range(size):
                start = np.uint32(parts[first + a]) * n
                for q in range(n):
                    step[q] = solution[a * n + q] if size > 1 else 0
                if size == 1:
                    add_product(width, r, start, 1, inverses, starts[g], step, 0)
                for q in range(n):
                    x[start + q] += step[q]
                    step[q] = -step[q]
                for k in range(indptr[first + a], indptr[first + a + 1]):  # unsigned: no negative indices
                    add_product(width, step, 0, 1, blocks, k * n * n, r, np.uint32(indices[k]) * n)
            _clear(r, parts[first : first + size], n)

    @kernel(reorder_sums=True)
    def sweep(offsets, parts, starts, inverses, indptr, indices, data, b, x, order):
        n, blocks, count = width, data.reshape(-1), len(offsets) - 1
        part_residual, (residual, solution) = np.empty(n, x.dtype), _room(offsets, n, x)
        for turn in range(count):
            g = turn if order > 0 else count - 1 - turn
            first, size = offsets[g], offsets[g + 1] - offsets[g]
            # 1. The residual b_i − Σ_j A_ij x_j of each part in the group, with j over the whole row.
            for m in range(size):
                a = m if order > 0 else size - 1 - m  # read memory in one direction
                start, row = np.uint32(parts[first + a]) * n, first + a
                for q in range(n):
                    part_residual[q] = 0
                begin = indptr[row] if order > 0 else indptr[row + 1] - 1
                for h in range(indptr[row + 1] - indptr[row]):
                    k = begin + order * h
                    add_dots(width, blocks, k * n * n, x, np.uint32(indices[k]) * n, part_residual, 0)
                for q in range(n):
                    part_residual[q] = b[start + q] - part_residual[q]
                if size > 1:
                    for q in range(n):
                        residual[a * n + q] = part_residual[q]
            # 2. x += A_g⁻¹ residual.
            if size == 1:
                start = np.uint32(parts[first]) * n
                add_product(width, part_residual, 0, 1, inverses, starts[g], x, start)
            else:
                _solve(inverses[starts[g] :], residual, size * n, solution)
                _scatter(solution, parts[first : first + size], n, x)

    return residual_sweep, sweep


@kernel(reorder_sums=True)
def _residual_sweep(offsets, parts, starts, inverses, indptr, indices, data, r, x):
    # As above for any block size, with loops over the contiguous rows of a block.
    n = data.shape[1]
    residual, solution = _room(offsets, n, x)
    for g in range(len(offsets) - 1):
        first, size = offsets[g], offsets[g + 1] - offsets[g]
        group = parts[first : first + size]
        _gather(r, group, n, residual)
        _solve(inverses[starts[g] :], residual, size * n, solution)
        _scatter(solution, group, n, x)
        for a in range(size):
            for k in range(indptr[first + a], indptr[first + a + 1]):
                at = np.uint32(indices[k]) * n
                for c in range(n):
                    t = solution[a * n + c]
                    for q in range(n):
                        r[at + q] -= data[k, c, q] * t
        _clear(r, group, n)


@kernel(reorder_sums=True)
def _sweep(offsets, parts, starts, inverses, indptr, indices, data, b, x, order):
    # As above for any block size: x_i += A_g⁻¹ (b_i − Σ_j A_ij x_j).
    n, count = data.shape[1], len(offsets) - 1
    residual, solution = _room(offsets, n, x)
    for turn in range(count):
        g = turn if order > 0 else count - 1 - turn
        first, size = offsets[g], offsets[g + 1] - offsets[g]
        group = parts[first : first + size]
        _gather(b, group, n, residual)
        for a in range(size):
            for k in range(indptr[first + a], indptr[first + a + 1]):
                at = np.uint32(indices[k]) * n
                for q in range(n):
                    t = residual[a * n + q]
                    for c in range(n):
                        t -= data[k, q, c] * x[at + c]
                    residual[a * n + q] = t
        _solve(inverses[starts[g] :], residual, size * n, solution)
        _scatter(solution, group, n, x)


@helper(allocates=True)
def _room(offsets, n, like):
    """Allocate arrays for the right-hand side and the solution of the largest group."""
    most = 0
    for g in range(len(offsets) - 1):
        most = max(most, offsets[g + 1] - offsets[g])
    return np.empty(most * n, like.dtype), np.empty(most * n, like.dtype)


@helper
def _gather(vector, group, n, into):
    """Copy the values of the parts of a group."""
    for a in range(len(group)):
        start = np.uint32(group[a]) * n
        for q in range(n):
            into[a * n + q] = vector[start + q]


@helper
def _scatter(values, group, n, x):
    """Add values to the parts of a group."""
    for a in range(len(group)):
        start = np.uint32(group[a]) * n
        for q in range(n):
            x[start + q] += values[a * n + q]


@helper
def _clear(r, group, n):
    """Set the residual of a group, zero except for rounding, to zero."""
    for a in range(len(group)):
        start = np.uint32(group[a]) * n
        for q in range(n):
            r[start + q] = 0


@helper(reorder_sums=True)
def _solve(inverse, residual, m, solution):
    """Multiply ``residual[:m]`` by an inverse ``(m, m)``, stored by columns."""
    for q in range(m):
        solution[q] = 0
    for e in range(m):
        t, column = residual[e], inverse[e * m : (e + 1) * m]
        for q in range(m):
            solution[q] += column[q] * t


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
