"""Kernels of C = Pᵀ A P, A in blocks, each cell having a few unknowns of C.

``offsets, indices`` are the unknowns of the cells, ``fitted (·, n)`` the columns of P on the cell.
"""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import kernel

__all__ = ["galerkin", "galerkin_pattern", "without_small"]


@kernel
def galerkin_pattern(indptr, columns, offsets, indices, size):
    """Rows and sorted columns of C: unknowns of cells that share a block of A."""
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
    found = np.empty(0, np.int32)
    for again in range(2):
        seen[:], marked[:] = -1, -1
        for v in range(size):
            position = rows[v]
            for a in range(starts[v], starts[v + 1]):
                for k in range(indptr[holders[a]], indptr[holders[a] + 1]):
                    j = columns[k]
                    if seen[j] == v:
                        continue
                    seen[j] = v
                    for q in range(offsets[j], offsets[j + 1]):
                        w = indices[q]
                        if marked[w] != v:
                            marked[w] = v
                            if again:
                                found[position] = w
                            position += 1
            if again:
                found[rows[v] : position].sort()
            else:
                rows[v + 1] = position
        if not again:
            found = np.empty(rows[size], np.int32)
    return rows, found


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
def without_small(rows, columns, values, relative):
    """The matrix without entries of at most ``relative`` times the root of the two diagonal ones."""
    n = len(rows) - 1
    root = np.zeros(n)
    for i in range(n):
        for k in range(rows[i], rows[i + 1]):
            if columns[k] == i:
                root[i] = np.sqrt(values[k])
    kept_rows, kept_columns, kept_values = np.zeros(n + 1, np.int64), columns.copy(), values.copy()
    position = 0
    for i in range(n):
        for k in range(rows[i], rows[i + 1]):
            if abs(values[k]) > relative * root[i] * root[columns[k]]:
                kept_columns[position], kept_values[position] = columns[k], values[k]
                position += 1
        kept_rows[i + 1] = position
    return kept_rows, kept_columns[:position], kept_values[:position]
