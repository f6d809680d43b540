"""Compiled 2-means bisection: ``two_means`` of graph blocks, ``split_by_means`` for all recursive splits.

Both cut a piece by the helpers ``_load`` and ``_cut``, passed as ``load`` and ``cut`` to
``split_pieces_by`` (``agglo_core/split/piece_driver.py``, here ``piece_driver``).
"""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_core.split import piece_driver, piece_splits
from agglo_kmeans.points import load_points, new_means
from agglo_kmeans.separator import separator

_ROUNDING = 1e-6  # error bound for points in single precision, relative to the extent, with a margin


@helper
def _tag_sides(graph, pieces, lo, hi, placing, extent, plane, candidates, sides):
    """Tag each cell of a piece by its side of a plane, so that neither side is empty.

    ``placing`` contains origin and unit of the plane (see ``load_points``). The candidates are the cells at
    least as close to the plane as their neighbours are to them; their number is returned. ``plane`` comes
    from ``separator``: inertia, unit normal and t.
    """
    cells, tag, centroids, reach = pieces.cells, pieces.tag, graph.centroids, graph.reach
    left_tag, right_tag = piece_splits.side_tags(lo, hi)
    # 1. Convert the plane to mesh coordinates, relative to its origin; heights are lengths times
    # units.length, like reach.
    inertia, nx, ny, nz, t = plane
    x, y, z, unit, solid = placing[0], placing[1], placing[2], placing[3], centroids.shape[1] > 2
    length = graph.units.length
    nx, ny, nz, t = length * nx, length * ny, length * nz, length * t / unit
    slack = _ROUNDING * extent * length
    # 2. Tag all cells in double precision, including cells outside the sample. Cells near the plane, up to
    # single-precision rounding, are candidates.
    n_right, total, above, m = np.int64(0), 0.0, 0.0, np.uint64(0)
    for k in range(np.uint64(lo), np.uint64(hi)):
        i = np.uint32(cells[k])
        height = nx * (centroids[i, 0] - x) + ny * (centroids[i, 1] - y) - t
        if solid:
            height += nz * (centroids[i, 2] - z)
        side, measure = height > 0.0, graph.measures[i]
        tag[i] = right_tag if side else left_tag
        above += measure if side else 0.0
        total += measure
        n_right += side
        candidates[m] = i
        m += np.uint64(abs(height) - slack <= reach[i])
    sides.measures[0], sides.measures[1] = total - above, above
    sides.counts[0], sides.counts[1] = hi - lo - n_right, n_right
    # 3. Without a plane, or with all cells on one side, halve the list.
    if inertia > 0.0 and 0 < n_right < hi - lo:
        return np.int64(m)
    return piece_driver.tag_halves(graph, pieces, lo, hi, candidates, sides)


@helper
def _load(graph, pieces, lo, hi, means):
    """Copy the points of the piece ``cells[lo:hi]`` to the workspace, and return their extent.

    This is the ``load`` of ``split_pieces_by``.
    """
    return load_points(pieces.cells, lo, hi, graph.centroids, graph.weights, graph.units, means)


@helper
def _cut(graph, pieces, lo, hi, extent, means, candidates, sides):
    """Bisect the piece in the workspace by 2-means: tag the side of each cell.

    This is the ``cut`` of ``split_pieces_by``. Writes normal, measures and counts of ``sides``, and the
    ``candidates``; returns the candidate count.
    """
    plane = separator(means, graph.centroids.shape[1] == 2)
    _, sides.normal[0], sides.normal[1], sides.normal[2], _ = plane
    return _tag_sides(graph, pieces, lo, hi, means.placing, extent, plane, candidates, sides)


@kernel
def two_means(offsets, centroids, weights):
    """Return each node's side by 2-means on its block, the best over several starting axes."""
    n, largest = len(weights), np.int64(0)
    for b in range(len(offsets) - 1):
        largest = max(largest, offsets[b + 1] - offsets[b])
    means, units = new_means(largest), piece_splits.units_of(centroids, weights)
    candidates, sides = np.empty(largest + 1, np.int32), piece_splits.new_sides()
    cells, tag, reach = np.empty(n, np.int32), np.empty(n, np.int32), np.zeros(n, np.float32)
    # A graph without edges suffices for the cut: offsets and cells replace its CSR.
    graph = piece_splits.PieceGraph(offsets, cells, weights, centroids, weights, weights, reach, units)
    pieces = piece_splits.Pieces(cells, tag, np.empty((0, 4), np.int32))
    for i in range(n):
        cells[i] = i
    for b in range(len(offsets) - 1):
        lo, hi = offsets[b], offsets[b + 1]
        extent = _load(graph, pieces, lo, hi, means)
        _cut(graph, pieces, lo, hi, extent, means, candidates, sides)
    # Right sides have odd tags.
    result = np.empty(n, np.int64)
    for i in range(n):
        result[i] = tag[i] & 1
    return result


@kernel
def split_by_means(graph, shape, pieces, lists, limits, budget):
    """Split pieces of the mesh recursively by 2-means, in one compiled call.

    See ``piece_driver.split_pieces_by``.
    """
    means = new_means(piece_driver.largest_piece(lists))
    piece_driver.split_pieces(_load, _cut, means, graph, shape, pieces, lists, limits, budget)
