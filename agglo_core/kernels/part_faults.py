"""Parts that are not connected or too wide, told in one pass over the cells, in any order."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import helper, kernel
from agglo_core.kernels.graphs import flood

__all__ = ["broken_parts", "extend_parts", "lone_cells"]


@kernel(allocates=False)
def lone_cells(start, stop, indptr, indices, labels, lone):
    """List the cells start..stop − 1 with no neighbour of their label before them; returns how many.

    The first cell of a part is one of them, and so is that of each of its components.
    """
    count = 0
    for i in range(start, stop):
        own, joined = labels[i], False
        for h in range(indptr[i], indptr[i + 1]):
            j = indices[h]
            joined |= (j < i) & (labels[j] == own)  # no branch: it would be mispredicted half the time
        lone[count] = i
        count += not joined
    return count


@helper
def _meets_earlier(x, indptr, indices, labels, marks, queue, left):
    """Whether cell x is connected in its part with one before it; and ``left`` less the edges read.

    The search gives up once that is negative. Marks of other searches differ from x.
    """
    own, done, filled, met = labels[x], 0, 1, False
    queue[0], marks[x] = x, x
    while done < filled and not met:
        i = queue[done]
        done += 1
        left -= indptr[i + 1] - indptr[i]
        if left < 0:
            break
        for h in range(indptr[i], indptr[i + 1]):
            j = indices[h]
            same = labels[j] == own
            met |= same & (j < x)
            queue[filled] = j  # kept only if it is new; branches would be mispredicted half the time
            filled += same & (marks[j] != x)
            marks[j] = x
    return met, left


@kernel
def broken_parts(lone, indptr, indices, labels, asked):
    """Which of the parts ``asked (k,)`` are not connected; ``lone`` are all cells told by ``lone_cells``.

    A part is connected if each of its cells but the first is with one before it. Lone cells look for one,
    which is near in a good numbering. Should they read more edges than there are, the parts are flooded.
    """
    n, left = len(labels), len(indices)
    marks, nodes = np.zeros(n, np.int32), np.empty(n + 1, np.int32)
    seen, broken = np.zeros(len(asked), np.bool_), np.zeros(len(asked), np.bool_)
    for x in lone:
        own = labels[x]
        if not seen[own]:
            seen[own] = True
        elif asked[own] and not broken[own]:
            met, left = _meets_earlier(x, indptr, indices, labels, marks, nodes, left)
            if left < 0:
                break
            broken[own] = not met
    if left >= 0:
        return broken
    for p in range(len(asked)):
        seen[p] = False
    for i in range(n):
        marks[i] = labels[i] if asked[labels[i]] else -1
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
    for i in range(start, stop):
        own = labels[i]
        if not asked[own]:
            continue
        known = bounds[own]
        x0, y0, u0, v0 = known[0], known[1], known[2], known[3]
        x1, y1, u1, v1 = known[4], known[5], known[6], known[7]
        for h in range(vertex_offsets[i], vertex_offsets[i + 1]):
            x, y = points[vertices[h], 0], points[vertices[h], 1]
            u = x + y if planar else points[vertices[h], 2]
            v = x - y if planar else 0.0
            x0, y0, u0, v0 = min(x0, x), min(y0, y), min(u0, u), min(v0, v)
            x1, y1, u1, v1 = max(x1, x), max(y1, y), max(u1, u), max(v1, v)
        known[0], known[1], known[2], known[3] = x0, y0, u0, v0
        known[4], known[5], known[6], known[7] = x1, y1, u1, v1
