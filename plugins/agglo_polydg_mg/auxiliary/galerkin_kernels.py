"""Kernels for Galerkin products C = Pᵀ A P with block matrices A and few unknowns of C per cell.

``offsets, indices`` are the cell unknowns, ``fitted (·, n)`` the columns of P on the cell. C is
symmetric: only its upper half is computed, with the diagonal entry first in each row.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from agglo_core.authoring import helper, kernel

_MOST_ADDED = 0.25
"""A row keeps its small entries if their sum exceeds this fraction of its diagonal entry.

A larger value drops more entries and moves more weight to the diagonal (benchmarks/solve.py).
"""


@helper(allocates=True)
def _holders(offsets, indices, size):
    """List for each unknown the cells that have it, and its indices in these cells' lists."""
    # Counting sort of the positions by unknown.
    starts = np.zeros(size + 1, np.int64)
    for k in indices:
        starts[k + 1] += 1
    for k in range(size):
        starts[k + 1] += starts[k]
    fill = starts[:-1].copy()
    places, cells = np.empty(len(indices), np.int64), np.empty(len(indices), np.int64)
    for c in range(len(offsets) - 1):
        for q in range(offsets[c], offsets[c + 1]):
            at = fill[indices[q]]
            places[at], cells[at] = q, c
            fill[indices[q]] += 1
    return starts, places, cells


@cache
def half_product(width: int) -> Callable[..., Any]:
    """Return the kernel that computes the upper half of C for one block size, 0 for any size.

    Its arguments are ``(indptr, columns, blocks, offsets, indices, fitted, size)``. It returns rows,
    columns and values of the upper half of C ``(size, size)``; the diagonal entry is first in its row, the
    others are not sorted. ``indptr, columns, blocks`` are the symmetric block matrix A. Row v is Pᵀ (A p)
    with column p = P[:, v]: A p is nonzero on the cells of v and their neighbours.
    """

    @kernel(reorder_sums=True)
    def galerkin_half(indptr, columns, blocks, offsets, indices, fitted, size):
        n = width if width > 0 else fitted.shape[1]
        starts, places, cell_of = _holders(offsets, indices, size)
        rows, slot, position = np.zeros(size + 1, np.int64), np.full(size, -1), 0
        half_columns, values = np.empty(16 * size, np.int32), np.empty(16 * size)
        turn, near, product = np.full(len(offsets) - 1, -1), np.empty(64, np.int64), np.empty(64 * n)
        for v in range(size):
            # 1. A p, cell by cell: A is symmetric, so A p is Σ_i A_ijᵀ p_i in cell j, over the cells i of
            # v. ``turn[j]`` is the position of cell j in ``near``, −1 if j is not yet visited in this row.
            count, first, max_entries = 0, position, 1
            for h in range(starts[v], starts[v + 1]):
                i, fit_row = np.uint32(cell_of[h]), np.uint32(places[h])
                for k in range(indptr[i], indptr[i + 1]):
                    j = np.uint32(columns[k])
                    if turn[j] < 0:
                        if count == len(near):
                            near, product = _double_length(near), _double_length(product)
                        turn[j], near[count] = count, j
                        max_entries += offsets[j + 1] - offsets[j]
                        for b in range(n):
                            product[count * n + b] = 0.0
                        count += 1
                    into = np.uint32(turn[j]) * n
                    for a in range(n):
                        t = fitted[fit_row, a]
                        for b in range(n):
                            product[into + b] += t * blocks[k, a, b]
            # 2. ``max_entries`` bounds the entries in the row: it counts all unknowns of these cells.
            while position + max_entries > len(half_columns):
                half_columns, values = _double_length(half_columns), _double_length(values)
            slot[v], half_columns[position], values[position] = position, v, 0.0
            position += 1
            # 3. Row v of Pᵀ (A p), from v on: each unknown w sums the contributions of its cells. Slots
            # before ``first`` belong to earlier rows.
            for s in range(count):
                j, product_row = np.uint32(near[s]), np.uint32(s) * n
                turn[j] = -1
                for q in range(np.uint32(offsets[j]), np.uint32(offsets[j + 1])):
                    w = np.uint32(indices[q])
                    if w < v:
                        continue
                    t = 0.0
                    for b in range(n):
                        t += product[product_row + b] * fitted[q, b]
                    if slot[w] >= first:
                        values[slot[w]] += t
                    else:
                        slot[w], half_columns[position], values[position] = position, w, t
                        position += 1
            rows[v + 1] = position
        return rows, half_columns[:position], values[:position]

    return galerkin_half  # type: ignore[no-any-return]


