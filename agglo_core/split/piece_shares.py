"""Cut mesh pieces at a prescribed mass share, across an axis or the line between side centroids."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.compiled.sorting import sort_by_keys, stable_sort
from agglo_core.split.piece_splits import PieceGraph, Pieces, Units, new_sides, side_tags

_SHARE = 2.0**40  # scale of integer weight shares, whose sums do not depend on the order
_TIE = 1e-7  # relative to the extent: tolerance for equal values, as in ``graph.blocks``
# Bins per round in the search for a median. More bins need fewer rounds, but each costs more
# (benchmarks/partition.py, coordinate bisection).
_BINS = 256
_FEW = 64  # values: up to this number they are sorted instead (benchmarks/partition.py, coordinate bisection)
# Relative to the mass share of the lighter side: cuts within this tolerance stay. A larger value saves
# shifted cuts, but parts become less equal (benchmarks/interfaces.py, row kmeans).
_NEAR = 0.051


class OrderWorkspace(NamedTuple):
    """Workspace for quantiles: integer weight shares, mask of upper points, point list, keys, and bins."""

    shares: Any
    upper: Any
    chosen: Any
    keys: Any
    bins: Any


@helper(allocates=True)
def new_order(m):
    """Allocate workspace for ``split_in_order`` with up to m points."""
    shares, upper, chosen = np.empty(m, np.int64), np.empty(m, np.bool_), np.empty(m, np.int32)
    return OrderWorkspace(shares, upper, chosen, np.empty(m), np.empty(_BINS, np.int64))


@helper
def _extremes(n, values):
    low, high = values[0], values[0]
    for k in range(n):
        low, high = min(low, values[k]), max(high, values[k])
    return low, high


@helper
def _median(n, score, shares, whole, points, keys, tally):
    """Return the weighted quantile of n scores.

    ``whole`` is twice the target sum. Each round counts the weights in bins and continues with the bin that
    contains the quantile, until few scores remain to be sorted.
    """
    m, below = n, np.int64(0)
    for k in range(n):
        points[k], keys[k] = k, score[k]
    # 1. Histogram the weights over equal bins.
    while m > _FEW:
        low, high = _extremes(m, keys)
        rate = _BINS / (high - low) if high > low else 0.0
        if not 0.0 < rate < 1e300:
            return low
        for b in range(_BINS):
            tally[b] = 0
        for k in range(m):
            tally[min(np.int64((keys[k] - low) * rate), _BINS - 1)] += shares[np.uint32(points[k])]
        # 2. Find the bin that contains the median, and keep only its points.
        middle = 0
        while middle < _BINS - 1 and 2 * (below + tally[middle]) <= whole:
            below += tally[middle]
            middle += 1
        n_kept = 0
        for k in range(m):
            value = keys[k]
            points[n_kept], keys[n_kept] = points[k], value
            n_kept += min(np.int64((value - low) * rate), _BINS - 1) == middle
        m = n_kept
    # 3. Sort the remaining points, and sum up their shares.
    sort_by_keys(points, keys, m)
    for k in range(m - 1):
        below += shares[points[k]]
        if 2 * below > whole:
            return keys[k]
    return keys[m - 1]


@helper
def _near_bar(n, score, bar, window, points):
    """List the points with scores within a window about the threshold ``bar``, and return their number."""
    m = np.int64(0)
    for k in range(n):
        points[m] = k
        m += abs(score[k] - bar) <= window
    return m


@helper(allocates=True)
def _equals(n, score, bar, tie, points):
    """Return the points whose scores count as equal to the threshold ``bar``, sorted by score.

    These are connected to the bar by steps of at most ``tie``.
    """
    window = 4.0 * tie
    while True:
        # 1. Sort the points near the bar.
        m = _near_bar(n, score, bar, window, points)
        group, spare = np.empty(m, np.int64), np.empty(m, np.int64)
        for k in range(m):
            group[k] = points[k]
        stable_sort(group, score, spare)
        middle = 0
        while score[group[middle]] < bar:
            middle += 1
        # 2. Extend the group by steps of at most the tie.
        first, last = middle, middle + 1
        while first > 0 and score[group[first]] - score[group[first - 1]] <= tie:
            first -= 1
        while last < m and score[group[last]] - score[group[last - 1]] <= tie:
            last += 1
        # 3. Accept a group well inside the window, else widen the window.
        inside = min(score[group[first]] - (bar - window), bar + window - score[group[last - 1]])
        if inside >= tie or m == n:
            return group[first:last]
        window *= 16.0


@helper(allocates=True)
def _break_ties(columns, axis, group, gap):
    """Order cells with equal scores by their ranks along the other axes, next axis first.

    Values no farther apart than ``gap`` have equal rank. Remaining ties keep their order.
    """
    d, m = len(columns), len(group)
    key, values = np.zeros(m), np.empty(m)
    order, spare = np.empty(m, np.int64), np.empty(m, np.int64)
    # 1. Rank by each other axis, and combine the ranks in one key.
    for step in range(1, d):
        for i in range(m):
            order[i], values[i] = i, columns[(axis + step) % d, group[i]]
        stable_sort(order, values, spare)
        rank = 0
        for i in range(m):
            rank += i > 0 and values[order[i]] - values[order[i - 1]] > gap
            key[order[i]] = key[order[i]] * m + rank
    # 2. Sort by the combined key.
    for i in range(m):
        order[i] = i
    stable_sort(order, key, spare)
    return order


@helper(allocates=True)
def _order_of_equals(n, d, coords, axis, group):
    """Order points that count as equal along one axis by their coordinates along the next axes."""
    extent = 0.0
    if len(group) == 1:
        return np.zeros(1, np.int64)
    for step in range(1, d):
        low, high = _extremes(n, coords[(axis + step) % d])
        extent = max(extent, high - low)
    return _break_ties(coords[:d, :n], axis, group, _TIE * extent)


@helper(allocates=True)
def split_in_order(n, d, coords, axis, weight, share, order):
    """Find the ``upper`` points: those above a weighted quantile of coordinate ``axis`` of ``coords (3, m)``.

    Points count as equal within 1e-7 of the extent, and the other coordinates decide between them. The
    ``weight`` adds up to 1. Returns the coordinate of the cut, and the maximum distance of equal points from
    it.
    """
    shares, upper = order.shares, order.upper
    score, whole = coords[axis], np.int64(0)
    # 1. Integer shares, whose sums do not depend on the order of the points.
    for k in range(n):
        shares[k] = np.int64(np.rint(weight[k] * _SHARE))
        whole += shares[k]
    whole = np.int64(2.0 * share * whole)  # doubled target sum, as the median compares with half of it
    # 2. The quantile, and the points that count as equal to it.
    low, high = _extremes(n, score)
    bar = _median(n, score, shares, whole, order.chosen, order.keys, order.bins)
    group = _equals(n, score, bar, _TIE * (high - low), order.chosen)
    least, most = score[group[0]], score[group[len(group) - 1]]
    # 3. Points beyond this group are on a definite side. The group itself fills the lower side up to the
    #    share.
    below, n_below = np.int64(0), np.int64(0)
    for k in range(n):
        above = np.int64(score[k] >= least)
        upper[k] = above
        below += (1 - above) * shares[k]
        n_below += 1 - above
    place, cut = _order_of_equals(n, d, coords, axis, group), np.int64(0)
    while cut < len(group) and 2 * below + shares[group[place[cut]]] <= whole:
        below += shares[group[place[cut]]]
        cut += 1
    cut = min(max(cut, 1 - n_below), n - 1 - n_below)  # neither side is empty
    for k in range(len(group)):
        upper[group[place[k]]] = k >= cut
    return bar, most - least


@helper
def _offset(moment, measure, moments, measures):
    """Return the signed distance along an axis from the centroid of a piece to that of a side."""
    return moment / measure - moments / measures if measure > 0.0 else 0.0


@helper
def tag_upper(graph, pieces, lo, hi, upper, score, bar, slack, candidates, sides):
    """Assign the cells to sides by the mask ``upper``, and list the cells that may lie along the cut.

    Writes the ``sides`` and the ``candidates``, and returns the candidate count. The normal is the axis
    of ``relax_interface``, the line to the centroid of the smaller side.
    """
    cells, tag, centroids, measures = pieces.cells, pieces.tag, graph.centroids, graph.measures
    reach, length, normal = graph.reach, graph.units.length, sides.normal
    left_tag, right_tag = side_tags(lo, hi)
    m, n_upper, last = np.int64(0), np.int64(0), centroids.shape[1] - 1
    lower_sum, upper_sum, x, y, z, p, q, r = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    # 1. Tag each cell, sum masses and first moments of both sides, and list the candidates.
    start = np.uint64(lo)
    for k in range(np.uint64(hi - lo)):
        i, side = np.uint32(cells[start + k]), np.int64(upper[k])
        tag[i] = right_tag if side else left_tag
        upper_mass = side * measures[i]
        lower_mass = (1 - side) * measures[i]
        lower_sum, upper_sum, n_upper = lower_sum + lower_mass, upper_sum + upper_mass, n_upper + side
        x, p = x + lower_mass * centroids[i, 0], p + upper_mass * centroids[i, 0]
        y, q = y + lower_mass * centroids[i, 1], q + upper_mass * centroids[i, 1]
        z, r = z + lower_mass * centroids[i, last], r + upper_mass * centroids[i, last]
        candidates[m] = i
        m += abs(score[k] - bar) * length <= reach[i] + slack * length
    # 2. Sides and normal.
    sides.measures[0], sides.measures[1] = lower_sum, upper_sum
    sides.counts[0], sides.counts[1] = hi - lo - n_upper, n_upper
    # The driver turns normals to the smaller side.
    smaller, sign = (upper_sum, 1.0) if upper_sum < lower_sum else (lower_sum, -1.0)
    normal[0] = sign * _offset(p if upper_sum < lower_sum else x, smaller, x + p, lower_sum + upper_sum)
    normal[1] = sign * _offset(q if upper_sum < lower_sum else y, smaller, y + q, lower_sum + upper_sum)
    normal[2] = sign * _offset(r if upper_sum < lower_sum else z, smaller, z + r, lower_sum + upper_sum)
    return m


@helper
def holds_share(sides, share):
    """Return True if the lighter side has its mass share up to a tolerance."""
    left, right = sides.measures[0], sides.measures[1]
    whole, lighter = left + right, min(left, right)
    return whole > 0.0 and abs(lighter / whole - share) <= _NEAR * share


@helper(allocates=True)
def _line_between(centroids, weight, pieces, lo, hi, line):
    """Compute the unit vector ``line`` from the centroid of the left side to that of the right side.

    The cell ``weight`` adds up to 1. Returns the weight of the left side.
    """
    cells, tag, moments, below = pieces.cells, pieces.tag, np.zeros((2, 3)), 0.0
    first = cells[lo]
    for k in range(lo, hi):
        i, side, w = cells[k], np.int64(tag[cells[k]] & 1), weight[k - lo]
        below += (1 - side) * w
        for c in range(centroids.shape[1]):
            moments[side, c] += w * (centroids[i, c] - centroids[first, c])
    square = 0.0
    for c in range(3):
        line[c] = moments[1, c] / (1.0 - below) - moments[0, c] / below if 0.0 < below < 1.0 else 0.0
        square += line[c] * line[c]
    for c in range(3):  # any axis if the centroids coincide
        line[c] = line[c] / np.sqrt(square) if square > 0.0 else np.float64(c == 0)
    return below


@helper
def _across(line, d, frame):
    """Complete the unit vector ``line (3,)`` to an orthonormal frame.

    The other axes decide between equal cells.
    """
    for c in range(3):
        frame[0, c] = line[c]
    if d == 2:
        frame[1, 0], frame[1, 1], frame[1, 2] = -line[1], line[0], 0.0
        return
    flat = 0  # the coordinate axis closest to perpendicular
    for c in range(1, 3):
        flat = c if abs(line[c]) < abs(line[flat]) - 1e-6 else flat
    norm = np.sqrt(1.0 - line[flat] * line[flat])
    for c in range(3):
        frame[1, c] = (np.float64(c == flat) - line[flat] * line[c]) / norm
    for c in range(3):
        a, b = (c + 1) % 3, (c + 2) % 3
        frame[2, c] = frame[0, a] * frame[1, b] - frame[0, b] * frame[1, a]


@helper(allocates=True)
def shift_cut(graph, pieces, lo, hi, share, candidates, sides):
    """Move the cut of a piece until the lighter side has a mass ``share``.

    The new cut is straight, across the line between the centroids of the tagged sides. Arguments and result
    follow ``piece_driver.tag_sides``.
    """
    cells, centroids, measures, n, d = (
        pieces.cells,
        graph.centroids,
        graph.measures,
        hi - lo,
        graph.centroids.shape[1],
    )
    coords, weight, line, frame = np.zeros((3, n)), np.empty(n), np.empty(3), np.zeros((3, 3))
    # 1. Mass shares within the piece, or cell counts without mass.
    total = 0.0
    for k in range(n):
        weight[k] = measures[cells[lo + k]]
        total += weight[k]
    for k in range(n):
        weight[k] = weight[k] / total if total > 0.0 else 1.0 / n
    # 2. Coordinates along the line between the centroids, and across it.
    below = _line_between(centroids, weight, pieces, lo, hi, line)
    _across(line, d, frame)
    first = cells[lo]
    for k in range(n):
        for a in range(d):
            for c in range(d):
                coords[a, k] += frame[a, c] * (centroids[cells[lo + k], c] - centroids[first, c])
    # 3. The quantile that leaves the share to the lighter side.
    order, left_share = new_order(n), share if below <= 0.5 + 1e-9 else 1.0 - share
    bar, slack = split_in_order(n, d, coords, 0, weight, left_share, order)
    low, high = _extremes(n, coords[0])
    slack += 1e-12 * (high - low)
    return tag_upper(graph, pieces, lo, hi, order.upper, coords[0], bar, slack, candidates, sides)


@kernel
def shift_sides(offsets, centroids, mass, sides, shares):
    """Move the cuts of blocks whose lighter side misses its mass share, and return the sides ``(n,)``.

    See ``shift_cut``.
    """
    n, largest = len(sides), np.int64(0)
    for b in range(len(shares)):
        largest = max(largest, offsets[b + 1] - offsets[b])
    # 1. Records in which each block is a piece.
    cells, tag = np.empty(n, np.int32), np.empty(n, np.int32)
    candidates, reach = np.empty(largest + 1, np.int32), np.zeros(n, np.float32)
    pieces, block_sides = Pieces(cells, tag, np.empty((0, 4), np.int32)), new_sides()
    graph = PieceGraph(offsets, cells, mass, centroids, mass, mass, reach, Units(1.0, 1.0, 1.0))
    for b in range(len(shares)):
        lo, hi = offsets[b], offsets[b + 1]
        # 2. Tag the sides of the block, and sum their masses.
        left_tag, right_tag = side_tags(lo, hi)
        block_sides.measures[0], block_sides.measures[1] = 0.0, 0.0
        for i in range(lo, hi):
            cells[i], tag[i] = i, right_tag if sides[i] else left_tag
            block_sides.measures[sides[i]] += mass[i]
        # 3. Move the cut if it misses its share.
        if not holds_share(block_sides, shares[b]):
            shift_cut(graph, pieces, lo, hi, shares[b], candidates, block_sides)
    moved = np.empty(n, np.int64)
    for i in range(n):
        moved[i] = tag[i] & 1
    return moved
