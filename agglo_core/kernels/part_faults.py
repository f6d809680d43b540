"""Parts that are not connected or too wide, told in one pass over the cells, in any order."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import kernel
from agglo_core.kernels.graphs import flood

__all__ = ["broken_parts", "extend_parts"]


@kernel
def broken_parts(indptr, indices, labels, asked):
    """Which of the parts ``asked (k,)`` are not connected; the cells of others are skipped."""
    n = len(labels)
    waiting, nodes = np.empty(n, np.int32), np.empty(n + 1, np.int32)
    for i in range(n):
        waiting[i] = labels[i] if asked[labels[i]] else -1
    seen, broken = np.zeros(len(asked), np.bool_), np.zeros(len(asked), np.bool_)
    for seed in range(n):
        own = waiting[seed]
        if own >= 0:
            broken[own] |= seen[own]  # a second component
            seen[own] = True
            flood(seed, indptr, indices, waiting, nodes, 0)
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
