"""Compiled evaluation of the 2-D network, and the search for the best cut in the predicted direction."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_core.compiled.frames import half_circle, halvings, turned
from agglo_core.compiled.thresholds import NO_CUT, axes_block, bar_of, scan_thresholds
from agglo_core.split import piece_driver, piece_frames, piece_splits, piece_sweeps
from agglo_gnn.plane.raster_kernels import fill_raster, new_raster, to_frame

_ONE = np.uint64(1)  # unsigned, to keep index types
_TIE = 1e-6  # bin widths: closer values count as inside
# Half width of the search band around the mean, in standard deviations. A wider band finds cuts into less
# equal sides, but visits the edges of more cells, and tries fewer thresholds per unit (benchmarks/gnn.py).
_BAND = 0.45
_BINS = 32  # bins in the band, as in scan_thresholds, which tries the thresholds between them
# Number of cells below which some axes are swept instead, over all edges of the piece: thresholds far from
# the mean count too, but each sweep costs more (benchmarks/gnn.py recursion quality).
_SMALL = 96
_AXES = 4  # number of axes tried without the network: each costs a sweep (benchmarks/gnn.py recursion)
_FINER = 1  # halvings of their angle about the best axis: each costs two sweeps (benchmarks/gnn.py recursion)
# Ratio of principal moments below which a piece is long, and not cut lengthwise. A larger value saves sweeps,
# and misses some lengthwise cuts (benchmarks/gnn.py recursion quality).
_LONG = 0.5
# Number of cells below which axes are tried instead of the network, which makes no difference there
# (docs/reference/model-card.md, benchmarks/gnn.py recursion quality).
_FEW = 400


@helper(allocates=True)
def _sage(count, near, features, own_weight, mean_weight, bias, result):
    """Evaluate a graph convolution (SAGE) layer, and write it to ``result (count, outputs)``.

    It is ``ReLU(features · own_weight + mean over neighbours of features · mean_weight + bias)``.

    ``near (count, 4)`` are each node's neighbours, −1 for none; the input count is divisible by 4.
    """
    inputs, outputs = own_weight.shape
    mean = np.empty(inputs)
    for a in range(count):
        # 1. Mean over the neighbours, 0 without neighbours.
        degree = 0
        for k in range(inputs):
            mean[k] = 0.0
        for s in range(4):
            if near[a, s] >= 0:
                degree += 1
                for k in range(inputs):
                    mean[k] += features[near[a, s], k]
        for o in range(outputs):
            result[a, o] = bias[o]
        for k in range(inputs):
            mean[k] /= max(degree, 1)
        # 2. Add both products.
        for k in range(0, inputs, 4):  # unrolled by four, for fewer overlap checks in the inner loop
            x, y, z, w = features[a, k], features[a, k + 1], features[a, k + 2], features[a, k + 3]
            p, q, r, s = mean[k], mean[k + 1], mean[k + 2], mean[k + 3]
            for o in range(outputs):
                total = result[a, o] + (x * own_weight[k, o] + p * mean_weight[k, o])
                total += y * own_weight[k + 1, o] + q * mean_weight[k + 1, o]
                total += z * own_weight[k + 2, o] + r * mean_weight[k + 2, o]
                result[a, o] = total + (w * own_weight[k + 3, o] + s * mean_weight[k + 3, o])
        for o in range(outputs):
            result[a, o] = max(result[a, o], 0.0)


@helper
def dense(x, weight, bias, rectify, y):
    """Compute ``y = x · weight + bias``, followed by ReLU if ``rectify``."""
    for o in range(len(bias)):
        y[o] = bias[o]
    for k in range(weight.shape[0]):
        for o in range(len(bias)):
            y[o] += x[k] * weight[k, o]
    if rectify:
        for o in range(len(bias)):
            y[o] = max(y[o], 0.0)


@kernel
def direction(count, nodes, near, areas, features, net):
    """Evaluate the network on a piece: coefficients (c₁, c₂) of the cut function c₁ u + c₂ v.

    ``nodes (count, 4)``, ``near`` and ``areas (count,)`` are its raster, ``features (13,)`` the piece
    features; see ``raster_kernels``.
    """
    own1, other1, bias1, own2, other2, bias2, dense1, add1, dense2, add2, dense3, add3 = net
    first, second = np.empty((count, len(bias1))), np.empty((count, len(bias2)))
    # 1. Two SAGE layers on the raster.
    _sage(count, near, nodes, own1, other1, bias1, first)
    _sage(count, near, first, own2, other2, bias2, second)
    # 2. Area-weighted mean over the piece, followed by the piece features.
    width = len(bias2)
    pooled = np.zeros(width + len(features))
    for a in range(count):
        for k in range(width):
            pooled[k] += areas[a] * second[a, k]
    for k in range(len(features)):
        pooled[width + k] = features[k]
    # 3. Three dense layers: the cut direction.
    layer1, layer2, coefficients = np.empty(len(add1)), np.empty(len(add2)), np.empty(2)
    dense(pooled, dense1, add1, True, layer1)
    dense(layer1, dense2, add2, True, layer2)
    dense(layer2, dense3, add3, False, coefficients)
    return coefficients[0], coefficients[1]


@helper(reorder_sums=True)
def _band_bins(n, x, y, p, q, low, rate, shares, bins):
    """Write the bin of p x + q y for each cell, and return share and moments below all bins.

    Bins are −1 below the band and 32 above.
    """
    area, sx, sy = 0.0, 0.0, 0.0
    for i in range(n):
        place = min(max((p * x[i] + q * y[i] - low) * rate - _TIE, -1.0), float(_BINS))
        below = shares[i] if place < 0.0 else 0.0
        bins[i] = np.int32(np.floor(place))
        area += below
        sx += below * x[i]
        sy += below * y[i]
    return area, sx, sy


class PlaneWork(NamedTuple):
    """Workspace to bisect pieces in 2-D, and the network parameters.

    ``turns`` and ``finer`` are cosines and sines, ``uv (2, m)`` positions in the frame, ``listed`` the
    cells with a bin.
    """

    points: Any
    scores: Any
    raster: Any
    turns: Any
    finer: Any
    uv: Any
    listed: Any
    net: Any


@helper
def number_cells(pieces, lo, hi):
    """Number the cells of a piece (second column of the marks), and assign all to the left side."""
    cells, tag, marks = pieces
    left_tag, _ = piece_splits.side_tags(lo, hi)
    start = np.uint64(lo)
    for k in range(np.uint64(hi - lo)):
        i = np.uint32(cells[start + k])
        tag[i], marks[i, 1] = left_tag, k


@helper
def _band_sweep(graph, pieces, lo, hi, work, scales, p, q, std):
    """Find the cheapest cut by a threshold of p x + q y in a band about the mean.

    Unlike ``sweep_block``, only thresholds and edges in the band count. ``std`` is the standard
    deviation of the score. Returns the cost, the last bin below, the lowest threshold and the number of
    thresholds per unit.
    """
    indptr, indices, interface = graph.indptr, graph.indices, graph.interface
    cells, tag, marks = pieces
    local, shares, bins, tally = work.points.local, work.points.shares, work.scores.bins, work.scores.tally
    listed, n, piece = work.listed, hi - lo, tag[cells[lo]]
    # 1. Bin all cells. The scan starts with share and moments below the band.
    low = -_BAND * std
    rate = -0.5 * _BINS / low if low < 0.0 else 0.0
    area, sx, sy = _band_bins(n, local[0], local[1], p, q, low, rate, shares, bins)
    # 2. List the cells in the band, about a quarter in a square. Edges outside the band are skipped, even
    # edges that cross the whole band.
    cut, start, inside = 0.0, np.uint64(lo), np.uint64(0)
    for k in range(n):
        listed[inside] = k  # no branch: it would be mispredicted
        inside += np.uint64((bins[k] >= 0) & (bins[k] < _BINS))
    # 3. Each cell's contribution to the cut beyond its bin. Thresholds between the end bins cut an edge:
    # its length is added in the lower bin, and subtracted in the higher bin. Edges from below the band are
    # cut at its lower end already. Neighbours in other pieces count as if in the cell's own bin.
    for k in range(inside):
        i = np.uint64(np.uint32(listed[k]))
        home, rise, cell = bins[i], 0.0, np.uint64(np.uint32(cells[start + i]))
        b = np.uint32(home)
        for h in range(np.uint64(indptr[cell]), np.uint64(indptr[cell + _ONE])):
            j = np.uint32(indices[h])
            neighbour_bin = bins[np.uint32(marks[j, 1])] if tag[j] == piece else home
            length = interface[h]
            rise += (length if neighbour_bin > home else 0.0) - (length if neighbour_bin < home else 0.0)
            cut += length if neighbour_bin < 0 else 0.0
        tally[b, 0] += shares[i] * local[0, i]
        tally[b, 1] += shares[i] * local[1, i]
        tally[b, 3] += shares[i]
        tally[b, 4] += rise
    # 4. Find the cheapest threshold.
    scale, inertia, weight = scales
    best, last = scan_thresholds(tally, sx, sy, 0.0, area, cut, scale, inertia, weight)
    return best, last, low, rate


@helper
def _equal(n, shares):
    """Return True if all cells have equal weight shares, up to 1e-6 relative to the largest."""
    low, high = shares[0], shares[0]
    for i in range(n):
        low, high = min(low, shares[i]), max(high, shares[i])
        if high - low > 1e-6 * high:
            return False
    return True


@helper
def _cut_near_mean(graph, pieces, lo, hi, work, axis):
    """Find the cheapest cut of a piece near its centre, in the network's or other directions.

    With few cells the axes are tried instead, with equal cells in addition; then the best direction is
    rotated slightly. Returns the result of ``_band_sweep``, and leaves the score in the heights, its
    gradient in ``axis``.
    """
    (local, shares, scales), heights = work.points, work.scores.heights
    grid, place, nodes, near, areas, features = work.raster
    turns, finer, uv, n = work.turns, work.finer, work.uv, hi - lo
    # 1. Map the piece to its principal frame; the network evaluates its raster if it has enough cells.
    ux, uy, vx, vy = to_frame(n, local, shares, scales[1], uv, features)
    use_network, pointed = n >= _FEW, (1.0, 0.0)
    if use_network:
        count = fill_raster(n, uv, shares, grid, place, nodes, near, areas)
        pointed = direction(count, nodes[:count], near[:count], areas[:count], features, work.net)
    # 2. Directions: frame axes (c < 0), the network's (c = 0), and the best one rotated both ways (c > 0).
    axes, long = not use_network or _equal(n, shares), features[2] < _LONG * features[0]
    best, p, q, cos, sin = (NO_CUT, 0, 0.0, 0.0), 1.0, 0.0, 1.0, 0.0
    first, last = (-len(turns), 2 * len(finer)) if axes else (0, 0)
    section = scales[0], scales[1], scales[2]
    number_cells(pieces, lo, hi)
    for c in range(first, last + 1):
        f = (c - 1) // 2
        if c < 0:
            a, b = turns[c - first, 0], turns[c - first, 1]
            if long and abs(a) < 0.9:
                continue  # a long piece is not cut lengthwise
        elif c == 0:
            if not use_network:
                continue
            a, b = pointed
        elif c % 2 == 1:
            cos, sin = p, q
            a, b = turned(cos, sin, finer[f, 0], finer[f, 1])
        else:
            a, b = turned(cos, sin, finer[f, 0], -finer[f, 1])
        # 3. Standard deviation in this direction, from the second moments, and the sweep. A later direction
        # must be better by more than rounding.
        std = np.sqrt(features[0] * a * a + 2.0 * features[1] * a * b + features[2] * b * b)
        x, y = a * ux + b * vx, a * uy + b * vy
        trial = _band_sweep(graph, pieces, lo, hi, work, section, x, y, std)
        if trial[0] < best[0] - 1e-9 * abs(best[0]):
            best, p, q = trial, a, b
    # 4. Heights in the best direction, whose length follows the rows of the frame.
    axis[0], axis[1] = p * ux + q * vx, p * uy + q * vy
    for i in range(n):
        heights[i] = axis[0] * local[0, i] + axis[1] * local[1, i]
    return best


@helper
def _cut(graph, pieces, lo, hi, extent, work, candidates, sides):
    """Bisect the loaded piece, and tag the cells with their sides.

    This is the ``cut`` of ``piece_driver.split_pieces_by``.
    """
    (local, shares, scales), (heights, bins, tally, ends) = work.points, work.scores
    n, axis, best = hi - lo, sides.normal, (NO_CUT, 0, 0.0, 0.0)
    axis[2] = 0.0
    # 1. Cut near the mean, unless the piece is small, or all its centroids coincide.
    if n >= _SMALL and scales[1] > 1e-299:
        best = _cut_near_mean(graph, pieces, lo, hi, work, axis)
    # 2. Without such a cut, the best of some axes over all thresholds, from the list of all edges.
    if best[0] == NO_CUT:
        rotations = work.finer[: n >= 24]  # few cells have few cuts
        edges = ends, piece_sweeps.edges_of_piece(graph, pieces, lo, hi, ends)
        section = scales[0], scales[1], scales[2]
        best, axis[0], axis[1] = axes_block(
            n, edges, local, shares, section, work.turns, rotations, heights, bins, tally
        )
    # 3. Sides by height. The axis may have any length: unit converts heights to lengths.
    unit = 1.0 / np.hypot(axis[0], axis[1])
    return piece_driver.tag_sides(
        graph, pieces, lo, hi, heights, bar_of(best), unit, extent, candidates, sides
    )


@helper(allocates=True)
def _new_work(m, edges, net):
    """Allocate the workspace for pieces with up to ``m`` cells and ``edges`` edges."""
    points, scores = piece_frames.new_points(m), piece_sweeps.new_scores(m, edges)
    turns, finer = half_circle(_AXES), halvings(_AXES, _FINER)
    uv, listed = np.empty((2, m)), np.empty(m + 1, np.int32)
    return PlaneWork(points, scores, new_raster(m), turns, finer, uv, listed, net)


@kernel
def bisect_fast(offsets, indptr, indices, interface, centroids, weights, measures, net):
    """Bisect each block of a 2-D graph by the network, small blocks along the best axis."""
    n, largest, most = len(weights), np.int64(0), np.int64(0)
    for b in range(len(offsets) - 1):
        largest = max(largest, offsets[b + 1] - offsets[b])
        most = max(most, indptr[offsets[b + 1]] - indptr[offsets[b]])
    # Blocks are pieces of a graph; only the cut matters, so reach is 0 and units are 1.
    work, sides = _new_work(largest, most // 2 + 1, net), piece_splits.new_sides()
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
def split_fast(net, graph, shape, pieces, lists, limits, budget):
    """Split pieces recursively by the network: see ``piece_driver.split_pieces_by``."""
    m, edges = piece_driver.largest_piece(lists), piece_sweeps.most_edges(lists, pieces.cells, graph.indptr)
    work, load = _new_work(m, edges, net), piece_frames.load_piece
    piece_driver.split_pieces(load, _cut, work, graph, shape, pieces, lists, limits, budget)
