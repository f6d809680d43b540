"""Outlines of flat patches of faces: the edges around each as one loop, where they are one."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import kernel


@kernel
def outlines(offsets, tails, heads, n_points):
    """Vertices of each patch in order, and whether its edges are one loop that meets no vertex twice.

    The edges of patch p, in any order, are those from ``offsets[p]`` to ``offsets[p + 1]``, each from a point
    ``tails`` to a point ``heads``; a patch without any is no such loop, and the vertices of one that is none
    are of no use.
    """
    n = len(offsets) - 1
    vertices, whole = np.empty(len(tails), np.int64), np.zeros(n, np.bool_)
    leaving = np.full(n_points, -1, np.int64)  # edge of the patch at hand that leaves a point
    for p in range(n):
        # 1. At most one edge leaves each point. Numbers below ``begin`` are of patches before.
        begin, end = offsets[p], offsets[p + 1]
        once = end > begin
        for h in range(begin, end):
            once &= leaving[tails[h]] < begin
            leaving[tails[h]] = h
        if not once:
            continue
        # 2. Follow the edges: they are one loop if they return to the first one after all, not before.
        h = begin
        for k in range(begin, end):
            vertices[k] = tails[h]
            h = leaving[heads[h]]
            if h < begin:
                break
            if h == begin:
                whole[p] = k == end - 1
                break
    return vertices, whole
