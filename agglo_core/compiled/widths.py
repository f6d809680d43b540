"""Tests whether cells are wider than a limit, which take less time than their diameter."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel
from agglo_core.compiled.geometry import MANY, largest_distance, sort_along_x, widest_of_many

_ROUNDING = 1e-12  # of a squared distance, with room


@helper
def _square(v, x, y, z, points):
    """Square of the distance of vertex v from a point, in the plane without z."""
    last = points.shape[1] - 1
    a, b, c = points[v, 0] - x, points[v, 1] - y, (last - 1.0) * (points[v, last] - z)
    return a * a + b * b + c * c  # a loop over two or three takes twice the time


@helper
def _outside(cells, vertex_offsets, vertices, points, centre, inner, found):
    """Write the vertices whose squared distance to the centre is at least ``inner``, and return how many."""
    x, y, z, m = centre[0], centre[1], centre[len(centre) - 1], np.uint64(0)
    for k in range(len(cells)):
        i = np.uint64(cells[k])
        for h in range(np.uint64(vertex_offsets[i]), np.uint64(vertex_offsets[i + ONE])):
            found[m] = vertices[h]  # no branch: it would be mispredicted
            m += np.uint64(_square(np.uint32(vertices[h]), x, y, z, points) >= inner)
    return np.int64(m)


@helper
def _reach(cells, vertex_offsets, vertices, points, centre):
    """Square of the largest distance of a vertex from the centre, and how many there are at most."""
    x, y, z, most, count = centre[0], centre[1], centre[len(centre) - 1], 0.0, 0
    for k in range(len(cells)):
        i = np.uint64(cells[k])
        count += vertex_offsets[i + ONE] - vertex_offsets[i]
        for h in range(np.uint64(vertex_offsets[i]), np.uint64(vertex_offsets[i + ONE])):
            most = max(most, _square(np.uint32(vertices[h]), x, y, z, points))
    return most, count


@helper(allocates=True)
def is_wider(cells, vertex_offsets, vertices, points, centre, limit):
    """Return whether two vertices of the cells are further apart than ``limit``.

    Both must lie outside the ball where distance to the ``centre``, any point, is below ``limit`` − (largest
    distance to it): in the middle of the cells it leaves few. Those are sorted along x, so that the copies of
    a vertex, one for each of its cells, come one after the other.
    """
    last = points.shape[1] - 1
    # 1. With all vertices within r of the centre, no two are further apart than 2 r.
    reach, count = _reach(cells, vertex_offsets, vertices, points, centre)
    least, inner = limit * limit * (1.0 - _ROUNDING), limit - np.sqrt(reach)
    if 4.0 * reach < least:
        return False
    # 2. Vertices outside the ball of radius limit − r, one copy for each of their cells.
    inner = inner * inner * (1.0 - _ROUNDING) if inner > 0.0 else 0.0
    far = np.empty(count + 1, np.int64)
    m = _outside(cells, vertex_offsets, vertices, points, centre, inner, far)
    if last > 1:  # in space copies are many, and x the same for whole planes of a grid
        return largest_distance(m, far, centre, points) > limit
    # 3. In the plane: sorted, copies are adjacent and dropped.
    sort_along_x(m, far, points)
    distinct, widest = min(m, 1), 0.0
    for k in range(1, m):
        far[distinct] = far[k]
        distinct += far[distinct] != far[distinct - 1]
    # 4. Many: sorted search for a pair further apart than the limit. Few: all pairs.
    if distinct > MANY:
        return np.sqrt(widest_of_many(distinct, far, centre, points, reach, least)) > limit
    for i in range(1, distinct):
        x, y, z = points[far[i], 0], points[far[i], 1], points[far[i], last]
        for j in range(i):
            widest = max(widest, _square(np.uint32(far[j]), x, y, z, points))
    return np.sqrt(widest) > limit


@kernel
def wide_blocks(block_offsets, cells, vertex_offsets, vertices, points, centres, limit):
    """Mark the blocks ``(B,)`` with two vertices further apart than ``limit``.

    The ``centres (B, 2)`` lie in their middle.
    """
    wide, centre = np.empty(len(block_offsets) - 1, np.bool_), np.empty(2)
    for b in range(len(wide)):
        own = cells[block_offsets[b] : block_offsets[b + 1]]
        centre[0], centre[1] = centres[b, 0], centres[b, 1]  # writable: one version of what is called
        wide[b] = is_wider(own, vertex_offsets, vertices, points, centre, limit)
    return wide
