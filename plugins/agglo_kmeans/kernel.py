"""The kernels of 2-means: the blocks of a graph once, and pieces of a graph again and again."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel, piece_splits
from agglo_kmeans.points import load_points, means_room
from agglo_kmeans.separator import separator

__all__ = ["split_by_means", "two_means"]

_ROUNDING = 1e-6  # of the extent: what points of single precision may be off, with room


@helper
def _tag_sides(cells, lo, hi, points, extent, plane, tag, measures, size, count, reach, near):
    """Tag the cells of a piece by the side of the plane they lie on; both sides get some.

    Writes the cells no further from the plane than ``reach`` to ``near``; returns how many.
    """
    left, right = piece_splits.side_tags(lo, hi)
    best, nx, ny, nz, t = plane
    x, y, z = points[0], points[1], points[2]
    ones, below, above, m = 0, 0.0, 0.0, 0
    for k in range(hi - lo):
        i = cells[lo + k]
        height = nx * x[k] + ny * y[k] + nz * z[k] - t
        side = np.int64(height > 0.0)
        tag[i] = right if side else left
        above += side * measures[i]
        below += (1 - side) * measures[i]
        ones += side
        near[m] = i
        m += (abs(height) - _ROUNDING) * extent <= reach[i]
    if not best > 0.0 or ones == 0 or ones == hi - lo:  # coincident centroids: any halving will do
        ones, below, above, m = (hi - lo) // 2, 0.0, 0.0, hi - lo
        for k in range(m):
            i = cells[lo + k]
            side = np.int64(k >= m - ones)
            tag[i], near[k] = right if side else left, i
            above += side * measures[i]
            below += (1 - side) * measures[i]
    size[0], size[1], count[0], count[1] = below, above, hi - lo - ones, ones
    return m


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
        extent = load_points(cells, lo, hi, centroids, weights, units, room[0])
        plane = separator(room, hi - lo, planar)
        _tag_sides(cells, lo, hi, room[0], extent, plane, tag, weights, size, count, reach, near)
    sides = np.empty(n, np.int64)
    for i in range(n):
        sides[i] = tag[i] & 1
    return sides


@helper(allocates=True)
def _cut(graph, cells, lo, hi, extent, means, tag, sums, floor, room, stamp):
    """Cut a piece by 2-means and refine the sides; returns the cells along the cut, and the next stamp."""
    indptr, indices, interface, centroids, measures, _, reach, _ = graph
    size, count, axis = sums
    plane = separator(means, hi - lo, centroids.shape[1] == 2)
    edge = _tag_sides(cells, lo, hi, means[0], extent, plane, tag, measures, size, count, reach, room[0])
    left, right = piece_splits.side_tags(lo, hi)
    edge = piece_splits.cells_beside(indptr, indices, tag, left, right, room[0], edge)
    if floor < 0.0:
        return edge, stamp
    sign = 1.0 if size[1] < size[0] else -1.0
    axis[0], axis[1], axis[2] = sign * plane[1], sign * plane[2], sign * plane[3]
    structure, sides = (indptr, indices, interface), (size, count)
    return piece_splits.refine_sides(
        structure, centroids, measures, tag, left, right, axis, sides, floor, edge, room, stamp
    )


@helper(allocates=True)
def _split(graph, shape, cells, tag, marks, todo, ready, leaf, counts, tally, goal, work):
    indptr, indices, _, centroids, measures, weights, _, units = graph
    limit, floor, small, check = goal
    waiting, put_off, stamp, largest = counts[0], counts[1], counts[2], np.int64(0)
    for k in range(waiting):
        largest = max(largest, todo[k, 1] - todo[k, 0])
    room, means = piece_splits.piece_room(largest, marks), means_room(largest)
    size, count, axis = np.empty(2), np.empty(2, np.int64), np.empty(3)
    sums = (size, count, axis)
    while waiting > 0 and work > 0 and waiting + 2 <= len(todo) and put_off < len(ready):
        waiting -= 1
        lo, hi, quota, depth = todo[waiting, 0], todo[waiting, 1], todo[waiting, 2], todo[waiting, 3]
        if quota == 1 or hi - lo == 1:
            leaf[lo] = True
            continue
        if hi - lo <= small:
            for k in range(4):
                ready[put_off, k] = todo[waiting, k]
            put_off += 1
            continue
        if counts[3] == 0:
            extent = load_points(cells, lo, hi, centroids, weights, units, means[0])
            if limit > 0.0 and extent <= limit and piece_splits.is_narrow(cells[lo:hi], shape, limit):
                leaf[lo] = True
                continue
            edge, stamp = _cut(graph, cells, lo, hi, extent, means, tag, sums, floor, room, stamp)
            stamp += 2
            if check > 0 and not piece_splits.sides_connected(
                indptr, indices, tag, lo, hi, edge, room, stamp - 2
            ):
                waiting += 1
                counts[3] = 1  # somebody else is to mend them
                break
        row, one = min(depth, len(tally) - 1), 1 if check >= 0 else -1
        tally[row, 2] += counts[3]
        counts[3] = 0
        middle = piece_splits.part_list(tag, measures, cells, lo, hi, room[0], size)
        first = piece_splits.quota_of_left(quota, size, middle - lo, hi - middle)
        tally[row, 0] += one
        tally[row, 1] += one * (hi - lo)
        work -= hi - lo
        todo[waiting, 0], todo[waiting, 1], todo[waiting, 2] = middle, hi, quota - first
        todo[waiting + 1, 0], todo[waiting + 1, 1], todo[waiting + 1, 2] = lo, middle, first
        todo[waiting, 3], todo[waiting + 1, 3] = depth + 1, depth + 1
        waiting += 2
    counts[0], counts[1], counts[2] = waiting, put_off, stamp


@kernel
def split_by_means(graph, shape, cells, tag, marks, todo, ready, leaf, counts, tally, goal, work):
    """Split pieces, the last in ``todo`` first; the arguments are those of ``PieceGrowth``."""
    return _split(graph, shape, cells, tag, marks, todo, ready, leaf, counts, tally, goal, work)
