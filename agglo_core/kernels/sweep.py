"""Sweep rounding: of all thresholds of a score, the one that cuts each block best."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels import kernel

__all__ = [
    "axes_block",
    "centre_block",
    "planar_frame",
    "scan_thresholds",
    "settle_block",
    "sweep_axes",
    "sweep_block",
    "sweep_level",
]

_BINS = 32  # an even number: the middle of a symmetric score is a threshold
_TIE = 1e-6  # of a bin: values that close to a threshold lie below it
_CLIP = 2.0  # standard deviations from the mean: no thresholds beyond
_COMPACT = 15.0  # weight of the inertia beside the cut
_NONE = 1e300  # cost of no cut; finite, for differences are taken
_LONG = 0.5  # ratio of principal moments below which a block is long
_ROUND = 0.8  # ratio of principal moments above which no axis stands out


@kernel(reorder_sums=True)
def _range(n, score, shares):
    """Lowest threshold and thresholds per unit of ``score[:n]``; 0 per unit if it is constant."""
    low, high, mean, square = score[0], score[0], 0.0, 0.0
    for i in range(n):
        low, high = min(low, score[i]), max(high, score[i])
        mean += shares[i] * score[i]
    for i in range(n):
        square += shares[i] * (score[i] - mean) ** 2
    reach, size = _CLIP * np.sqrt(square), max(abs(low), abs(high))
    low, high = max(low, mean - reach), min(high, mean + reach)
    return low, (_BINS / (high - low) if high - low > 1e-12 * size else 0.0)


@kernel
def _fill_bins(start, n, score, low, rate, bins):
    for i in range(n):
        place = min(max((score[i] - low) * rate - _TIE, 0.0), _BINS - 1.0)
        bins[start + i] = np.int32(place)


@kernel
def scan_thresholds(tally, x, y, z, share, cut, scale, inertia):
    """Cheapest threshold, and its cost: 1e300 if none leaves weight on both sides.

    ``tally (32, 5)`` has for each bin its moments, its share and how much the cut grows beyond it;
    the numbers are what lies below the first bin.
    """
    best, last, before, compact = _NONE, 0, -1.0, _COMPACT / inertia
    for b in range(_BINS - 1):
        x, y, z = x + tally[b, 0], y + tally[b, 1], z + tally[b, 2]
        share, cut = share + tally[b, 3], cut + tally[b, 4]
        both = share * (1.0 - share)  # 1 / share + 1 / (1 − share) is its inverse
        if share > before and both > 1e-12:  # an empty bin changes nothing
            cost = _COMPACT + (cut * scale - (x * x + y * y + z * z) * compact) / both
            if cost < best - 1e-9 * abs(best):
                best, last = cost, b
        before = share
    return best, last


@kernel
def sweep_block(start, n, indptr, indices, interface, local, shares, inertia, scale, score, bins, tally):
    """Best threshold of ``score[:n]`` on the block of the nodes from ``start`` on.

    Returns the cost, the lowest threshold, thresholds per unit, and the last bin below; cost 1e300 if
    there is no cut. ``local (3, n)`` are positions about the centre of mass, ``shares`` the weights
    (sum 1), ``inertia`` their second moment, ``scale`` one over the measure of a typical section;
    ``bins``, one for each node of the level, and ``tally (32, 5)`` are room to work in.
    """
    low, rate = _range(n, score, shares)
    if rate == 0.0:
        return _NONE, low, rate, 0
    _fill_bins(start, n, score, low, rate, bins)
    tally[:] = 0.0
    for i in range(n):
        own, rise = bins[start + i], 0.0
        for h in range(indptr[start + i], indptr[start + i + 1]):
            other = bins[indices[h]]
            rise += interface[h] * ((other > own) - (other < own))  # no branch: it would be mispredicted
        tally[own, 0] += shares[i] * local[0, i]
        tally[own, 1] += shares[i] * local[1, i]
        tally[own, 2] += shares[i] * local[2, i]
        tally[own, 3] += shares[i]
        tally[own, 4] += rise
    best, last = scan_thresholds(tally, 0.0, 0.0, 0.0, 0.0, 0.0, scale, inertia)
    return best, low, rate, last


@kernel
def settle_block(start, n, found, score, bins, sides):
    """Write the sides of a block: above the best threshold, or any halving if there is none."""
    best, low, rate, last = found
    if best == _NONE:
        for i in range(n):
            sides[start + i] = 1 if n > 1 and 2 * i >= n else 0
        return
    _fill_bins(start, n, score, low, rate, bins)
    for i in range(n):
        sides[start + i] = bins[start + i] > last


@kernel
def centre_block(start, n, centroids, weights, measures, local, shares):
    """Fill positions about the centre of mass, and shares; return the inertia and 1 / section."""
    d = centroids.shape[1]
    total, measure = 0.0, 0.0
    for i in range(n):
        total += weights[start + i]
        measure += measures[start + i]
    for i in range(n):
        shares[i] = weights[start + i] / total if total > 0.0 else 1.0 / n
    inertia = 0.0
    for k in range(d):
        mean = 0.0
        for i in range(n):
            local[k, i] = centroids[start + i, k] - centroids[start, k]
            mean += shares[i] * local[k, i]
        for i in range(n):
            local[k, i] -= mean
            inertia += shares[i] * local[k, i] ** 2
    for i in range(n if d == 2 else 0):
        local[2, i] = 0.0
    return max(inertia, 1e-300), (measure ** (1.0 / d - 1.0) if measure > 0.0 else 1.0)


@kernel(reorder_sums=True)
def planar_frame(n, x, y, shares):
    """Cosine and sine of the principal axis of the centred points, and the ratio of principal moments.

    If the ratio exceeds 0.8, of the axis of least fourth moments: along the side of a square, to which
    second moments are blind.
    """
    xx, xy, yy, real, imaginary = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        p, q = x[i] * x[i] - y[i] * y[i], 2.0 * x[i] * y[i]
        xx += shares[i] * x[i] * x[i]
        xy += shares[i] * x[i] * y[i]
        yy += shares[i] * y[i] * y[i]
        real += shares[i] * (p * p - q * q)
        imaginary += shares[i] * 2.0 * p * q
    mean, radius = 0.5 * (xx + yy), np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    ratio = (mean - radius) / (mean + radius) if mean > 0.0 else 1.0
    if ratio > _ROUND:
        angle = 0.25 * np.arctan2(-imaginary, -real)
    return np.cos(angle), np.sin(angle), ratio


@kernel
def sweep_level(offsets, indptr, indices, interface, centroids, weights, measures, scores):
    """Side of each node: the cheapest threshold over all columns of ``scores (n, C)``, block by block."""
    largest = np.diff(offsets).max()
    local, shares, score = np.empty((3, largest)), np.empty(largest), np.empty(largest)
    bins, tally = np.empty(len(weights), np.int32), np.empty((_BINS, 5))
    sides = np.empty(len(weights), np.int64)
    for b in range(len(offsets) - 1):
        start, n = offsets[b], offsets[b + 1] - offsets[b]
        inertia, scale = centre_block(start, n, centroids, weights, measures, local, shares)
        best, column = (_NONE, 0.0, 0.0, 0), 0
        for c in range(scores.shape[1]):
            for i in range(n):
                score[i] = scores[start + i, c]
            trial = sweep_block(
                start, n, indptr, indices, interface, local, shares, inertia, scale, score, bins, tally
            )
            if trial[0] < best[0] - 1e-9 * abs(best[0]):
                best, column = trial, c
        for i in range(n):
            score[i] = scores[start + i, column]
        settle_block(start, n, best, score, bins, sides)
    return sides


@kernel
def axes_block(
    start, n, indptr, indices, interface, local, shares, inertia, scale, frame, count, score, bins, tally
):
    """Cheapest cut of a block across ``count`` axes turned evenly from that of ``frame``.

    Long blocks are not cut along: where the ratio of moments is below 0.5, axes more than 45° off are
    left out. Leaves the coordinates along the best axis in ``score``.
    """
    best, p, q = (_NONE, 0.0, 0.0, 0), frame[0], frame[1]
    for c in range(count + 1):  # the last one restores the best score
        cos, sin = np.cos(c * np.pi / count), np.sin(c * np.pi / count)
        a, b = cos * frame[0] - sin * frame[1], cos * frame[1] + sin * frame[0]
        if c == count:
            a, b = p, q
        elif frame[2] < _LONG and abs(cos) < 0.7:
            continue
        for i in range(n):
            score[i] = a * local[0, i] + b * local[1, i]
        if c == count:
            break
        trial = sweep_block(
            start, n, indptr, indices, interface, local, shares, inertia, scale, score, bins, tally
        )
        if trial[0] < best[0] - 1e-9 * abs(best[0]):
            best, p, q = trial, a, b
    return best


@kernel
def sweep_axes(offsets, indptr, indices, interface, centroids, weights, measures, count):
    """Side of each node in the plane: the cheapest threshold along ``count`` axes."""
    largest = np.diff(offsets).max()
    local, shares, score = np.empty((3, largest)), np.empty(largest), np.empty(largest)
    bins, tally = np.empty(len(weights), np.int32), np.empty((_BINS, 5))
    sides = np.empty(len(weights), np.int64)
    for b in range(len(offsets) - 1):
        start, n = offsets[b], offsets[b + 1] - offsets[b]
        inertia, scale = centre_block(start, n, centroids, weights, measures, local, shares)
        frame = planar_frame(n, local[0], local[1], shares)
        best = axes_block(
            start,
            n,
            indptr,
            indices,
            interface,
            local,
            shares,
            inertia,
            scale,
            frame,
            count,
            score,
            bins,
            tally,
        )
        settle_block(start, n, best, score, bins, sides)
    return sides
