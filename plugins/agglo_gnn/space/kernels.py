"""Compiled evaluation of the 3-D network, which scores and tilts principal axes, and search for the cut."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_core.compiled.thresholds import NO_CUT, bar_of, scan_thresholds
from agglo_core.split import piece_driver, piece_frames, piece_splits
from agglo_gnn.plane.kernels import dense, number_cells
from agglo_gnn.space.moments import fill_features, frame_by_moments, moment_room

# Weight of the second moment in an axis score: the untrained network prefers the longest axis. The network is
# trained with this number: another requires new training (benchmarks/solid_parts.py).
PRIOR = 4.0
_ONE = np.uint64(1)  # unsigned, to keep index types
_TIE = 1e-6  # bin widths: closer values count as inside
# Half width of the search band in standard deviations around the mean, for a piece with n cells at least
# _LAYER / ∛n, 0.87 cell layers in a cube. A wider band finds cuts into less equal sides, but visits the
# edges of more cells, and tries fewer thresholds per unit (benchmarks/solid_parts.py).
_BAND, _LAYER = 0.45, 3.0
_BINS = 32  # bins in the band, as in scan_thresholds, which tries the thresholds between them
# Score difference to the best axis below which an axis is tried too. A larger value finds better cuts, at one
# sweep for each axis (benchmarks/solid_parts.py).
_MARGIN = 0.5
_FEW = 40  # cells below which all axes are tried: their sweeps are cheap (benchmarks/solid_parts.py)


class Answers(NamedTuple):
    """Layers and outputs of the network: scores ``(3,)`` and tilted directions ``(3, 3)`` of the axes."""

    hidden: Any
    out: Any
    scores: Any
    directions: Any


class SpaceWork(NamedTuple):
    """Workspace to bisect pieces in 3-D, and the network parameters."""

    points: Any
    heights: Any
    bins: Any
    tally: Any
    moments: Any
    answers: Any
    net: Any


@helper
def _point(n, net, workspace, layer, outputs, scores, axes):
    """Evaluate the network: scores ``(3,)`` of the principal axes, and their tilted directions ``axes``.

    The direction of axis i is the axis plus multiples of the two others, its tilts. ``layer`` and ``outputs``
    receive the layers, ``workspace`` comes from ``moment_room`` with the frame and the moments of the piece.
    """
    weight1, bias1, weight2, bias2 = net
    t, _, _, even, odd, _ = workspace
    for i in range(3):
        # If the network returns 0, the score is the second moment: the longest axis wins, without tilt.
        scores[i] = PRIOR * t[9 + 4 * i]
        for m in range(3):
            axes[i, m] = t[3 * i + m]
        for side in range(2):
            # Tilt towards each other axis j; k is the third. The network takes even features, and its
            # outputs multiply odd features: no direction depends on the signs of the axes, and both tilts
            # are treated equally.
            j, k = (i + 1 + side) % 3, (i + 2 - side) % 3
            fill_features(n, t, i, j, k, even, odd)
            dense(even, weight1, bias1, True, layer)
            dense(layer, weight2, bias2, False, outputs)
            scores[i] += outputs[0]
            tilt = 0.0
            for f in range(len(odd)):
                tilt += outputs[1 + f] * odd[f]
            for m in range(3):
                axes[i, m] += tilt * t[3 * j + m]


@kernel
def directions(n, local, shares, inertia, net):
    """Return the network's scores ``(3,)`` and tilted directions ``(3, 3)`` of the axes of n cells."""
    workspace, scores, axes = moment_room(), np.empty(3), np.empty((3, 3))
    frame_by_moments(n, local, shares, inertia, workspace)
    _point(n, net, workspace, np.empty(len(net[1])), np.empty(len(net[3])), scores, axes)
    return scores, axes


@helper(reorder_sums=True)
def _project(n, axis, x, y, z, shares, score):
    """Write the coordinates of all cells along an axis to ``score``, and return their standard deviation."""
    square, a, b, c = 0.0, axis[0], axis[1], axis[2]
    for i in range(n):
        score[i] = a * x[i] + b * y[i] + c * z[i]
        square += shares[i] * score[i] * score[i]
    return np.sqrt(square)


@helper(reorder_sums=True)
def _band_bins(n, score, low, rate, local, shares, bins):
    """Write each coordinate's bin, and return share and first moments of the cells below all bins.

    Bins are −1 below the band and 32 above.
    """
    area, sx, sy, sz = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        place = min(max((score[i] - low) * rate - _TIE, -1.0), float(_BINS))
        below = shares[i] if place < 0.0 else 0.0
        bins[i] = np.int32(np.floor(place))
        area += below
        sx += below * local[0, i]
        sy += below * local[1, i]
        sz += below * local[2, i]
    return area, sx, sy, sz


