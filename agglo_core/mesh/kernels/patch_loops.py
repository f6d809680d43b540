"""Trace the boundary of flat face patches as one closed loop, where possible."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import kernel


@kernel
def outlines(offsets, tails, heads, n_points):
    """Return the boundary vertices of each patch in order, and a flag for patches with one simple loop.

    The edges of patch p, in any order, are ``offsets[p]`` to ``offsets[p + 1]``, each from a point in
    ``tails`` to a point in ``heads``. A patch without edges is no simple loop, and the vertices of such
    patches are undefined.
    """
    n = len(offsets) - 1
    vertices, whole = np.empty(len(tails), np.int64), np.zeros(n, np.bool_)
    leaving = np.full(n_points, -1, np.int64)  # edge of the current patch that leaves a point
    for p in range(n):
        # 1. At most one edge may leave each point. Numbers below ``begin`` belong to earlier patches.
        begin, end = offsets[p], offsets[p + 1]
        is_simple = end > begin
        for h in range(begin, end):
            is_simple &= leaving[tails[h]] < begin
            leaving[tails[h]] = h
        if not is_simple:
            continue
        # 2. Follow the edges: they form one loop if the walk returns to the first edge after all edges, not
        #    earlier.
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