@helper(allocates=True)
def _double_length(array):
    """Return a copy with twice the length, the second half uninitialised."""
    longer = np.empty(2 * len(array), array.dtype)
    for k in range(len(array)):
        longer[k] = array[k]
    return longer


@kernel
def drop_small_entries(rows, columns, values, vertices, small, small_bubbles, small_vertices):
    """Drop from a symmetric matrix C the entries c_ij that are small relative to c_ii and c_jj.

    C is given by its upper half, with the diagonal entry first in each row. The result is a CSR of both
    halves with sorted columns. Unknowns from ``vertices`` on are bubbles. With d_ij = (c_ii c_jj)^½:

    - entries |c_ij| ≤ ``small`` d_ij are dropped, and between two bubbles entries up to ``small_bubbles``
      d_ij; the latter add |c_ij| (c_ii / c_jj)^½ to c_ii and |c_ij| (c_jj / c_ii)^½ to c_jj, which makes
      the change semidefinite;
    - between two vertices other entries 0 < c_ij ≤ ``small_vertices`` d_ij move to both diagonal entries:
      rows keep their sums, and the change is semidefinite, unlike for negative entries. Entries stay if
      only small entries join the groups of both vertices, and in rows where small entries are too large in
      total.
    """
    n = len(rows) - 1
    root, additions, light = np.zeros(n), np.zeros(n), np.zeros(n)
    for i in range(n):
        root[i] = np.sqrt(max(values[rows[i]], 0.0))
    # 1. Group the unknowns joined by larger entries. ``light`` sums the magnitudes of the others by vertex.
    group = np.arange(n)
    for i in range(vertices if small_vertices > 0.0 else 0):
        for k in range(rows[i] + 1, rows[i + 1]):
            j, size = columns[k], abs(values[k])
            if size > small_vertices * root[i] * root[j]:
                group[_group_of(group, j)] = _group_of(group, i)
            elif j < vertices:
                light[i] += size
                light[j] += size
    # 2. Choose the entries to keep, add the others to ``additions``, and count entries of both halves by row.
    keep, starts = np.empty(len(columns), np.bool_), np.zeros(n + 1, np.int32)
    for i in range(n):
        firm = light[i] > _MOST_ADDED * root[i] ** 2
        for k in range(rows[i], rows[i + 1]):
            j, size = columns[k], abs(values[k])
            d_ij = root[i] * root[j]
            bubbles = i >= vertices  # then j, which is at least i, is a bubble too
            keep[k] = size > (small_bubbles if bubbles else small) * d_ij or i == j
            if bubbles and not keep[k] and d_ij > 0.0:
                additions[i] += size * root[i] / root[j]
                additions[j] += size * root[j] / root[i]
            elif keep[k] and i < j < vertices and 0.0 < values[k] <= small_vertices * d_ij:
                heavy = firm or light[j] > _MOST_ADDED * root[j] ** 2
                if not heavy and _group_of(group, i) == _group_of(group, j):
                    keep[k] = False
                    additions[i] += values[k]
                    additions[j] += values[k]
            starts[i + 1] += keep[k]
            starts[j + 1] += keep[k] and i != j
    # 3. Write both halves in sorted order, without a sort: two passes over the rows.
    for j in range(n):
        starts[j + 1] += starts[j]
    places, sorted_columns, data = starts[:-1].copy(), np.empty(starts[n], np.int32), np.empty(starts[n])
    for i in range(n):  # the part left of the diagonal comes sorted, as rows are visited in order
        for k in range(rows[i] + 1, rows[i + 1]):
            if keep[k]:
                j = columns[k]
                sorted_columns[places[j]], data[places[j]] = i, values[k]
                places[j] += 1
    for j in range(n):  # and so does its transpose
        diagonal = places[j]
        sorted_columns[diagonal], data[diagonal] = j, values[rows[j]] + additions[j]
        places[j] += 1
        for k in range(starts[j], diagonal):
            i = sorted_columns[k]
            sorted_columns[places[i]], data[places[i]] = j, data[k]
            places[i] += 1
    return starts, sorted_columns, data


@helper
def _group_of(group, i):
    """Return the root of i in a union–find forest, halving the path."""
    while group[i] != i:
        group[i] = group[group[i]]
        i = group[i]
    return i


@kernel(reorder_sums=True)
def multiply_rows(blocks, offsets, rows):
    """Multiply the rows of each cell c, ``rows[offsets[c]:offsets[c + 1]]``, by its ``(n, n)`` block."""
    product = np.empty_like(rows)
    for c in range(len(blocks)):
        for k in range(offsets[c], offsets[c + 1]):
            for q in range(rows.shape[1]):
                total = 0.0
                for r in range(rows.shape[1]):
                    total += blocks[c, q, r] * rows[k, r]
                product[k, q] = total
    return product