@helper
def _band_sweep(graph, pieces, lo, hi, work, std):
    """Find the cheapest cut by a threshold of the coordinates in a band about their mean.

    Only edges in the band count. ``std`` is the standard deviation of the heights. Returns the cost, the
    last bin below, the lowest threshold and the number of thresholds per unit.
    """
    indptr, indices, interface = graph.indptr, graph.indices, graph.interface
    cells, tag, marks = pieces
    (local, shares, scales), score, bins, tally = work.points, work.heights, work.bins, work.tally
    n, piece = hi - lo, tag[cells[lo]]
    # 1. Bin all cells. The scan starts with share and moments below the band.
    low = -max(_BAND, _LAYER / np.cbrt(n)) * std
    rate = -0.5 * _BINS / low if low < 0.0 else 0.0
    area, sx, sy, sz = _band_bins(n, score, low, rate, local, shares, bins)
    # 2. Each band cell's contribution to the cut beyond its bin. Thresholds between the end bins cut an
    # edge: its area is added in the lower bin, and subtracted in the higher bin. Edges from below the band
    # are cut at its lower end already. Neighbours in other pieces count as if in the cell's own bin. Edges
    # that cross the whole band are not counted.
    cut, start = 0.0, np.uint64(lo)
    for i in range(np.uint64(n)):
        home = bins[i]
        if home < 0 or home >= _BINS:
            continue
        rise, cell, b = 0.0, np.uint64(np.uint32(cells[start + i])), np.uint32(home)
        for h in range(np.uint64(indptr[cell]), np.uint64(indptr[cell + _ONE])):
            j = np.uint32(indices[h])
            neighbour_bin = bins[np.uint32(marks[j, 1])] if tag[j] == piece else home
            rise += interface[h] * (np.int64(neighbour_bin > home) - np.int64(neighbour_bin < home))
            cut += interface[h] * np.int64(neighbour_bin < 0)
        tally[b, 0] += shares[i] * local[0, i]
        tally[b, 1] += shares[i] * local[1, i]
        tally[b, 2] += shares[i] * local[2, i]
        tally[b, 3] += shares[i]
        tally[b, 4] += rise
    # 3. Find the cheapest threshold.
    best, last = scan_thresholds(tally, sx, sy, sz, area, cut, scales[0], scales[1], scales[2])
    return best, last, low, rate


@helper
def _cut(graph, pieces, lo, hi, extent, work, candidates, sides):
    """Bisect the loaded piece, and tag the cells with their sides.

    This is the ``cut`` of ``piece_driver.split_pieces_by``.
    """
    (local, shares, scales), (layer, outputs, scores, axes), score = work.points, work.answers, work.heights
    n, axis, best = hi - lo, sides.normal, (NO_CUT, 0, 0.0, 0.0)
    number_cells(pieces, lo, hi)
    axis[0], axis[1], axis[2] = 1.0, 0.0, 0.0
    if scales[1] > 1e-299:
        # 1. Score the principal axes by the network, and tilt each.
        frame_by_moments(n, local, shares, scales[1], work.moments)
        _point(n, work.net, work.moments, layer, outputs, scores, axes)
        # 2. Sweep along the axes whose score is near the maximum.
        margin, best_axis, last = np.inf if n < _FEW else _MARGIN, 0, 0
        bar = max(scores[0], scores[1], scores[2]) - margin
        for i in range(3):
            if scores[i] < bar:
                continue
            last, row = i, axes[i]
            size = np.sqrt(row[0] * row[0] + row[1] * row[1] + row[2] * row[2])
            for m in range(3):
                row[m] /= size
            std = _project(n, row, local[0], local[1], local[2], shares, score)
            trial = _band_sweep(graph, pieces, lo, hi, work, std)
            if trial[0] < best[0] - 1e-9 * abs(best[0]):
                best, best_axis = trial, i
        axis[0], axis[1], axis[2] = axes[best_axis, 0], axes[best_axis, 1], axes[best_axis, 2]
        # Restore the heights of the best axis if another was swept last.
        if best_axis != last:
            _project(n, axis, local[0], local[1], local[2], shares, score)
    # 3. Sides by height; the axis has length 1. Without a cut the piece is halved.
    return piece_driver.tag_sides(graph, pieces, lo, hi, score, bar_of(best), 1.0, extent, candidates, sides)


@helper(allocates=True)
def _new_work(m, net):
    """Allocate the workspace for pieces with up to ``m`` cells."""
    _, bias1, _, bias2 = net
    answers = Answers(np.empty(len(bias1)), np.empty(len(bias2)), np.empty(3), np.empty((3, 3)))
    points, heights, bins = piece_frames.new_points(m), np.zeros(m), np.empty(m, np.int32)
    return SpaceWork(points, heights, bins, np.zeros((_BINS, 5)), moment_room(), answers, net)


@kernel
def bisect_solids(offsets, indptr, indices, interface, centroids, weights, measures, net):
    """Bisect each block of a 3-D graph in the best of the network's directions."""
    n, largest = len(weights), np.int64(0)
    for b in range(len(offsets) - 1):
        largest = max(largest, offsets[b + 1] - offsets[b])
    # Blocks are pieces of a graph; only the cut matters, so reach is 0 and units are 1.
    work, sides = _new_work(largest, net), piece_splits.new_sides()
    cells, tag, marks = np.empty(n, np.int32), np.empty(n, np.int32), np.empty((n, 2), np.int32)
    candidates, reach = np.empty(largest + 1, np.int32), np.zeros(n, np.float32)
    units, pieces = piece_splits.Units(1.0, 1.0, 1.0), piece_splits.Pieces(cells, tag, marks)
    graph = piece_splits.PieceGraph(indptr, indices, interface, centroids, measures, weights, reach, units)
    for i in range(n):
        cells[i] = i
    # Cut each block
    for b in range(len(offsets) - 1):
        lo, hi = offsets[b], offsets[b + 1]
        extent = piece_frames.load_piece(graph, pieces, lo, hi, work)
        _cut(graph, pieces, lo, hi, extent, work, candidates, sides)
    # Right sides have odd tags.
    result = np.empty(n, np.int64)
    for i in range(n):
        result[i] = tag[i] & 1
    return result


@kernel
def split_solids(net, graph, shape, pieces, lists, limits, budget):
    """Split pieces recursively by the network: see ``piece_driver.split_pieces_by``."""
    work, load = _new_work(piece_driver.largest_piece(lists), net), piece_frames.load_piece
    piece_driver.split_pieces(load, _cut, work, graph, shape, pieces, lists, limits, budget)
