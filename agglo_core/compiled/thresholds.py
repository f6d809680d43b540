"""Bisection of blocks by a threshold of a score per cell: find the threshold with the cheapest cut."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.compiled.frames import (
    centre_block,
    half_circle,
    halvings,
    largest_block,
    planar_frame,
    turned,
)

NO_CUT = 1e300  # cost without a valid threshold; finite, because differences are computed
# Number of bins, even, so that the middle of a symmetric score is a threshold. More bins find shorter cuts,
# and cost time (benchmarks/gnn.py, bisector sweep in table bisection).
_BINS = 32
_TIE = 1e-6  # relative to a bin: values this close to a threshold count as below it
# Largest distance of thresholds from the mean, in standard deviations. Larger makes bins wider, smaller
# misses necks near an end (benchmarks/quality.py, bisector sweep).
_CLIP = 2.0
# Ratio of principal moments below which a block is long, and is not cut lengthwise. A smaller value tries
# more axes (benchmarks/quality.py, bisector sweep).
_LONG = 0.5


@helper(allocates=True)
def edge_room(offsets, indptr):
    """Allocate workspace for the edges of the largest block: both ends and the length of each edge."""
    most = 0
    for b in range(len(offsets) - 1):
        most = max(most, indptr[offsets[b + 1]] - indptr[offsets[b]])
    most = most // 2 + 1
    return np.empty(most, np.int32), np.empty(most, np.int32), np.empty(most)


@helper
def edges_of_block(start, n, indptr, indices, interface, edge_arrays):
    """Write each edge of a block once, with ends numbered in the block, and return the edge count."""
    tails, heads, lengths = edge_arrays
    count = 0
    for i in range(n):
        for h in range(indptr[start + i], indptr[start + i + 1]):
            j = indices[h] - start
            tails[count], heads[count], lengths[count] = i, j, interface[h]
            count += j > i  # no branch: it would be mispredicted
    return count


@helper
def thresholds_between(low, high, spread):
    """Divide the range of scores with mean 0 into bins: return its lower end and the bins per unit.

    ``spread`` is their standard deviation. The rate is 0 for constant scores.
    """
    size, reach = max(abs(low), abs(high)), _CLIP * spread
    low, high = max(low, -reach), min(high, reach)
    return low, (_BINS / (high - low) if high - low > 1e-12 * size else 0.0)


@helper(reorder_sums=True)
def _fill_bins(n, score, low, rate, bins):
    for i in range(n):
        bins[i] = np.int32(min(max((score[i] - low) * rate - _TIE, 0.0), _BINS - 1.0))


@helper
def scan_thresholds(tally, x, y, z, share, cut, scale, inertia, weight):
    """Return the cost of the cheapest threshold, 1e300 if none is valid, and the last bin below it.

    A threshold needs weight on both sides. ``tally (32, 5)`` contains for each bin its first moments x, y, z,
    its share, and the increase of the cut beyond it. It is cleared for the next use. The numbers are the sums
    below the first bin.

    Examples
    --------
    >>> from agglo_core.compiled.thresholds import scan_thresholds
    >>> tally = np.zeros((32, 5))
    >>> tally[0] = -0.5, 0.0, 0.0, 0.5, 1.0  # half of the weight below all thresholds, an edge
    >>> tally[31] = 0.5, 0.0, 0.0, 0.5, -1.0  # to the other half, above them
    >>> print(*scan_thresholds(tally, 0.0, 0.0, 0.0, 0.0, 0.0, scale=1.0, inertia=1.0, weight=15.0))
    4.0 0
    """
    best, bar, last, compact = NO_CUT, NO_CUT, 0, weight / inertia
    for b in range(_BINS):
        # 1. Moment m = (x, y, z), share s and cut of all bins up to this bin.
        x, y, z = x + tally[b, 0], y + tally[b, 1], z + tally[b, 2]
        share, cut = share + tally[b, 3], cut + tally[b, 4]
        for k in range(5):
            tally[b, k] = 0.0
        if b == _BINS - 1:
            break
        # 2. Cost: scale · cut · (1 / s + 1 / (1 − s)), the cut over each side's share, plus weight times the
        #    inertia of both sides over the block inertia, 1 − |m|² (1 / s + 1 / (1 − s)) / inertia (Steiner).
        share_product = share * (1.0 - share)
        cost = weight + (cut * scale - (x * x + y * y + z * z) * compact) / max(share_product, 1e-12)
        # 3. A later threshold must be cheaper by more than rounding.
        if share_product > 1e-12 and cost < bar:
            best, bar, last = cost, cost - 1e-9 * abs(cost), b
    return best, last


@helper
def sweep_block(n, low, rate, score, edges, local, shares, scales, bins, tally):
    """Return the cost of a block's cheapest cut by a threshold of ``score[:n]``, and the last bin below.

    The cost is 1e300 if there is no valid threshold. ``low`` is the lowest threshold, ``rate`` the thresholds
    per unit. ``edges`` are the workspace filled by ``edges_of_block`` and the edge count. ``local (3, n)``
    are positions about the centre of mass, ``shares`` the weights (sum 1). ``scales`` are one over the
    measure of a typical section, the inertia, and its weight relative to the cut. ``bins (n,)`` and ``tally
    (32, 5)`` are workspace, the latter zeros.
    """
    if rate == 0.0:
        return NO_CUT, 0
    (tails, heads, lengths), count = edges
    _fill_bins(n, score, low, rate, bins)
    # 1. Moments and shares by bin.
    for i in range(n):
        row = np.uint32(bins[i])
        tally[row, 0] += shares[i] * local[0, i]
        tally[row, 1] += shares[i] * local[1, i]
        tally[row, 2] += shares[i] * local[2, i]
        tally[row, 3] += shares[i]
    # 2. An edge is cut by all thresholds between the bins of its ends.
    for e in range(count):
        a, b = bins[np.uint32(tails[e])], bins[np.uint32(heads[e])]
        tally[np.uint32(min(a, b)), 4] += lengths[e]
        tally[np.uint32(max(a, b)), 4] -= lengths[e]
    scale, inertia, weight = scales
    return scan_thresholds(tally, 0.0, 0.0, 0.0, 0.0, 0.0, scale, inertia, weight)


@helper
def write_sides(start, n, threshold, score, bins, sides):
    """Write the side of each cell of a block, or arbitrary halves if no threshold is valid."""
    best, last, low, rate = threshold
    if best == NO_CUT:
        for i in range(n):
            sides[start + i] = 1 if n > 1 and 2 * i >= n else 0
        return
    _fill_bins(n, score, low, rate, bins)
    for i in range(n):
        sides[start + i] = bins[i] > last


@helper(reorder_sums=True)
def _project(n, a, b, x, y, score):
    """Write the scores a x + b y of all cells, and return their extremes."""
    low, high = a * x[0] + b * y[0], a * x[0] + b * y[0]
    for i in range(n):
        score[i] = a * x[i] + b * y[i]
        low, high = min(low, score[i]), max(high, score[i])
    return low, high


@helper
def axes_block(n, edges, local, shares, scales, turns, finer, score, bins, tally):
    """Find the cheapest cut of a 2-D block across its principal axis, or across axes rotated from it.

    Long blocks are not cut lengthwise: if the ratio of moments is below 0.5, axes more than 25° off are
    skipped. Then the best axis so far is rotated by each angle in ``finer``, in both directions. Returns the
    cost, the last bin below, the lowest threshold and thresholds per unit, and the best axis. Writes the
    coordinates along it to ``score``.

    Examples
    --------
    >>> from agglo_core.compiled.thresholds import axes_block
    >>> from agglo_core.compiled.frames import half_circle
    >>> from agglo_core.compiled.frames import halvings
    >>> local, shares = np.zeros((3, 4)), np.full(4, 0.25)
    >>> local[0] = -1.5, -0.5, 0.5, 1.5  # a row of four, each with an edge to the next
    >>> edges = (np.array([0, 1, 2]), np.array([1, 2, 3]), np.ones(3)), 3
    >>> angles, work = (half_circle(2), halvings(2, 0)), (np.empty(4), np.empty(4, int), np.zeros((32, 5)))
    >>> best, *axis = axes_block(4, edges, local, shares, (0.5, 1.25, 15.0), *angles, *work)
    >>> print(*best, *axis)
    5.0 10 -1.5 10.666666666666666 1.0 0.0
    """
    # 1. Principal axis, and whether the block is long.
    cos, sin, xx, xy, yy = planar_frame(n, local[0], local[1], shares)
    mean, radius = 0.5 * (xx + yy), np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    long = mean - radius < _LONG * (mean + radius)
    best, p, q = (NO_CUT, 0, 0.0, 0.0), cos, sin
    # 2. All axes rotated by ``turns``, then the best axis so far rotated by the angles in ``finer``, to the
    #    left and to the right.
    for c in range(len(turns) + 2 * len(finer)):
        f = (c - len(turns)) // 2
        if f < 0 and long and abs(turns[c, 0]) < 0.9:
            continue
        if f < 0:
            a, b = turned(cos, sin, turns[c, 0], turns[c, 1])
        elif (c - len(turns)) % 2 == 0:
            cos, sin = p, q
            a, b = turned(cos, sin, finer[f, 0], finer[f, 1])
        else:
            a, b = turned(cos, sin, finer[f, 0], -finer[f, 1])
        # 3. Cheapest threshold of the coordinates along the axis. Their variance follows from the moments.
        low, high = _project(n, a, b, local[0], local[1], score)
        low, rate = thresholds_between(low, high, np.sqrt(a * a * xx + 2.0 * a * b * xy + b * b * yy))
        cost, last = sweep_block(n, low, rate, score, edges, local, shares, scales, bins, tally)
        if cost < best[0] - 1e-9 * abs(best[0]):
            best, p, q = (cost, last, low, rate), a, b
    # 4. Scores along the best axis, for the caller.
    _project(n, p, q, local[0], local[1], score)
    return best, p, q


@helper
def bar_of(threshold):
    """Return the score above which cells are on side 1, infinite if no threshold is valid."""
    best, last, low, rate = threshold
    return low + (last + 1.0 + _TIE) / rate if best < NO_CUT else np.inf


@helper
def _centre_column(start, n, column, shares, score):
    """Write a column minus its weighted mean to ``score``, and return extremes and standard deviation."""
    low, high, mean, square = column[start], column[start], 0.0, 0.0
    for i in range(n):
        low, high = min(low, column[start + i]), max(high, column[start + i])
        mean += shares[i] * column[start + i]
    for i in range(n):
        score[i] = column[start + i] - mean
        square += shares[i] * score[i] ** 2
    return low - mean, high - mean, np.sqrt(square)


@kernel
def sweep_level(offsets, indptr, indices, interface, centroids, weights, measures, scores):
    """Bisect each block at the cheapest threshold over all columns of ``scores (n, C)``."""
    largest = largest_block(offsets)
    local, shares, score = np.empty((3, largest)), np.empty(largest), np.empty(largest)
    bins, tally, edge_arrays = np.empty(largest, np.int32), np.zeros((_BINS, 5)), edge_room(offsets, indptr)
    sides = np.empty(len(weights), np.int64)
    for b in range(len(offsets) - 1):
        start, n = offsets[b], offsets[b + 1] - offsets[b]
        # 1. Frame, inertia and edges of the block.
        scales = centre_block(start, n, centroids, weights, measures, local, shares)
        edges = edge_arrays, edges_of_block(start, n, indptr, indices, interface, edge_arrays)
        best, column = (NO_CUT, 0, 0.0, 0.0), 0
        # 2. Cheapest threshold over all columns, ties to the first column.
        for c in range(scores.shape[1]):
            low, high, spread = _centre_column(start, n, scores[:, c], shares, score)
            low, rate = thresholds_between(low, high, spread)
            cost, last = sweep_block(n, low, rate, score, edges, local, shares, scales, bins, tally)
            if cost < best[0] - 1e-9 * abs(best[0]):
                best, column = (cost, last, low, rate), c
        _centre_column(start, n, scores[:, column], shares, score)
        write_sides(start, n, best, score, bins, sides)
    return sides


@kernel
def sweep_axes(offsets, indptr, indices, interface, centroids, weights, measures, count):
    """Bisect each 2-D block at the cheapest threshold of the coordinates along ``count`` axes."""
    largest = largest_block(offsets)
    local, shares, score = np.empty((3, largest)), np.empty(largest), np.empty(largest)
    bins, tally, edge_arrays = np.empty(largest, np.int32), np.zeros((_BINS, 5)), edge_room(offsets, indptr)
    sides, turns, finer = np.empty(len(weights), np.int64), half_circle(count), halvings(count, 0)
    for b in range(len(offsets) - 1):
        start, n = offsets[b], offsets[b + 1] - offsets[b]
        # Frame and edges of the block, then the cheapest cut along all axes.
        scales = centre_block(start, n, centroids, weights, measures, local, shares)
        edges = edge_arrays, edges_of_block(start, n, indptr, indices, interface, edge_arrays)
        best, _, _ = axes_block(n, edges, local, shares, scales, turns, finer, score, bins, tally)
        write_sides(start, n, best, score, bins, sides)
    return sides
