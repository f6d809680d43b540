"""Compiled 2-means bisection: ``two_means`` of graph blocks, ``split_by_means`` for all recursive splits.

Both cut a piece by the helpers ``_load`` and ``_cut``, passed as ``load`` and ``cut`` to
``split_pieces_by`` (``agglo_core/split/piece_driver.py``, here ``piece_driver``).
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_core.split import piece_driver, piece_splits
from agglo_kmeans.points import load_points, new_means
from agglo_kmeans.separator import separator


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
    inertia, nx, ny, nz, t = separator(means, graph.centroids.shape[1] == 2)
    sides.normal[0], sides.normal[1], sides.normal[2] = nx, ny, nz
    # Heights of all cells, including cells outside the sample, above the origin of the plane.
    centroids, heights, placing = graph.centroids, means.heights, means.placing
    x, y, z, solid, start = placing[0], placing[1], placing[2], centroids.shape[1] > 2, np.uint64(lo)
    for k in range(np.uint64(hi - lo)):
        i = np.uint32(pieces.cells[start + k])
        height = nx * (centroids[i, 0] - x) + ny * (centroids[i, 1] - y)
        heights[k] = height + nz * (centroids[i, 2] - z) if solid else height
    bar = t / placing[3] if inertia > 0.0 else np.inf  # without a plane the list is halved
    return piece_driver.tag_sides(graph, pieces, lo, hi, heights, bar, 1.0, extent, candidates, sides)


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
