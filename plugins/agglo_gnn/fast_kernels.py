"""Kernels of the fast model: the network on the raster of a piece, and the sweep in its direction."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import (
    NO_CUT,
    axes_block,
    centre_block,
    edge_room,
    edges_of_block,
    half_circle,
    halvings,
    helper,
    kernel,
    scan_thresholds,
    turned,
    write_sides,
)
from agglo_gnn.raster_kernels import fill_raster, raster_room, to_frame

__all__ = ["bisect_fast", "direction"]

_TIE = 1e-6  # of a bin: values that close to its end lie inside
_BAND = 0.45  # standard deviations either side of the mean in which a cut is sought
_BINS = 32
_SMALL = 96  # cells below which some axes are swept instead
_AXES = 4
_FINER = 2  # halvings of the angle between them, about the best
_LONG = 0.5  # ratio of principal moments below which a piece is long
_FEW = 400  # cells below which the axes are tried beside the network's direction


@helper(allocates=True)
def _sage(count, near, given, own, other, bias, out):
    """``out = ReLU(given · own + mean over neighbours of given · other + bias)``."""
    inputs, outputs = own.shape
    mean = np.empty(inputs)
    for a in range(count):
        degree = 0
        for k in range(inputs):
            mean[k] = 0.0
        for s in range(4):
            if near[a, s] >= 0:
                degree += 1
                for k in range(inputs):
                    mean[k] += given[near[a, s], k]
        for o in range(outputs):
            out[a, o] = bias[o]
        for k in range(inputs):
            m, x = mean[k] / max(degree, 1), given[a, k]
            for o in range(outputs):
                out[a, o] += x * own[k, o] + m * other[k, o]
        for o in range(outputs):
            out[a, o] = max(out[a, o], 0.0)


@helper
def _dense(given, weight, bias, rectify, out):
    for o in range(len(bias)):
        out[o] = bias[o]
    for k in range(weight.shape[0]):
        for o in range(len(bias)):
            out[o] += given[k] * weight[k, o]
    if rectify:
        for o in range(len(bias)):
            out[o] = max(out[o], 0.0)


@kernel
def direction(count, nodes, near, areas, features, net):
    """The network: coefficients (c₁, c₂) of the logit c₁ u + c₂ v of a piece."""
    own1, other1, bias1, own2, other2, bias2, dense1, add1, dense2, add2, dense3, add3 = net
    first, second = np.empty((count, len(bias1))), np.empty((count, len(bias2)))
    _sage(count, near, nodes, own1, other1, bias1, first)
    _sage(count, near, first, own2, other2, bias2, second)
    width = len(bias2)
    pooled = np.zeros(width + len(features))
    for a in range(count):
        for k in range(width):
            pooled[k] += areas[a] * second[a, k]
    for k in range(len(features)):
        pooled[width + k] = features[k]
    hidden, again, out = np.empty(len(add1)), np.empty(len(add2)), np.empty(2)
    _dense(pooled, dense1, add1, True, hidden)
    _dense(hidden, dense2, add2, True, again)
    _dense(again, dense3, add3, False, out)
    return out[0], out[1]


@helper(reorder_sums=True)
def _band_bins(n, x, y, p, q, low, rate, shares, bins):
    """Bins of the score p x + q y, −1 below the band and 32 above; share and moments of what is below."""
    area, sx, sy = 0.0, 0.0, 0.0
    for i in range(n):
        place = min(max((p * x[i] + q * y[i] - low) * rate - _TIE, -1.0), float(_BINS))
        below = shares[i] if place < 0.0 else 0.0
        bins[i] = np.int32(np.floor(place))
        area += below
        sx += below * x[i]
        sy += below * y[i]
    return area, sx, sy


@helper
def _band_sweep(start, n, graph, local, shares, scales, p, q, spread, bins, tally):
    """Cheapest threshold of p x + q y near its mean, as ``sweep_block`` does; only edges there count.

    Returns its cost, the last bin below, the lowest threshold and thresholds per unit.
    """
    indptr, indices, interface = graph
    low = -_BAND * spread
    rate = -0.5 * _BINS / low if low < 0.0 else 0.0
    area, sx, sy = _band_bins(n, local[0], local[1], p, q, low, rate, shares, bins)
    for b in range(_BINS):
        for k in range(5):
            tally[b, k] = 0.0
    cut = 0.0
    for i in range(n):
        own = bins[i]
        if own < 0 or own >= _BINS:
            continue
        rise = 0.0
        for h in range(indptr[start + i], indptr[start + i + 1]):
            other = bins[indices[h] - start]
            rise += interface[h] * ((other > own) - (other < own))
            cut += interface[h] * (other < 0)
        tally[own, 0] += shares[i] * local[0, i]
        tally[own, 1] += shares[i] * local[1, i]
        tally[own, 3] += shares[i]
        tally[own, 4] += rise
    scale, inertia, weight = scales
    best, last = scan_thresholds(tally, sx, sy, 0.0, area, cut, scale, inertia, weight)
    return best, last, low, rate


@helper
def _equal(n, shares):
    low, high = shares[0], shares[0]
    for i in range(n):
        low, high = min(low, shares[i]), max(high, shares[i])
    return high - low <= 1e-6 * high


@helper
def _cut_large(start, n, graph, local, shares, scales, uv, room, net, turns, finer, score, bins, tally):
    """Cheapest cut near the mean of the network's score.

    With few cells, or all alike, the axes are tried as well, and the best of all turned a little.
    Returns what ``_band_sweep`` does, and leaves the score in ``score``.
    """
    grid, place, nodes, near, areas, features = room
    ux, uy, vx, vy = to_frame(n, local, shares, scales[1], uv, features)
    count = fill_raster(n, uv, shares, grid, place, nodes, near, areas)
    pointed = direction(count, nodes[:count], near[:count], areas[:count], features, net)
    few, long = n < _FEW or _equal(n, shares), features[2] < _LONG * features[0]
    best, p, q, cos, sin = (NO_CUT, 0, 0.0, 0.0), 1.0, 0.0, 1.0, 0.0
    first, last = (-len(turns), 2 * len(finer)) if few else (0, 0)
    for c in range(first, last + 1):
        f = (c - 1) // 2
        if c < 0:
            a, b = turns[c - first]
            if long and abs(a) < 0.9:
                continue  # a long piece is not cut lengthwise
        elif c == 0:
            a, b = pointed
        elif c % 2 == 1:
            cos, sin = p, q
            a, b = turned(cos, sin, finer[f, 0], finer[f, 1])
        else:
            a, b = turned(cos, sin, finer[f, 0], -finer[f, 1])
        spread = np.sqrt(features[0] * a * a + 2.0 * features[1] * a * b + features[2] * b * b)
        x, y = a * ux + b * vx, a * uy + b * vy
        trial = _band_sweep(start, n, graph, local, shares, scales, x, y, spread, bins, tally)
        if trial[0] < best[0] - 1e-9 * abs(best[0]):
            best, p, q = trial, a, b
    x, y = p * ux + q * vx, p * uy + q * vy
    for i in range(n):
        score[i] = x * local[0, i] + y * local[1, i]
    return best


@kernel
def bisect_fast(offsets, indptr, indices, interface, centroids, weights, measures, net):
    """Side of each node of a planar graph: the network's cut, or the best of some axes if it is small."""
    largest = np.diff(offsets).max()
    local, uv, shares = np.empty((3, largest)), np.empty((2, largest)), np.empty(largest)
    score, bins, tally = np.empty(largest), np.empty(largest, np.int32), np.empty((_BINS, 5))
    turns, finer, graph = half_circle(_AXES), halvings(_AXES, _FINER), (indptr, indices, interface)
    sides = np.empty(len(weights), np.int64)
    room, edges = raster_room(largest), edge_room(offsets, indptr)
    for b in range(len(offsets) - 1):
        start, n = offsets[b], offsets[b + 1] - offsets[b]
        scales = centre_block(start, n, centroids, weights, measures, local, shares)
        best = (NO_CUT, 0, 0.0, 0.0)
        if n >= _SMALL and scales[1] > 1e-299:
            best = _cut_large(
                start, n, graph, local, shares, scales, uv, room, net, turns, finer, score, bins, tally
            )
            cost, last, low, rate = best
            for i in range(n if cost < NO_CUT else 0):
                sides[start + i] = np.floor((score[i] - low) * rate - _TIE) > last
        if best[0] == NO_CUT:
            some = finer[: (n >= 16) + (n >= 32)]  # few cells have few cuts
            found = edges, edges_of_block(start, n, indptr, indices, interface, edges)
            best = axes_block(n, found, local, shares, scales, turns, some, score, bins, tally)
            write_sides(start, n, best, score, bins, sides)
    return sides
