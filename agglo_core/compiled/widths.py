"""Test of sets of cells for vertices farther apart than a limit, faster than by the diameter."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel
from agglo_core.compiled.geometry import MANY, largest_distance, sort_along_x, widest_of_many

_ROUNDING = 1e-12  # relative to a squared distance, with a margin


@helper
def _square(v, x, y, z, points):
    """Return the squared distance from vertex v to the point (x, y, z), without z in 2-D."""
    last = points.shape[1] - 1
    a, b, c = points[v, 0] - x, points[v, 1] - y, (last - 1.0) * (points[v, last] - z)
    return a * a + b * b + c * c  # a loop over the dimensions takes twice the time


@helper
def _outside(cells, vertex_offsets, vertices, points, centre, inner, rim):
    """Write the vertices with squared distance ``inner`` or more from the centre, and return their number."""
    x, y, z, m = centre[0], centre[1], centre[len(centre) - 1], np.uint64(0)
    for k in range(len(cells)):
        i = np.uint64(cells[k])
        for h in range(np.uint64(vertex_offsets[i]), np.uint64(vertex_offsets[i + ONE])):
            rim[m] = vertices[h]  # no branch: it would be mispredicted
            m += np.uint64(_square(np.uint32(vertices[h]), x, y, z, points) >= inner)
    return np.int64(m)


@helper
def _reach(cells, vertex_offsets, vertices, points, centre):
    """Return the largest squared distance from centre to vertex, and the vertex count with duplicates."""
    x, y, z, most, count = centre[0], centre[1], centre[len(centre) - 1], 0.0, 0
    for k in range(len(cells)):
        i = np.uint64(cells[k])
        count += vertex_offsets[i + ONE] - vertex_offsets[i]
        for h in range(np.uint64(vertex_offsets[i]), np.uint64(vertex_offsets[i + ONE])):
            most = max(most, _square(np.uint32(vertices[h]), x, y, z, points))
    return most, count


@helper(allocates=True)
def is_wider(cells, vertex_offsets, vertices, points, centre, limit):
    """Return True if two vertices of the cells are farther apart than ``limit``.

    Both must lie outside the ball with radius ``limit`` − (largest distance to the ``centre``), where the
    centre is any point. If it lies in the middle of the cells, few vertices remain. These are sorted along x,
    so that the copies of a vertex, one per cell, are adjacent.
    """
    last = points.shape[1] - 1
    # 1. If all vertices are within r of the centre, no two are farther apart than 2 r.
    reach, count = _reach(cells, vertex_offsets, vertices, points, centre)
    least, inner = limit * limit * (1.0 - _ROUNDING), limit - np.sqrt(reach)
    if 4.0 * reach < least:
        return False
    # 2. Vertices outside the ball with radius limit − r, one copy per cell.
    inner = inner * inner * (1.0 - _ROUNDING) if inner > 0.0 else 0.0
    rim = np.empty(count + 1, np.int64)
    m = _outside(cells, vertex_offsets, vertices, points, centre, inner, rim)
    if last > 1:  # in 3-D there are many copies, and x is constant on grid planes
        return largest_distance(m, rim, centre, points) > limit
    # 3. In 2-D: sort, and drop adjacent copies.
    sort_along_x(m, rim, points)
    distinct, widest = min(m, 1), 0.0
    for k in range(1, m):
        rim[distinct] = rim[k]
        distinct += rim[distinct] != rim[distinct - 1]
    # 4. Many vertices: sorted search for a pair farther apart than the limit. Few: all pairs.
    if distinct > MANY:
        return np.sqrt(widest_of_many(distinct, rim, centre, points, reach, least)) > limit
    for i in range(1, distinct):
        x, y, z = points[rim[i], 0], points[rim[i], 1], points[rim[i], last]
        for j in range(i):
            widest = max(widest, _square(np.uint32(rim[j]), x, y, z, points))
    return np.sqrt(widest) > limit


@kernel
def wide_blocks(block_offsets, cells, vertex_offsets, vertices, points, centres, limit):
    """Mark the blocks ``(B,)`` that contain two vertices farther apart than ``limit``.

    The ``centres (B, 2)`` are the block centres.
    """
    wide, centre = np.empty(len(block_offsets) - 1, np.bool_), np.empty(2)
    for b in range(len(wide)):
        block = cells[block_offsets[b] : block_offsets[b + 1]]
        # A writable copy, so that is_wider is compiled only once.
        centre[0], centre[1] = centres[b, 0], centres[b, 1]
        wide[b] = is_wider(block, vertex_offsets, vertices, points, centre, limit)
    return wide
