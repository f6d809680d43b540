"""Search for disconnected and for too wide parts in one pass over the cells, in any order.

A part is connected if each of its cells except the first is connected, within the part, with a cell of
smaller number. For most cells a neighbour is such a cell. Only the other cells need a search.
"""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel
from agglo_core.compiled.graphs import flood

_TOGETHER = np.int64(1024)
"""Number of cells listed at a time, so that their data are still in the cache when read again
(benchmarks/partition.py)."""

_CROWD = np.uint64(16)
"""Neighbour count from which the neighbours of a cell are not read, as each neighbour would read all:
quadratic time around such a cell (benchmarks/pathologies.py, hub)."""


@helper
def _near_earlier(x, indptr, indices, labels):
    """Return True if a neighbour of cell x has a neighbour before x, all in one part.

    Neighbours with a large neighbour count are skipped.
    """
    label, is_linked = labels[x], False
    for h in range(np.uint64(indptr[x]), np.uint64(indptr[x + ONE])):
        j = np.uint64(np.uint32(indices[h]))
        in_part, begin, end = labels[j] == label, np.uint64(indptr[j]), np.uint64(indptr[j + ONE])
        for g in range(begin, end if end - begin < _CROWD else begin):
            i = np.uint32(indices[g])
            # No branch: it would be mispredicted half the time.
            is_linked |= in_part & (i < x) & (labels[i] == label)
    return is_linked


@helper
def _meets_earlier(x, indptr, indices, labels, marks, queue, budget):
    """Search the part of cell x for a connected cell before x, and return success and remaining budget.

    The search fails when the ``budget`` is negative. Marks of other searches differ from x.
    """
    label, head, filled, is_linked, mark = labels[x], np.uint64(0), ONE, False, np.int32(x)
    queue[0], marks[x] = mark, mark
    # Breadth-first search within the part, until the first cell before x.
    while head < filled and not is_linked:
        i = np.uint64(np.uint32(queue[head]))
        head += ONE
        begin, end = np.uint64(indptr[i]), np.uint64(indptr[i + ONE])
        budget -= np.int64(end - begin)
        if budget < 0:
            break
        for h in range(begin, end):
            j = np.uint32(indices[h])
            in_part = labels[j] == label
            is_linked |= in_part & (j < x)
            queue[filled] = j  # kept only if new; branches would be mispredicted half the time
            filled += np.uint64(in_part & (marks[j] != mark))
            marks[j] = mark
    return is_linked, budget


@kernel
def lone_cells(start, stop, indptr, indices, labels, count, lone, marks, queue):
    """List the cells start..stop − 1 that are not connected with an earlier cell of equal label.

    Returns their number. The list also contains the first cell in the range of each of the ``count`` labels,
    and cells left undecided after the searches read as many edges as there are. ``marks (n,)`` are initially
    zero, and ``queue`` has length n + 1.
    """
    budget, n_lone, has_cell = len(indices), np.uint64(0), np.zeros(count, np.bool_)
    for first in range(start, stop, _TOGETHER):
        # 1. Cells without an earlier neighbour of their label.
        listed = n_lone
        for i in range(np.uint64(first), np.uint64(min(first + _TOGETHER, stop))):
            label, is_joined = labels[i], False
            for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
                j = np.uint32(indices[h])
                # No branch: it would be mispredicted half the time.
                is_joined |= (j < i) & (labels[j] == label)
            lone[listed] = i
            listed += np.uint64(not is_joined)
        # 2. Keep the cells that do not reach an earlier cell via a neighbour, or farther away. The first cell
        #    of a label is kept without a search.
        for k in range(n_lone, listed):
            x = np.uint64(np.uint32(lone[k]))
            label = np.uint32(labels[x])
            is_linked = has_cell[label] and _near_earlier(x, indptr, indices, labels)
            if not is_linked and has_cell[label] and budget >= 0:
                is_linked, budget = _meets_earlier(x, indptr, indices, labels, marks, queue, budget)
            has_cell[label] = True
            lone[n_lone] = x
            n_lone += np.uint64(not is_linked)
    return np.int64(n_lone)


