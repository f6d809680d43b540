"""Quotients of graphs: the edges between parts, and the vertices of the cells of a part, each once.

Cells are read in their order, and what they have is moved to the place of their part: part by part, every
cell would be a cache miss.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@helper(allocates=True)
def _edges_by_part(labels, n_parts, indptr, indices, interface):
    """Edges that leave a part, part by part: ranges ``first``, ``last`` of parts, cells beyond, interfaces.

    Every part has one place to spare: an edge that stays inside is written, too, and then overwritten.
    """
    first = np.ones(n_parts + 1, np.int64)
    # 1. Number of edges that leave each part, plus one.
    for c in range(len(labels)):
        own, outer = labels[c], 0
        for h in range(indptr[c], indptr[c + 1]):
            outer += labels[indices[h]] != own
        first[own] += outer
    # 2. Numbers become places, and ``last`` moves along as edges are written.
    filled = 0
    for p in range(n_parts + 1):
        size = first[p]
        first[p] = filled
        filled += size
    last = first.copy()
    # 3. Edges, cell by cell; one that stays inside is overwritten by the next.
    beyond, share = np.empty(filled, np.int32), np.empty(filled)
    for c in range(len(labels)):
        own = labels[c]
        at = last[own]
        for h in range(indptr[c], indptr[c + 1]):
            beyond[at] = indices[h]
            share[at] = interface[h]
            at += labels[indices[h]] != own  # no branch: it would be mispredicted a third of the time
        last[own] = at
    return first, last, beyond, share


@kernel
def quotient_edges(labels, n_parts, indptr, indices, interface):
    """CSR of the quotient graph without loops; the neighbours in a row are in no particular order.

    Interfaces are added as in the product of sparse matrices G A Gᵀ, to the same last bit: first those of
    the part with a cell beyond, then those of cells of one neighbour, the cell met last first.
    """
    first, last, beyond, share = _edges_by_part(labels, n_parts, indptr, indices, interface)
    place = np.full(len(labels), -1, np.int64)  # of a cell beyond
    slot = np.full(n_parts, -1, np.int64)  # of a neighbour
    rows = np.zeros(n_parts + 1, np.int64)
    columns, values = np.empty(len(beyond), np.int32), np.empty(len(beyond))
    m = 0
    for p in range(n_parts):
        end = first[p]
        # 1. Edges of the part to one cell beyond are added up, in place. Places of earlier parts lie before
        #    its first one, so that nothing need be cleared.
        for s in range(first[p], last[p]):
            if place[beyond[s]] >= first[p]:
                share[place[beyond[s]]] += share[s]
            else:
                place[beyond[s]] = end
                beyond[end], share[end] = beyond[s], share[s]
                end += 1
        # 2. What is left, the last cell first, is added up by part beyond: an entry of the row each.
        for s in range(end - 1, first[p] - 1, -1):
            other = labels[beyond[s]]
            if slot[other] >= rows[p]:
                values[slot[other]] += share[s]
            else:
                slot[other] = m
                columns[m], values[m] = other, share[s]
                m += 1
        rows[p + 1] = m
    return rows, columns[:m].copy(), values[:m].copy()


@kernel
def union_of_rows(labels, n_parts, offsets, values, n_values):
    """CSR of the values of the rows of each part, each once; values are below ``n_values``."""
    starts = np.zeros(n_parts + 2, np.int64)
    # 1. Counting sort of all rows by part. Counts stand two places further: ``starts[p + 1]`` is where part
    #    p begins, and moves to its end as rows are written.
    for c in range(len(labels)):
        starts[labels[c] + 2] += offsets[c + 1] - offsets[c]
    for p in range(n_parts):
        starts[p + 2] += starts[p + 1]
    found = np.empty(len(values), np.int32)
    for c in range(len(labels)):
        at = starts[labels[c] + 1]
        for h in range(offsets[c], offsets[c + 1]):
            found[at] = values[h]
            at += 1
        starts[labels[c] + 1] = at
    # 2. Values met before in the part are dropped. The list is written over itself.
    rows = np.zeros(n_parts + 1, np.int64)
    latest = np.full(n_values, -1, np.int32)  # part that had a value
    m = 0
    for p in range(n_parts):
        for s in range(starts[p], starts[p + 1]):
            value = found[s]
            found[m] = value
            m += latest[value] != p
            latest[value] = p
        rows[p + 1] = m
    return rows, found[:m].copy()
