"""Compiled loops for quotient graphs: edges between parts, and the distinct vertices per part.

The cells are read in storage order and their data moved to the position of their part, because a traversal
part by part would cause a cache miss per cell.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@helper(allocates=True)
def _edges_by_part(labels, n_parts, indptr, indices, interface):
    """Group the edges between different parts by the part that they leave.

    Return the range ``first`` to ``last`` of each part's edges, the outer cells, and the interfaces.

    Every part has one spare position, because inner edges are also written and then overwritten.
    """
    first = np.ones(n_parts + 1, np.int64)
    # 1. Number of outer edges per part, plus one.
    for c in range(len(labels)):
        part, outer = labels[c], 0
        for h in range(indptr[c], indptr[c + 1]):
            outer += labels[indices[h]] != part
        first[part] += outer
    # 2. Convert counts to positions; ``last`` advances as edges are written.
    filled = 0
    for p in range(n_parts + 1):
        size = first[p]
        first[p] = filled
        filled += size
    last = first.copy()
    # 3. Write the edges cell by cell; the next edge overwrites an inner one.
    beyond, share = np.empty(filled, np.int32), np.empty(filled)
    for c in range(len(labels)):
        part = labels[c]
        at = last[part]
        for h in range(indptr[c], indptr[c + 1]):
            beyond[at] = indices[h]
            share[at] = interface[h]
            at += labels[indices[h]] != part  # a branch would often be mispredicted
        last[part] = at
    return first, last, beyond, share


@kernel
def quotient_edges(labels, n_parts, indptr, indices, interface):
    """Return the quotient graph as CSR: adjacent parts, in arbitrary order, and their interfaces.

    The graph has no loops.

    Interfaces are added in the order of the sparse product G A Gᵀ, with bitwise equal results: first the
    interfaces of the part with one outer cell, then those of one neighbour's cells, the last cell first.
    """
    first, last, beyond, share = _edges_by_part(labels, n_parts, indptr, indices, interface)
    place = np.full(len(labels), -1, np.int64)  # position of an outer cell
    slot = np.full(n_parts, -1, np.int64)  # position of a neighbour
    rows = np.zeros(n_parts + 1, np.int64)
    columns, values = np.empty(len(beyond), np.int32), np.empty(len(beyond))
    m = 0
    for p in range(n_parts):
        end = first[p]
        # 1. Sum the edges of the part to each outer cell, in place. Positions of earlier parts lie before the
        #    first position of this part, so nothing must be cleared.
        for s in range(first[p], last[p]):
            if place[beyond[s]] >= first[p]:
                share[place[beyond[s]]] += share[s]
            else:
                place[beyond[s]] = end
                beyond[end], share[end] = beyond[s], share[s]
                end += 1
        # 2. Sum the results, last cell first, by adjacent part: one entry of the row each.
        for s in range(end - 1, first[p] - 1, -1):
            neighbour = labels[beyond[s]]
            if slot[neighbour] >= rows[p]:
                values[slot[neighbour]] += share[s]
            else:
                slot[neighbour] = m
                columns[m], values[m] = neighbour, share[s]
                m += 1
        rows[p + 1] = m
    return rows, columns[:m].copy(), values[:m].copy()


@kernel
def union_of_rows(labels, n_parts, offsets, values, n_values):
    """Return the distinct values in the CSR rows of each part, as CSR.

    Values are below ``n_values``.
    """
    starts = np.zeros(n_parts + 2, np.int64)
    # 1. Counting sort of all rows by part. Counts are shifted by two: ``starts[p + 1]`` is the start of part
    #    p, and advances to its end as rows are written.
    for c in range(len(labels)):
        starts[labels[c] + 2] += offsets[c + 1] - offsets[c]
    for p in range(n_parts):
        starts[p + 2] += starts[p + 1]
    entries = np.empty(len(values), np.int32)
    for c in range(len(labels)):
        at = starts[labels[c] + 1]
        for h in range(offsets[c], offsets[c + 1]):
            entries[at] = values[h]
            at += 1
        starts[labels[c] + 1] = at
    # 2. Drop repeated values of each part, in place.
    rows = np.zeros(n_parts + 1, np.int64)
    latest = np.full(n_values, -1, np.int32)  # last part with a value
    m = 0
    for p in range(n_parts):
        for s in range(starts[p], starts[p + 1]):
            value = entries[s]
            entries[m] = value
            m += latest[value] != p
            latest[value] = p
        rows[p + 1] = m
    return rows, entries[:m].copy()
