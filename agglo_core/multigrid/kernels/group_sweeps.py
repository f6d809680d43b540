"""Gauss–Seidel sweeps through part groups of a block matrix."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from agglo_core.compiled.compiling import helper, kernel

UNROLLED = 6
"""Maximum block size with a separate kernel. Larger blocks share a kernel.

A larger value means more kernels to compile (benchmarks/solve.py, meshes ``graded`` and ``layers``).
"""

Sweep = Callable[..., Any]


@cache
def group_sweeps(width: int) -> tuple[Sweep, Sweep]:
    """Return two compiled sweeps over groups, with and without residual, for a block size (0 for any).

    Group g has the parts ``parts[offsets[g]:offsets[g + 1]]``. The inverse of the matrix on a group is stored
    by columns from ``starts[g]``. Matrix rows follow the order of ``parts``, ``x`` and the columns the
    original order: stored data are read from begin to end, which takes a third to a half the time of any
    other order for data beyond the cache.

    ``residual_sweep(offsets, parts, starts, inverses, indptr, indices, data, r, x)``
        A forward sweep through disjoint groups that updates x and its residual r. The matrix is symmetric:
        block (i, j) serves as transpose of (j, i), so that one pass through the matrix does both.
    ``sweep(offsets, parts, starts, inverses, indptr, indices, data, b, x)``
        A forward sweep without residual, also for groups that overlap and matrices that are not symmetric.
    """

    @kernel(reorder_sums=True)
    def residual_sweep(offsets, parts, starts, inverses, indptr, indices, data, r, x):
        n = width if width > 0 else data.shape[1]
        step, (residual, solution) = np.empty(n, x.dtype), _room(offsets, n, x)
        for g in range(len(offsets) - 1):
            # 1. The residual of the group, taken before any part changes it, times the inverse on the group.
            #    A single part leaves this product to step 2.
            first, size = offsets[g], offsets[g + 1] - offsets[g]
            for a in range(size):
                start, into = np.uint32(parts[first + a]) * n, residual[a * n : (a + 1) * n]
                for q in range(n):
                    into[q] = r[start + q]
            if size > 1:
                _solve(inverses[starts[g] :], residual, size * n, solution)
            # 2. Part by part: x_i takes its step, then r_j −= A_ijᵀ step for all j.
            for a in range(size):
                i = np.uint32(parts[first + a])
                if size > 1:
                    part_solution = solution[a * n : (a + 1) * n]
                    for q in range(n):
                        step[q] = part_solution[q]
                else:  # most groups have one part
                    inverse = inverses[starts[g] : starts[g] + n * n]
                    for q in range(n):
                        step[q] = 0
                    for c in range(n):
                        t = residual[c]
                        for q in range(n):
                            step[q] += inverse[c * n + q] * t
                for q in range(n):
                    x[i * n + q] += step[q]
                for k in range(indptr[first + a], indptr[first + a + 1]):
                    at = np.uint32(indices[k]) * n  # unsigned: no test for negative indices
                    for c in range(n):
                        t = step[c]
                        for q in range(n):
                            r[at + q] -= data[k, c, q] * t
            for a in range(size):
                start = np.uint32(parts[first + a]) * n
                for q in range(n):
                    r[start + q] = 0  # zero except for rounding

    @kernel(reorder_sums=True)
    def sweep(offsets, parts, starts, inverses, indptr, indices, data, b, x):
        n = width if width > 0 else data.shape[1]
        part_residual, (residual, solution) = np.empty(n, x.dtype), _room(offsets, n, x)
        for g in range(len(offsets) - 1):
            first, size = offsets[g], offsets[g + 1] - offsets[g]
            # 1. The residual b_i − Σ_j A_ij x_j of each part in the group.
            for a in range(size):
                i, into = np.uint32(parts[first + a]), residual[a * n : (a + 1) * n]
                for q in range(n):
                    part_residual[q] = b[i * n + q]
                for k in range(indptr[first + a], indptr[first + a + 1]):
                    at = np.uint32(indices[k]) * n
                    for c in range(n):
                        t = x[at + c]
                        for q in range(n):
                            part_residual[q] -= data[k, q, c] * t
                for q in range(n):
                    into[q] = part_residual[q]
            # 2. x += A_g⁻¹ residual. For a single part, ``part_residual`` still holds it.
            if size > 1:
                _solve(inverses[starts[g] :], residual, size * n, solution)
                for a in range(size):
                    start, part_solution = np.uint32(parts[first + a]) * n, solution[a * n : (a + 1) * n]
                    for q in range(n):
                        x[start + q] += part_solution[q]
            else:
                start, inverse = np.uint32(parts[first]) * n, inverses[starts[g] : starts[g] + n * n]
                for c in range(n):
                    t = part_residual[c]
                    for q in range(n):
                        x[start + q] += inverse[c * n + q] * t

    return residual_sweep, sweep


@helper(allocates=True)
def _room(offsets, n, like):
    """Allocate arrays for the right-hand side and the solution of the largest group."""
    most = 0
    for g in range(len(offsets) - 1):
        most = max(most, offsets[g + 1] - offsets[g])
    return np.empty(most * n, like.dtype), np.empty(most * n, like.dtype)


@helper(reorder_sums=True)
def _solve(inverse, residual, m, solution):
    """Multiply ``residual[:m]`` by an inverse ``(m, m)``, stored by columns."""
    for q in range(m):
        solution[q] = 0
    for e in range(m):
        t, column = residual[e], inverse[e * m : (e + 1) * m]
        for q in range(m):
            solution[q] += column[q] * t
