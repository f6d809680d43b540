"""Kernels of C = Pᵀ A P, A in blocks, each cell having a few unknowns of C.

``offsets, indices`` are the unknowns of the cells, ``fitted (·, n)`` the columns of P on the cell.
"""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import kernel

__all__ = ["galerkin", "galerkin_pattern", "thinned"]


@kernel
def galerkin_pattern(indptr, columns, offsets, indices, size):
    """Rows and columns of C, not sorted: unknowns of cells that share a block of A."""
    n = len(offsets) - 1
    starts = np.zeros(size + 1, np.int64)
    for k in indices:
        starts[k + 1] += 1
    for k in range(size):
        starts[k + 1] += starts[k]
    holders, fill = np.empty(len(indices), np.int32), starts.copy()
    for c in range(n):
        for k in range(offsets[c], offsets[c + 1]):
            holders[fill[indices[k]]] = c
            fill[indices[k]] += 1
    rows, seen, marked = np.zeros(size + 1, np.int64), np.full(n, -1), np.full(size, -1)
    found, position = np.empty(32 * size, np.int32), 0
    for v in range(size):
        for a in range(starts[v], starts[v + 1]):
            for k in range(indptr[holders[a]], indptr[holders[a] + 1]):
                j = columns[k]
                if seen[j] == v:
                    continue
                seen[j] = v
                if position + offsets[j + 1] - offsets[j] > len(found):
                    longer = np.empty(len(found) + len(found) // 2 + offsets[j + 1] - offsets[j], np.int32)
                    longer[:position] = found[:position]
                    found = longer
                for q in range(offsets[j], offsets[j + 1]):
                    w = indices[q]
                    if marked[w] != v:
                        marked[w] = v
                        found[position] = w
                        position += 1
        rows[v + 1] = position
    return rows, found[:position]


@kernel(reorder_sums=True)
def galerkin(indptr, columns, blocks, offsets, indices, fitted, rows, found):
    """Values of C in the pattern ``rows, found``."""
    n, size = fitted.shape[1], len(rows) - 1
    values = np.zeros(len(found))
    local, place = np.full(size, -1), np.empty(size, np.int64)
    widest = 0
    for i in range(len(offsets) - 1):
        count = 0
        for k in range(indptr[i], indptr[i + 1]):
            count += offsets[columns[k] + 1] - offsets[columns[k]]
        widest = max(widest, count)
    product, names, turned = np.empty((widest, n)), np.empty(widest, np.int64), np.empty((n, n))
    for i in range(len(offsets) - 1):
        count = 0
        for k in range(indptr[i], indptr[i + 1]):
            j = columns[k]
            for a in range(n):
                for b in range(n):
                    turned[b, a] = blocks[k, a, b]
            for q in range(offsets[j], offsets[j + 1]):
                w = indices[q]
                if local[w] < 0:
                    local[w], names[count] = count, w
                    for a in range(n):
                        product[count, a] = 0.0
                    count += 1
                out = product[local[w]]
                for b in range(n):
                    t = fitted[q, b]
                    row = turned[b]
                    for a in range(n):
                        out[a] += row[a] * t
        for q in range(offsets[i], offsets[i + 1]):
            v = indices[q]
            for k in range(rows[v], rows[v + 1]):
                place[found[k]] = k
            for w in range(count):
                t = 0.0
                for a in range(n):
                    t += fitted[q, a] * product[w, a]
                values[place[names[w]]] += t
        for w in range(count):
            local[names[w]] = -1
    return values


@kernel
def thinned(rows, columns, values, vertices, small, small_bubbles):
    """A symmetric matrix with sorted columns, without entries that are small beside their diagonal ones.

    Unknowns from ``vertices`` on are bubbles. An entry is small if it is at most ``small_bubbles`` times the
    root of both diagonal ones, between two bubbles, or ``small`` times that. Constants, the same on all
    vertices and 0 on bubbles, keep their energy: an entry between vertices goes to the diagonal. One between
    bubbles does so in magnitude, which adds a semidefinite matrix.
    """
    n = len(rows) - 1
    root, added, starts = np.zeros(n), np.zeros(n), np.zeros(n + 1, np.int32)
    for i in range(n):
        for k in range(rows[i], rows[i + 1]):
            if columns[k] == i:
                root[i] = np.sqrt(values[k])
    kept = np.empty(len(columns), np.bool_)
    for i in range(n):
        for k in range(rows[i], rows[i + 1]):
            j = columns[k]
            bubbles = i >= vertices and j >= vertices
            kept[k] = abs(values[k]) > (small_bubbles if bubbles else small) * root[i] * root[j]
            if kept[k]:
                starts[j + 1] += 1
            elif bubbles:
                added[i] += abs(values[k])
            elif i < vertices and j < vertices:
                added[i] += values[k]
    for j in range(n):
        starts[j + 1] += starts[j]
    places, sorted_columns, found = starts[:-1].copy(), np.empty(starts[n], np.int32), np.empty(starts[n])
    for i in range(n):  # the transpose of a matrix has its columns sorted
        for k in range(rows[i], rows[i + 1]):
            if kept[k]:
                j = columns[k]
                sorted_columns[places[j]], found[places[j]] = i, values[k] + (added[i] if i == j else 0.0)
                places[j] += 1
    return starts, sorted_columns, found
