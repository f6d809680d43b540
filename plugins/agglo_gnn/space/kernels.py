"""Kernels of the model in space: an axis and its tilt from moments, and the sweep in that direction."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import (
    NO_CUT,
    helper,
    kernel,
    piece_driver,
    piece_sweeps,
    scan_thresholds,
)
from agglo_gnn.plane.kernels import dense, number_cells
from agglo_gnn.space.moments import fill_features, frame_by_moments, moment_room

PRIOR = 4.0  # weight of the second moment in the score of an axis: the longest, if nothing was learned
_ONE = np.uint64(1)  # to be added to unsigned indices
_TIE = 1e-6  # of a bin: values that close to its end lie inside
_BAND, _LAYER = 0.45, 3.0  # standard deviations either side of the mean where a cut is sought, and cells
_BINS = 32
_MARGIN = 0.5  # of scores: axes that are behind the best by less are tried as well
_FEW = 40  # cells below which all axes are


@helper
def _point(n, net, room, hidden, out, scores, found):
    """The network: scores of the axes (3), and the direction that stands for each (3, 3)."""
    weight1, bias1, weight2, bias2 = net
    t, _, _, even, odd, _ = room
    for i in range(3):
        scores[i] = PRIOR * t[9 + 4 * i]
        for m in range(3):
            found[i, m] = t[3 * i + m]
        for side in range(2):
            j, k = (i + 1 + side) % 3, (i + 2 - side) % 3
            fill_features(n, t, i, j, k, even, odd)
            dense(even, weight1, bias1, True, hidden)
            dense(hidden, weight2, bias2, False, out)
            scores[i] += out[0]
            tilt = 0.0
            for f in range(len(odd)):
                tilt += out[1 + f] * odd[f]
            for m in range(3):
                found[i, m] += tilt * t[3 * j + m]


@kernel
def directions(n, local, shares, inertia, net):
    """Scores of the three axes of a piece of n cells, and the directions the network makes of them (3, 3)."""
    room, scores, found = moment_room(), np.empty(3), np.empty((3, 3))
    frame_by_moments(n, local, shares, inertia, room)
    _point(n, net, room, np.empty(len(net[1])), np.empty(len(net[3])), scores, found)
    return scores, found


@helper(reorder_sums=True)
def _project(n, axis, x, y, z, shares, score):
    """Fill the heights along an axis; returns their standard deviation."""
    square, a, b, c = 0.0, axis[0], axis[1], axis[2]
    for i in range(n):
        score[i] = a * x[i] + b * y[i] + c * z[i]
        square += shares[i] * score[i] * score[i]
    return np.sqrt(square)


@helper(reorder_sums=True)
def _band_bins(n, score, low, rate, local, shares, bins):
    """Bins of the heights, −1 below the band and 32 above; share and moments of what is below."""
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
def _band_sweep(graph, cells, lo, hi, tag, marks, point, spread, score, bins, tally):
    """Cheapest threshold of the heights near their mean; only edges there count.

    Returns its cost, the last bin below, the lowest threshold and thresholds per unit.
    """
    indptr, indices, interface = graph[0], graph[1], graph[2]
    local, shares, scales = point
    n, piece = hi - lo, tag[cells[lo]]
    low = -max(_BAND, _LAYER / np.cbrt(n)) * spread
    rate = -0.5 * _BINS / low if low < 0.0 else 0.0
    area, sx, sy, sz = _band_bins(n, score, low, rate, local, shares, bins)
    cut, start = 0.0, np.uint64(lo)
    for i in range(np.uint64(n)):
        own = bins[i]
        if own < 0 or own >= _BINS:
            continue
        rise, cell, b = 0.0, np.uint64(np.uint32(cells[start + i])), np.uint32(own)
        for h in range(np.uint64(indptr[cell]), np.uint64(indptr[cell + _ONE])):
            j = np.uint32(indices[h])
            other = bins[np.uint32(marks[j, 1])] if tag[j] == piece else own
            rise += interface[h] * (np.int64(other > own) - np.int64(other < own))
            cut += interface[h] * np.int64(other < 0)
        tally[b, 0] += shares[i] * local[0, i]
        tally[b, 1] += shares[i] * local[1, i]
        tally[b, 2] += shares[i] * local[2, i]
        tally[b, 3] += shares[i]
        tally[b, 4] += rise
    best, last = scan_thresholds(tally, sx, sy, sz, area, cut, scales[0], scales[1], scales[2])
    return best, last, low, rate


@helper
def _cut(graph, cells, lo, hi, extent, own, tag, marks, near, sums):
    """Tag both sides of a piece that is loaded, as ``piece_driver.split_pieces`` wants it."""
    point, (score, bins, tally), room, (hidden, out, scores, found), net = own
    (local, shares, scales), n, axis, best = point, hi - lo, sums[2], (NO_CUT, 0, 0.0, 0.0)
    number_cells(cells, lo, hi, tag, marks)
    axis[0], axis[1], axis[2] = 1.0, 0.0, 0.0
    if scales[1] > 1e-299:
        frame_by_moments(n, local, shares, scales[1], room)
        _point(n, net, room, hidden, out, scores, found)
        margin, chosen, last = np.inf if n < _FEW else _MARGIN, 0, 0
        bar = max(scores[0], scores[1], scores[2]) - margin
        for i in range(3):
            if scores[i] < bar:
                continue
            last, row = i, found[i]
            size = np.sqrt(row[0] * row[0] + row[1] * row[1] + row[2] * row[2])
            for m in range(3):
                row[m] /= size
            spread = _project(n, row, local[0], local[1], local[2], shares, score)
            trial = _band_sweep(graph, cells, lo, hi, tag, marks, point, spread, score, bins, tally)
            if trial[0] < best[0] - 1e-9 * abs(best[0]):
                best, chosen = trial, i
        axis[0], axis[1], axis[2] = found[chosen, 0], found[chosen, 1], found[chosen, 2]
        if chosen != last:
            _project(n, axis, local[0], local[1], local[2], shares, score)
    return piece_driver.tag_sides(
        graph, cells, lo, hi, score, piece_sweeps.bar_of(best), 1.0, extent, tag, near, sums
    )


@helper(allocates=True)
def _room(m, net):
    """Work arrays for pieces of at most m cells, and the network."""
    sweeps = np.zeros(m), np.empty(m, np.int32), np.zeros((_BINS, 5))
    outputs = np.empty(len(net[1])), np.empty(len(net[3])), np.empty(3), np.empty((3, 3))
    return piece_sweeps.point_room(m), sweeps, moment_room(), outputs, net


@kernel
def bisect_solids(offsets, indptr, indices, interface, centroids, weights, measures, net):
    """Side of each node of a graph in space, block by block."""
    n, largest = len(weights), np.int64(0)
    for b in range(len(offsets) - 1):
        largest = max(largest, offsets[b + 1] - offsets[b])
    own, sums = _room(largest, net), (np.empty(2), np.empty(2, np.int64), np.empty(3))
    cells, tag, marks = np.empty(n, np.int32), np.empty(n, np.int32), np.empty((n, 2), np.int32)
    near, reach = np.empty(largest + 1, np.int32), np.zeros(n, np.float32)
    graph = (indptr, indices, interface, centroids, measures, weights, reach, (1.0, 1.0))
    for i in range(n):
        cells[i] = i
    for b in range(len(offsets) - 1):
        lo, hi = offsets[b], offsets[b + 1]
        extent = piece_sweeps.load_piece(graph, cells, lo, hi, own)
        _cut(graph, cells, lo, hi, extent, own, tag, marks, near, sums)
    sides = np.empty(n, np.int64)
    for i in range(n):
        sides[i] = tag[i] & 1
    return sides


@kernel
def split_solids(net, graph, shape, cells, tag, marks, todo, ready, leaf, counts, tally, goal, work):
    """Split pieces, the last in ``todo`` first; the arguments but the first are those of ``PieceGrowth``."""
    own = _room(piece_driver.largest_piece(todo, counts), net)
    load = piece_sweeps.load_piece
    piece_driver.split_pieces(
        load, _cut, own, graph, shape, cells, tag, marks, todo, ready, leaf, counts, tally, goal, work
    )