@helper
def _mark_doubtful_parts(lone, indptr, indices, labels, part_mask, has_cell, broken, marks, queue):
    """Mark parts in ``part_mask`` with two cells between which no connection was found.

    Returns True if there are any. A cell may be listed only as the first cell of its part in a range of
    cells: the earlier cells were in another call of :func:`lone_cells`.
    """
    budget, is_doubtful = len(indices), False
    has_cell[:] = False
    for k in range(len(lone)):
        x = np.uint64(np.uint32(lone[k]))
        part = np.uint32(labels[x])
        # The first cell of a part is always listed. Search from each later cell. After too many edges, the
        # part is doubtful without a search.
        if has_cell[part] and part_mask[part] and not broken[part]:
            is_linked = False
            if budget >= 0:
                is_linked, budget = _meets_earlier(x, indptr, indices, labels, marks, queue, budget)
            broken[part] = not is_linked
            is_doubtful |= not is_linked
        has_cell[part] = True
    return is_doubtful


@kernel
def broken_parts(lone, indptr, indices, labels, part_mask):
    """Mark the parts in ``part_mask (k,)`` that are not connected.

    ``lone`` are all cells listed by ``lone_cells``. Searches decide most parts. Only the remaining doubtful
    parts are flooded, in almost all cases none.
    """
    n, is_doubtful = len(labels), False
    has_cell, broken = np.zeros(len(part_mask), np.bool_), np.zeros(len(part_mask), np.bool_)
    # 1. Every part has one lone cell, its first. Only parts with several may be broken.
    for k in range(len(lone)):
        part = np.uint32(labels[np.uint32(lone[k])])
        is_doubtful |= has_cell[part] & part_mask[part]
        has_cell[part] = True
    if not is_doubtful:
        return broken
    # 2. Search from the other lone cells, with all earlier cells available.
    marks, nodes = np.zeros(n, np.int32), np.empty(n + 1, np.int32)
    if not _mark_doubtful_parts(lone, indptr, indices, labels, part_mask, has_cell, broken, marks, nodes):
        return broken
    # 3. Flood doubtful parts from each cell not reached yet: a second flood is a second component.
    for i in range(n):
        marks[i] = labels[i] if broken[labels[i]] else -1
    for p in range(len(part_mask)):
        has_cell[p], broken[p] = False, False
    for seed in range(n):
        part = labels[seed]
        if marks[seed] >= 0:
            broken[part] |= has_cell[part]  # a second component
            has_cell[part] = True
            flood(seed, indptr, indices, marks, nodes, 0)
    return broken


@kernel
def extend_parts(start, stop, labels, part_mask, vertex_offsets, vertices, points, bounds):
    """Extend the extents ``bounds (k, 8)`` of the parts in ``part_mask (k,)`` by their cells' vertices.

    Only the cells ``start..stop − 1`` are read.

    The bounds are the smallest vertex coordinates along four directions, then the largest: x, y and the
    diagonals x + y and x − y in 2-D, or x, y and z in 3-D.
    """
    planar = points.shape[1] == 2
    for i in range(np.uint64(start), np.uint64(stop)):
        part = np.uint64(labels[i])
        if not part_mask[part]:
            continue
        # Keep the extents in variables over the vertices of a cell, then write them back.
        extents = bounds[part]
        x0, y0, u0, v0 = extents[0], extents[1], extents[2], extents[3]
        x1, y1, u1, v1 = extents[4], extents[5], extents[6], extents[7]
        for h in range(np.uint64(vertex_offsets[i]), np.uint64(vertex_offsets[i + ONE])):
            vertex = np.uint32(vertices[h])
            x, y = points[vertex, 0], points[vertex, 1]
            u = x + y if planar else points[vertex, 2]
            v = x - y if planar else 0.0
            x0, y0, u0, v0 = min(x0, x), min(y0, y), min(u0, u), min(v0, v)
            x1, y1, u1, v1 = max(x1, x), max(y1, y), max(u1, u), max(v1, v)
        extents[0], extents[1], extents[2], extents[3] = x0, y0, u0, v0
        extents[4], extents[5], extents[6], extents[7] = x1, y1, u1, v1
