"""Pieces halved by weight across their principal axis, again and again, as blocks are depth by depth."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import helper, kernel
from agglo_core.kernels.median_splits import SHARE, stable_sort, untied
from agglo_core.kernels.ordered_frames import centre_in_order, frame_in_order, frame_room
from agglo_core.kernels.piece_driver import largest_piece, split_pieces
from agglo_core.kernels.piece_refinement import sort_by_keys
from agglo_core.kernels.piece_splits import side_tags

__all__ = ["halve_in_order", "split_across_axes"]

_TIE = 1e-7  # of the extent: what counts as equal, as in ``graph.blocks``
_BINS = 256
_FEW = 64  # values that are sorted


@helper
def _extremes(n, values):
    low, high = values[0], values[0]
    for k in range(n):
        low, high = min(low, values[k]), max(high, values[k])
    return low, high


@helper
def _median(n, score, shares, whole, some, keys, tally):
    """The score of the cell that holds the middle of the weight, ``whole`` being the sum of the shares.

    Bins are counted, then bins of the bin that has the middle, until few scores are left to be sorted.
    """
    m, below = n, np.int64(0)
    for k in range(n):
        some[k], keys[k] = k, score[k]
    while m > _FEW:
        low, high = _extremes(m, keys)
        rate = _BINS / (high - low) if high > low else 0.0
        if not 0.0 < rate < 1e300:
            return low
        for b in range(_BINS):
            tally[b] = 0
        for k in range(m):
            tally[min(np.int64((keys[k] - low) * rate), _BINS - 1)] += shares[some[k]]
        chosen = 0
        while chosen < _BINS - 1 and 2 * (below + tally[chosen]) <= whole:
            below += tally[chosen]
            chosen += 1
        kept = 0
        for k in range(m):
            value = keys[k]
            some[kept], keys[kept] = some[k], value
            kept += min(np.int64((value - low) * rate), _BINS - 1) == chosen
        m = kept
    sort_by_keys(some, keys, m)
    for k in range(m - 1):
        below += shares[some[k]]
        if 2 * below > whole:
            return keys[k]
    return keys[m - 1]


@helper
def _near_bar(n, score, bar, window, some):
    """Write to ``some`` the points within a window about the bar; returns how many."""
    m = np.int64(0)
    for k in range(n):
        some[m] = k
        m += abs(score[k] - bar) <= window
    return m


@helper(allocates=True)
def _equals(n, score, bar, tie, some):
    """Points that count as equal to the bar: reached from it by steps of at most ``tie``; by their scores."""
    window = 4.0 * tie
    while True:
        m = _near_bar(n, score, bar, window, some)
        group, spare = np.empty(m, np.int64), np.empty(m, np.int64)
        for k in range(m):
            group[k] = some[k]
        stable_sort(group, score, spare)
        middle = 0
        while score[group[middle]] < bar:
            middle += 1
        first, last = middle, middle + 1
        while first > 0 and score[group[first]] - score[group[first - 1]] <= tie:
            first -= 1
        while last < m and score[group[last]] - score[group[last - 1]] <= tie:
            last += 1
        inside = min(score[group[first]] - (bar - window), bar + window - score[group[last - 1]])
        if inside >= tie or m == n:
            return group[first:last]
        window *= 16.0


@helper(allocates=True)
def _in_turn(n, d, along, group):
    """Order of points that count as equal along the first axis: by the next, then by the last."""
    other = 0.0
    if len(group) == 1:
        return np.zeros(1, np.int64)
    for c in range(1, d):
        low, high = _extremes(n, along[c])
        other = max(other, high - low)
    return untied(along[:d, :n], 0, group, _TIE * other)


@helper(allocates=True)
def halve_in_order(n, d, along, weight, shares, upper, some, keys, tally):
    """Mark in ``upper`` the points above the weighted median of their first coordinates ``along (3, m)``.

    Points count as equal within 1e-7 of the extent; the other coordinates decide among them. The ``weight``
    adds up to 1. Returns the median, and how far from it may be what counts as equal.
    """
    score, whole = along[0], np.int64(0)
    for k in range(n):
        shares[k] = np.int64(np.rint(weight[k] * SHARE))
        whole += shares[k]
    low, high = _extremes(n, score)
    bar = _median(n, score, shares, whole, some, keys, tally)
    group = _equals(n, score, bar, _TIE * (high - low), some)
    least, most = score[group[0]], score[group[len(group) - 1]]
    below, under = np.int64(0), np.int64(0)
    for k in range(n):
        above = np.int64(score[k] >= least)
        upper[k] = above
        below += (1 - above) * shares[k]
        under += 1 - above
    order, cut = _in_turn(n, d, along, group), np.int64(0)
    while cut < len(group) and 2 * below + shares[group[order[cut]]] <= whole:
        below += shares[group[order[cut]]]
        cut += 1
    cut = min(max(cut, 1 - under), n - 1 - under)  # neither side is empty
    for k in range(len(group)):
        upper[group[order[k]]] = k >= cut
    return bar, most - least


@helper
def _offset(moment, measure, moments, measures):
    """How far the centroid of a side is from that of the piece."""
    return moment / measure - moments / measures if measure > 0.0 else 0.0


@helper
def _tag(graph, cells, lo, hi, upper, score, bar, slack, tag, near, sums):
    """Tag the cells, and write measures and cells of the sides, and what may be beside the cut.

    The axis of the refinement is that of ``relax_interface``, the line to the centroid of the smaller side.
    """
    _, _, _, centroids, measures, _, reach, (length, _, _) = graph
    size, count, axis = sums
    left, right = side_tags(lo, hi)
    m, ones, last = np.int64(0), np.int64(0), centroids.shape[1] - 1
    one, two, x, y, z, p, q, r = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(hi - lo):
        i, side = cells[lo + k], np.int64(upper[k])
        tag[i] = right if side else left
        there = side * measures[i]
        here = (1 - side) * measures[i]
        one, two, ones = one + here, two + there, ones + side
        x, p = x + here * centroids[i, 0], p + there * centroids[i, 0]
        y, q = y + here * centroids[i, 1], q + there * centroids[i, 1]
        z, r = z + here * centroids[i, last], r + there * centroids[i, last]
        near[m] = i
        m += abs(score[k] - bar) * length <= reach[i] + slack * length
    size[0], size[1], count[0], count[1] = one, two, hi - lo - ones, ones
    own, sign = (two, 1.0) if two < one else (one, -1.0)  # the driver turns normals to the smaller side
    axis[0] = sign * _offset(p if two < one else x, own, x + p, one + two)
    axis[1] = sign * _offset(q if two < one else y, own, y + q, one + two)
    axis[2] = sign * _offset(r if two < one else z, own, z + r, one + two)
    return m


@helper
def _load(graph, cells, lo, hi, own):
    """Fill positions and weights; returns the largest extent of the centroids along an axis."""
    local, weight, _, _, _, _ = own[0]
    centroids, weights = graph[3], graph[5]
    extent = 0.0
    for k in range(hi - lo):
        weight[k] = weights[cells[lo + k]]
    for c in range(centroids.shape[1]):
        low, high = np.inf, -np.inf
        for k in range(hi - lo):
            x = centroids[cells[lo + k], c]
            local[c, k] = x
            low, high = min(low, x), max(high, x)
        extent = max(extent, high - low)
    return extent


@helper(allocates=True)
def _cut(graph, cells, lo, hi, extent, own, tag, marks, near, sums):
    frame, (shares, upper, some, keys, tally) = own
    local, weight, along, _, _, _ = frame
    n, d = hi - lo, graph[3].shape[1]
    centre_in_order(n, d, local, weight)
    frame_in_order(n, d, frame)
    bar, slack = halve_in_order(n, d, along, weight, shares, upper, some, keys, tally)
    return _tag(graph, cells, lo, hi, upper, along[0], bar, slack + 1e-12 * extent, tag, near, sums)


@kernel
def split_across_axes(graph, shape, cells, tag, marks, todo, ready, leaf, counts, tally, goal, work):
    """Split pieces, the last in ``todo`` first; the arguments are those of ``PieceGrowth``."""
    m = largest_piece(todo, counts)
    room = np.empty(m, np.int64), np.empty(m, np.bool_), np.empty(m, np.int32), np.empty(m)
    own = frame_room(m), (*room, np.empty(_BINS, np.int64))
    split_pieces(
        _load, _cut, own, graph, shape, cells, tag, marks, todo, ready, leaf, counts, tally, goal, work
    )
