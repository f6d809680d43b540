"""Kernels of the fast model: the network on the raster of a piece, and the sweep across its direction."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels import kernel
from agglo_core.kernels.sweep import axes_block, centre_block, planar_frame, scan_thresholds, settle_block
from agglo_gnn.raster_kernels import lay_raster, raster_room, to_frame

__all__ = ["bisect_fast", "direction"]

_TIE = 1e-6  # of a bin: values that close to its end lie inside
_BAND = 0.45  # standard deviations either side of the mean in which a cut is sought
_BINS = 32
_NONE = 1e300
_SMALL = 48  # cells below which some axes are swept instead
_AXES = 4
_LONG = 0.5  # ratio of principal moments below which a piece is long
_FEW = 400  # cells below which the axes are tried beside the network's direction


@kernel
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


@kernel
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


@kernel(reorder_sums=True)
def _band_bins(start, n, x, y, p, q, low, rate, shares, bins):
    """Bins of the score p x + q y, −1 below the band and 32 above; share and moments of what is below."""
    area, sx, sy = 0.0, 0.0, 0.0
    for i in range(n):
        place = min(max((p * x[i] + q * y[i] - low) * rate - _TIE, -1.0), float(_BINS))
        below = shares[i] if place < 0.0 else 0.0
        bins[start + i] = np.int32(np.floor(place))
        area += below
        sx += below * x[i]
        sy += below * y[i]
    return area, sx, sy


@kernel
def _band_sweep(
    start, n, indptr, indices, interface, local, shares, inertia, scale, p, q, spread, bins, tally
):
    """Cheapest threshold of p x + q y near its mean, as ``sweep_block`` does; only edges there are seen."""
    low = -_BAND * spread
    rate = -0.5 * _BINS / low if low < 0.0 else 0.0
    area, sx, sy = _band_bins(start, n, local[0], local[1], p, q, low, rate, shares, bins)
    tally[:] = 0.0
    cut = 0.0
    for i in range(n):
        own = bins[start + i]
        if own < 0 or own >= _BINS:
            continue
        rise = 0.0
        for h in range(indptr[start + i], indptr[start + i + 1]):
            other = bins[indices[h]]
            rise += interface[h] * ((other > own) - (other < own))
            cut += interface[h] * (other < 0)
        tally[own, 0] += shares[i] * local[0, i]
        tally[own, 1] += shares[i] * local[1, i]
        tally[own, 3] += shares[i]
        tally[own, 4] += rise
    best, last = scan_thresholds(tally, sx, sy, 0.0, area, cut, scale, inertia)
    return best, low, rate, last


@kernel
def _equal(n, shares):
    low, high = shares[0], shares[0]
    for i in range(n):
        low, high = min(low, shares[i]), max(high, shares[i])
    return high - low <= 1e-6 * high


@kernel
def _cut_large(
    start, n, indptr, indices, interface, local, shares, inertia, scale, uv, room, net, score, bins, tally
):
    """Cheapest cut near the mean of the network's score (or of an axis, if few cells or all alike)."""
    grid, place, nodes, near, areas, features = room
    ux, uy, vx, vy = to_frame(n, local, shares, inertia, uv, features)
    count = lay_raster(n, uv, shares, grid, place, nodes, near, areas)
    c1, c2 = direction(count, nodes[:count], near[:count], areas[:count], features, net)
    trials = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0], [c1, c2]])
    first = 0 if n < _FEW or _equal(n, shares) else 4
    best, p, q = (_NONE, 0.0, 0.0, 0), ux, uy
    for t in range(first, 5):
        c1, c2 = trials[t]
        if t in (1, 2, 3) and features[2] < _LONG * features[0]:
            continue  # a long piece is not cut along
        spread = np.sqrt(features[0] * c1 * c1 + 2.0 * features[1] * c1 * c2 + features[2] * c2 * c2)
        a, b = c1 * ux + c2 * vx, c1 * uy + c2 * vy
        trial = _band_sweep(
            start, n, indptr, indices, interface, local, shares, inertia, scale, a, b, spread, bins, tally
        )
        if trial[0] < best[0] - 1e-9 * abs(best[0]):
            best, p, q = trial, a, b
    for i in range(n):
        score[i] = p * local[0, i] + q * local[1, i]
    return best


@kernel
def bisect_fast(offsets, indptr, indices, interface, centroids, weights, measures, net):
    """Side of each node of a planar level: the network's cut, or the best of four axes if it is small."""
    largest = np.diff(offsets).max()
    local, uv, shares, score = (
        np.empty((3, largest)),
        np.empty((2, largest)),
        np.empty(largest),
        np.empty(largest),
    )
    bins, tally = np.empty(len(weights), np.int32), np.empty((_BINS, 5))
    sides = np.empty(len(weights), np.int64)
    room = raster_room(largest)
    for b in range(len(offsets) - 1):
        start, n = offsets[b], offsets[b + 1] - offsets[b]
        inertia, scale = centre_block(start, n, centroids, weights, measures, local, shares)
        best = (_NONE, 0.0, 0.0, 0)
        if n >= _SMALL and inertia > 1e-299:
            best = _cut_large(
                start, n, indptr, indices, interface, local, shares, inertia, scale, uv, room, net, score,
                bins, tally,
            )  # fmt: skip
            if best[0] < _NONE:
                low, rate = best[1], best[2]
                for i in range(n):
                    sides[start + i] = np.floor((score[i] - low) * rate - _TIE) > best[3]
        if best[0] == _NONE:
            frame = planar_frame(n, local[0], local[1], shares)
            best = axes_block(
                start, n, indptr, indices, interface, local, shares, inertia, scale, frame, _AXES, score,
                bins, tally,
            )  # fmt: skip
            settle_block(start, n, best, score, bins, sides)
    return sides
