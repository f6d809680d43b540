"""Parts that are not connected or too wide, found in one pass over the cells, in any order.

A part is connected if each of its cells except the first is connected, within the part, with one of a smaller
number. For most cells a neighbour is such a cell: only the others are searched from.
"""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel
from agglo_core.compiled.graphs import flood

_TOGETHER = np.int64(1024)
"""Cells that are listed at a time: what was read of them is in the cache when it is read again."""

_CROWD = np.uint64(16)
"""Neighbours from which on those of a cell are not read: each of its neighbours would read all of them."""


@helper
def _near_earlier(x, indptr, indices, labels):
    """Return whether a neighbour of cell x with its label has one before x.

    Neighbours with a crowd of their own are passed over.
    """
    own, met = labels[x], False
    for h in range(np.uint64(indptr[x]), np.uint64(indptr[x + ONE])):
        j = np.uint64(np.uint32(indices[h]))
        same, begin, end = labels[j] == own, np.uint64(indptr[j]), np.uint64(indptr[j + ONE])
        for g in range(begin, end if end - begin < _CROWD else begin):
            i = np.uint32(indices[g])
            met |= same & (i < x) & (labels[i] == own)  # no branch: it would be mispredicted half the time
    return met


@helper
def _meets_earlier(x, indptr, indices, labels, marks, queue, left):
    """Return whether cell x is connected in its part with one before it, and ``left`` less the edges read.

    The search gives up once that is negative. Marks of other searches differ from x.
    """
    own, done, filled, met, mark = labels[x], np.uint64(0), ONE, False, np.int32(x)
    queue[0], marks[x] = mark, mark
    # A search in breadth within the part, which ends at the first cell before x.
    while done < filled and not met:
        i = np.uint64(np.uint32(queue[done]))
        done += ONE
        begin, end = np.uint64(indptr[i]), np.uint64(indptr[i + ONE])
        left -= np.int64(end - begin)
        if left < 0:
            break
        for h in range(begin, end):
            j = np.uint32(indices[h])
            same = labels[j] == own
            met |= same & (j < x)
            queue[filled] = j  # kept only if it is new; branches would be mispredicted half the time
            filled += np.uint64(same & (marks[j] != mark))
            marks[j] = mark
    return met, left


@kernel
def lone_cells(start, stop, indptr, indices, labels, count, lone, marks, queue):
    """List the cells start..stop − 1 that are not connected with one of their label before them.

    Returns how many. Listed are also those that are the first there of one of the ``count`` labels, and those
    of which it is not known, as the searches had read as many edges as there are. ``marks (n,)`` are zeros at
    first, and ``queue`` has room for n + 1.
    """
    left, kept, seen = len(indices), np.uint64(0), np.zeros(count, np.bool_)
    for first in range(start, stop, _TOGETHER):
        # 1. Cells without a neighbour of their label before them.
        listed = kept
        for i in range(np.uint64(first), np.uint64(min(first + _TOGETHER, stop))):
            own, joined = labels[i], False
            for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
                j = np.uint32(indices[h])
                joined |= (j < i) & (labels[j] == own)  # no branch: it would be mispredicted half the time
            lone[listed] = i
            listed += np.uint64(not joined)
        # 2. Of these, those that reach no such cell over a neighbour, or further away. The first of a
        #    label need not be searched from: it stays in any case.
        for k in range(kept, listed):
            x = np.uint64(np.uint32(lone[k]))
            own = np.uint32(labels[x])
            met = seen[own] and _near_earlier(x, indptr, indices, labels)
            if not met and seen[own] and left >= 0:
                met, left = _meets_earlier(x, indptr, indices, labels, marks, queue, left)
            seen[own] = True
            lone[kept] = x
            kept += np.uint64(not met)
    return np.int64(kept)


@helper
def _found_apart(lone, indptr, indices, labels, asked, seen, broken, marks, queue):
    """Mark the parts ``asked`` with a second cell that may not be connected.

    Returns whether there are any. A cell may be listed only because it was the first of its part in a range
    of cells: those before it were in another call of :func:`lone_cells`.
    """
    left, doubtful = len(indices), False
    seen[:] = False
    for k in range(len(lone)):
        x = np.uint64(np.uint32(lone[k]))
        own = np.uint32(labels[x])
        # The first cell of a part proves nothing; each later one is searched from. Once too many edges were
        # read, its part is in doubt without a search.
        if seen[own] and asked[own] and not broken[own]:
            met = False
            if left >= 0:
                met, left = _meets_earlier(x, indptr, indices, labels, marks, queue, left)
            broken[own] = not met
            doubtful |= not met
        seen[own] = True
    return doubtful


@kernel
def broken_parts(lone, indptr, indices, labels, asked):
    """Mark the parts ``asked (k,)`` that are not connected.

    ``lone`` are all cells listed by ``lone_cells``. Searches decide for most parts. Only those left in doubt
    are flooded: nearly always none.
    """
    n, doubtful = len(labels), False
    seen, broken = np.zeros(len(asked), np.bool_), np.zeros(len(asked), np.bool_)
    # 1. One lone cell, the first, is in every part: only parts with several may be broken.
    for k in range(len(lone)):
        own = np.uint32(labels[np.uint32(lone[k])])
        doubtful |= seen[own] & asked[own]
        seen[own] = True
    if not doubtful:
        return broken
    # 2. Searches from the others, with all cells before them in sight.
    marks, nodes = np.zeros(n, np.int32), np.empty(n + 1, np.int32)
    if not _found_apart(lone, indptr, indices, labels, asked, seen, broken, marks, nodes):
        return broken
    # 3. Parts in doubt are flooded from each cell that is not reached yet: a second flood is a second
    #    component.
    for i in range(n):
        marks[i] = labels[i] if broken[labels[i]] else -1
    for p in range(len(asked)):
        seen[p], broken[p] = False, False
    for seed in range(n):
        own = labels[seed]
        if marks[seed] >= 0:
            broken[own] |= seen[own]  # a second component
            seen[own] = True
            flood(seed, indptr, indices, marks, nodes, 0)
    return broken


@kernel
def extend_parts(start, stop, labels, asked, vertex_offsets, vertices, points, bounds):
    """Extend the ``bounds (k, 8)`` of the parts ``asked (k,)`` by their cells among ``start..stop − 1``.

    They are the least places of vertices along four directions, then the largest: in the plane along x, y and
    the diagonals x + y and x − y, in space along x, y and z.
    """
    planar = points.shape[1] == 2
    for i in range(np.uint64(start), np.uint64(stop)):
        own = np.uint64(labels[i])
        if not asked[own]:
            continue
        # Extents are kept in variables over the vertices of a cell, then written back.
        known = bounds[own]
        x0, y0, u0, v0 = known[0], known[1], known[2], known[3]
        x1, y1, u1, v1 = known[4], known[5], known[6], known[7]
        for h in range(np.uint64(vertex_offsets[i]), np.uint64(vertex_offsets[i + ONE])):
            vertex = np.uint32(vertices[h])
            x, y = points[vertex, 0], points[vertex, 1]
            u = x + y if planar else points[vertex, 2]
            v = x - y if planar else 0.0
            x0, y0, u0, v0 = min(x0, x), min(y0, y), min(u0, u), min(v0, v)
            x1, y1, u1, v1 = max(x1, x), max(y1, y), max(u1, u), max(v1, v)
        known[0], known[1], known[2], known[3] = x0, y0, u0, v0
        known[4], known[5], known[6], known[7] = x1, y1, u1, v1
