"""The kernels of 2-means: the blocks of a graph once, and pieces of a graph again and again."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel, piece_driver, piece_splits
from agglo_kmeans.points import load_points, means_room
from agglo_kmeans.separator import separator

_ROUNDING = 1e-6  # of the extent: what points of single precision may be off, with room


@helper
def _tag_sides(
    cells, lo, hi, centroids, placing, extent, plane, tag, measures, size, count, reach, length, near
):
    """Tag the cells of a piece by the side of the plane they lie on; both sides get some.

    ``placing`` says where the origin of the plane is, and in which unit (see ``load_points``). Writes the
    cells no further from the plane than ``reach``, which is multiplied by ``length``, to ``near``; returns
    how many.
    """
    left, right = piece_splits.side_tags(lo, hi)
    best, nx, ny, nz, t = plane
    x, y, z, unit, solid = placing[0], placing[1], placing[2], placing[3], centroids.shape[1] > 2
    nx, ny, nz, t = length * nx, length * ny, length * nz, length * t / unit
    extent = _ROUNDING * extent * length
    ones, total, above, m = np.int64(0), 0.0, 0.0, np.uint64(0)
    for k in range(np.uint64(lo), np.uint64(hi)):
        i = np.uint32(cells[k])
        height = nx * (centroids[i, 0] - x) + ny * (centroids[i, 1] - y) - t
        if solid:
            height += nz * (centroids[i, 2] - z)
        side, measure = height > 0.0, measures[i]
        tag[i] = right if side else left
        above += measure if side else 0.0
        total += measure
        ones += side
        near[m] = i
        m += np.uint64(abs(height) - extent <= reach[i])
    size[0], size[1], count[0], count[1] = total - above, above, hi - lo - ones, ones
    if best > 0.0 and 0 < ones < hi - lo:
        return np.int64(m)
    return piece_driver.tag_halves(cells, lo, hi, tag, measures, near, size, count)


@kernel
def two_means(offsets, centroids, weights):
    """Side of each node: the 2-means split of its block of least energy over the starting axes."""
    n, planar, largest = len(weights), centroids.shape[1] == 2, np.int64(0)
    for b in range(len(offsets) - 1):
        largest = max(largest, offsets[b + 1] - offsets[b])
    room, units = means_room(largest), piece_splits.units_of(centroids, weights)
    size, count, near = np.empty(2), np.empty(2, np.int64), np.empty(largest + 1, np.int32)
    reach = np.zeros(n, np.float32)
    cells, tag = np.empty(n, np.int32), np.empty(n, np.int32)
    for i in range(n):
        cells[i] = i
    for b in range(len(offsets) - 1):
        lo, hi = offsets[b], offsets[b + 1]
        extent = load_points(cells, lo, hi, centroids, weights, units, room)
        plane = separator(room, planar)
        _tag_sides(
            cells, lo, hi, centroids, room[7], extent, plane, tag, weights, size, count, reach, units[0], near
        )
    sides = np.empty(n, np.int64)
    for i in range(n):
        sides[i] = tag[i] & 1
    return sides


@helper
def _load(graph, cells, lo, hi, means):
    centroids, weights, units = graph[3], graph[5], graph[7]
    return load_points(cells, lo, hi, centroids, weights, units, means)


@helper
def _cut(graph, cells, lo, hi, extent, means, tag, marks, near, sums):
    centroids, measures, reach, length = graph[3], graph[4], graph[6], graph[7][0]
    size, count, axis = sums
    plane = separator(means, centroids.shape[1] == 2)
    axis[0], axis[1], axis[2] = plane[1], plane[2], plane[3]
    placing = means[7]
    return _tag_sides(
        cells, lo, hi, centroids, placing, extent, plane, tag, measures, size, count, reach, length, near
    )


@kernel
def split_by_means(graph, shape, cells, tag, marks, todo, ready, leaf, counts, tally, goal, work):
    """Split pieces, the last in ``todo`` first; the arguments are those of ``PieceGrowth``."""
    means, lists = means_room(piece_driver.largest_piece(todo, counts)), (cells, tag, marks)
    return piece_driver.split_pieces(
        _load, _cut, means, graph, shape, *lists, todo, ready, leaf, counts, tally, goal, work
    )
