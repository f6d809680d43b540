"""Parts that are not connected or too wide, told in one pass over the cells, in any order."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import kernel

__all__ = ["broken_parts", "extend_parts"]


@kernel
def broken_parts(indptr, indices, labels, asked):
    """Which of the parts ``asked (k,)`` are not connected, by union-find; the cells of others are skipped."""
    parent = np.empty(len(labels), np.int32)
    for i in range(len(labels)):
        own, root = labels[i], np.int32(i)
        if not asked[own]:
            continue
        parent[i] = root
        for h in range(indptr[i], indptr[i + 1]):
            j = indices[h]
            joined = (j < i) & (labels[j] == own)
            other = parent[j] if joined else root  # a branch would be mispredicted half the time
            if other == root:
                continue
            while parent[other] != other:
                other = parent[other]
            if other != root:
                root, child = min(root, other), max(root, other)
                parent[child] = root
        parent[i] = root
    seen, broken = np.zeros(len(asked), np.bool_), np.zeros(len(asked), np.bool_)
    for i in range(len(labels)):
        own = labels[i]
        if asked[own] and parent[i] == i:  # a component; a second one of its part?
            broken[own] |= seen[own]
            seen[own] = True
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
