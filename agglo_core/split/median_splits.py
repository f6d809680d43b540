"""Halving at medians along the longest side, depth first, in place: a whole recursion in one call.

A piece is a slice of ``lists (1 + d, n)``: its cells in rising order, and once sorted along each axis. So no
split sorts again, extents are ends of slices, and no graph is made. Cells carry the tag of their side,
twice the first place of a left one, twice the last place of a right one plus 1: no two pieces have the same.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.compiled.sorting import stable_sort
from agglo_core.compiled.sums import chosen_sum
from agglo_core.refine.repair import mend_piece
from agglo_core.split.piece_splits import tagged_components

SHARE = 2.0**40  # shares of weight are integers: their sums do not depend on the order


@helper
def _longest_axis(columns, lists, lo, hi, tie):
    """The first of the axes along which the piece is longest, its length, and the largest other length."""
    longest, axis, length, other = 0.0, -1, 0.0, 0.0
    for k in range(len(columns)):
        longest = max(longest, columns[k, lists[k + 1, hi - 1]] - columns[k, lists[k + 1, lo]])
    for k in range(len(columns)):
        extent = columns[k, lists[k + 1, hi - 1]] - columns[k, lists[k + 1, lo]]
        if axis < 0 and extent >= (1.0 - tie) * longest:
            axis, length = k, extent
        else:
            other = max(other, extent)
    return axis, length, other


@helper(allocates=True)
def untied(columns, axis, group, gap):
    """Order of cells that count as equal along an axis: by ranks along the other axes, the next one first.

    Values no further apart than ``gap`` have the same rank; what is left keeps its order.
    """
    d, m = len(columns), len(group)
    key, values = np.zeros(m), np.empty(m)
    order, spare = np.empty(m, np.int64), np.empty(m, np.int64)
    for step in range(1, d):
        for i in range(m):
            order[i], values[i] = i, columns[(axis + step) % d, group[i]]
        stable_sort(order, values, spare)
        rank = 0
        for i in range(m):
            rank += i > 0 and values[order[i]] - values[order[i - 1]] > gap
            key[order[i]] = key[order[i]] * m + rank
    for i in range(m):
        order[i] = i
    stable_sort(order, key, spare)
    return order


@helper(allocates=True)
def _halve(columns, weights, share, lists, lo, hi, tie, shares, tag):
    """Tag the cells below and above a share of the weight along the longest side of a piece."""
    axis, length, other = _longest_axis(columns, lists, lo, hi, tie)
    line, column = lists[axis + 1], columns[axis]
    total, whole = 0.0, np.int64(0)
    for k in range(lo, hi):
        total += weights[lists[0, k]]
    for k in range(lo, hi):
        own = weights[line[k]] / total if total > 0.0 else 1.0 / (hi - lo)
        shares[k] = np.int64(np.rint(own * SHARE))
        whole += shares[k]
    whole = np.int64(2.0 * share * whole)  # what is cut in the middle
    below, first = 0, lo
    while 2 * (below + shares[first]) <= whole:
        below += shares[first]
        first += 1
    last = first + 1
    while first > lo and column[line[first]] - column[line[first - 1]] <= tie * length:
        first -= 1
        below -= shares[first]
    while last < hi and column[line[last]] - column[line[last - 1]] <= tie * length:
        last += 1
    group, cut = line[first:last], 0
    if last - first == 1:
        cut = first if 2 * below + shares[first] > whole else last
        cut = min(max(cut, lo + 1), hi - 1)
        tag[group[0]] = 2 * lo if first < cut else 2 * hi - 1
    else:
        order, cut = untied(columns, axis, group, tie * other), first
        while cut < last and 2 * below + shares[first + order[cut - first]] <= whole:
            below += shares[first + order[cut - first]]
            cut += 1
        cut = min(max(cut, lo + 1), hi - 1)
        for k in range(first, last):
            tag[group[order[k - first]]] = 2 * lo if k < cut else 2 * hi - 1
    for k in range(lo, first):
        tag[line[k]] = 2 * lo
    for k in range(last, hi):
        tag[line[k]] = 2 * hi - 1


@helper
def _part(lists, lo, hi, left, tag, spare):
    """Put the cells with the tag ``left`` before the others in every list; returns where the others start."""
    middle = lo
    for row in range(len(lists)):
        line, middle, right = lists[row], lo, 0
        for k in range(lo, hi):
            i = line[k]
            on_left = tag[i] == left
            line[middle] = i  # no branch: it would be mispredicted half the time
            spare[right] = i
            middle += on_left
            right += not on_left
        for k in range(right):
            line[middle + k] = spare[k]
    return middle


@helper
def _first_quota(quota, below, above, cells_below, cells_above):
    """Parts that the first side becomes: its share by measure, rounded, at least 1 and at most its cells."""
    if not below + above > 0.0:
        below, above = float(cells_below), float(cells_above)
    least, most = max(1.0, quota - cells_above), min(quota - 1.0, float(cells_below))
    return np.int64(min(max(np.rint(quota * (below / (below + above))), least), most))


@kernel
def split_at_medians(graph, columns, lists, tag, side_shares, todo, leaves, counts, tally, tie, work):
    """Split pieces into their quotas, the last in ``todo`` first, until about ``work`` cells were handled.

    Parameters
    ----------
    graph : indptr, indices, interface, centroids, measures, weights
    columns : (d, n) float
        The centroids, one axis after the other.
    lists : (1 + d, n) int32, changed
        Cells of each piece, and the same sorted along each axis; nodes of equal value rise.
    tag : (n,) int32, changed
        Side of each cell; −1 at first.
    side_shares : (q,) float
        Share of the mass below the cut of a piece, by quota; where it is 1/2 weights are halved.
    todo : (K, 4) int, changed
        Pieces to be split: first place, last place plus 1, quota, depth. The quotas add up to at most K.
    leaves : (K, 2) int, changed
        Finished pieces.
    counts : (2,) int, changed
        Rows of ``todo`` and of ``leaves`` in use.
    tally : (depths, 3) int, changed
        At each depth: pieces split, cells in them, pieces whose sides had to be mended.
    tie : float
        Share of an extent up to which coordinates count as equal.
    """
    indptr, indices, interface, centroids, measures, weights = graph
    n = len(tag)
    shares, parent = np.empty(n, np.int64), np.empty(n, np.int32)
    spare, local = np.empty(n + 1, np.int32), np.zeros(n, np.int32)
    waiting, found = counts[0], counts[1]
    while waiting > 0 and work > 0:
        waiting -= 1
        lo, hi, quota, depth = todo[waiting, 0], todo[waiting, 1], todo[waiting, 2], todo[waiting, 3]
        if quota == 1:
            leaves[found, 0], leaves[found, 1] = lo, hi
            found += 1
            continue
        work -= hi - lo
        left, right, cells = 2 * lo, 2 * hi - 1, lists[0, lo:hi]
        share = side_shares[min(quota, len(side_shares) - 1)]
        amounts = weights if share == 0.5 else measures
        _halve(columns, amounts, share, lists, lo, hi, tie, shares, tag)
        if tagged_components(cells, indptr, indices, tag, parent) > 2:
            sides = np.empty(hi - lo, np.int64)
            for k in range(hi - lo):
                sides[k] = tag[cells[k]] == right
            sides = mend_piece(cells, sides, 2, indptr, indices, interface, centroids, measures, local)
            for k in range(hi - lo):
                tag[cells[k]] = right if sides[k] else left
            tally[depth, 2] += 1
        middle = _part(lists, lo, hi, left, tag, spare)
        first = _first_quota(
            quota,
            chosen_sum(measures, lists[0], lo, middle),
            chosen_sum(measures, lists[0], middle, hi),
            middle - lo,
            hi - middle,
        )
        tally[depth, 0] += 1
        tally[depth, 1] += hi - lo
        todo[waiting, 0], todo[waiting, 1], todo[waiting, 2] = middle, hi, quota - first
        todo[waiting + 1, 0], todo[waiting + 1, 1], todo[waiting + 1, 2] = lo, middle, first
        todo[waiting, 3], todo[waiting + 1, 3] = depth + 1, depth + 1
        waiting += 2
    counts[0], counts[1] = waiting, found
