"""Refinement of the two sides of a piece: cells beside the cut move until its interface is shortest."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import ONE, helper
from agglo_core.kernels.ring_search import keeps_whole

__all__ = ["refine_sides", "sort_by_keys"]

_SWEEPS = 10
_SEEN, _LISTED = np.int64(2), np.int64(3)  # columns of the marks; bare numbers would be types of their own
_TIE = 1e-9


@helper
def _gain(graph, tag, i, own, other):
    """Interface saved if cell i goes to the other side, and the least that counts as something."""
    indptr, indices, interface = graph
    there, here, beside = 0.0, 0.0, False
    for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
        t, length = tag[np.uint32(indices[h])], interface[h]
        there += length if t == other else 0.0
        here += length if t == own else 0.0
        beside |= t == other
    return there - here if beside else -np.inf, _TIE * (there + here)


@helper
def _partner(graph, tag, i, own, other, gain, least):
    """The neighbour with which cell i should move, −1 if no pair pays."""
    indptr, indices, interface = graph
    partner, best = np.int64(-1), least
    for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
        j = np.uint64(np.uint32(indices[h]))
        if tag[j] == own:
            there, here = gain + 2.0 * interface[h], 0.0
            for g in range(np.uint64(indptr[j]), np.uint64(indptr[j + ONE])):
                t, length = tag[np.uint32(indices[g])], interface[g]
                there += length if t == other else 0.0  # no branch: it would be mispredicted
                here += length if t == own else 0.0
            both = there - here
            if both > best:
                partner, best = np.int64(j), both
    return partner


@helper
def _leave(graph, measures, tag, i, own, other, sides, search, stamp):
    """Move cell i to the other side unless its own would break, empty or sink below the floor."""
    size, count, floor = sides
    s = own & 1  # tags of right sides are odd
    if count[s] < 2 or size[s] - measures[i] < floor:
        return False
    if not keeps_whole(graph[0], graph[1], tag, np.int64(i), search, stamp):
        return False
    _put(measures, tag, i, other, sides)
    return True


@helper
def _put(measures, tag, i, other, sides):
    size, count, _ = sides
    tag[i] = other
    to = other & 1
    size[to] += measures[i]
    size[1 - to] -= measures[i]
    count[to] += 1
    count[1 - to] -= 1


@helper
def sort_by_keys(items, keys, m):
    """Shell sort of ``items[:m]`` by ascending ``keys[:m]``, which are sorted along."""
    gap = 1
    while gap < m // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for k in range(gap, m):
            item, key, place = items[k], keys[k], k
            while place >= gap and keys[place - gap] > key:
                items[place], keys[place] = items[place - gap], keys[place - gap]
                place -= gap
            items[place], keys[place] = item, key
        gap //= 3


@helper
def _paying(graph, centroids, tag, left, right, later, m, pairs, axis, keys, now):
    """Write to ``now`` the cells of ``later[:m]`` worth moving, along ``axis``; returns how many."""
    found = 0
    for c in range(m):
        i = np.uint64(later[c])
        own = np.int64(tag[i])
        other = left + right - own
        gain, least = _gain(graph, tag, i, own, other)
        pays = gain > least
        if not pays and pairs and gain > -np.inf:
            pays = _partner(graph, tag, i, own, other, gain, least) >= 0
        if pays:
            now[found], keys[found] = i, 0.0
            for k in range(centroids.shape[1]):
                keys[found] += axis[k] * centroids[i, k]
            found += 1
    sort_by_keys(now, keys, found)
    return found


@helper
def _add_near(graph, tag, left, right, i, listed, m, marks, kind, stamp):
    """Append cell i and its neighbours in the piece not seen under ``stamp``; returns the new length."""
    indptr, indices, _ = graph
    before = np.int64(indptr[i]) - 1
    for h in range(before, np.int64(indptr[i + ONE])):
        j = np.uint64(np.uint32(indices[h])) if h > before else i
        if (tag[j] == left or tag[j] == right) and marks[j, kind] != stamp:
            marks[j, kind] = stamp
            listed[m] = j
            m += 1
    return m


@helper
def refine_sides(graph, centroids, measures, tag, left, right, axis, sides, floor, edge, room, stamp):
    """Sweeps of moves that shorten the interface of two sides; neither breaks, empties or sinks too low.

    Single cells along ``axis`` until none pays, pairs of neighbours once, and single cells again. Neither
    side falls below ``floor`` times the smaller one's measure at entry.

    Parameters
    ----------
    sides : size (2,) float, count (2,) int, changed
        Measure and cells of the left and the right side.
    edge : int
        How many cells stand in ``boundary``, the first array of ``room``: those beside the other side.
    room : work arrays
        See :func:`piece_room`. ``boundary`` also lists, at the end, all cells that once were beside the
        other side, and their neighbours.
    stamp : int
        A number larger than any in ``marks``, the last array of ``room``.

    Returns
    -------
    How many cells are in ``boundary`` now, and the next unused stamp.
    """
    boundary, now, later, queue, root, keys, marks = room
    size, count = sides
    tally = (size, count, floor * min(size[0], size[1]))
    search = (queue, root, marks)
    everywhere, m = stamp, edge
    for c in range(edge):
        later[c] = boundary[c]
        marks[boundary[c], _LISTED] = everywhere
    pairs, paired = False, False
    for _ in range(_SWEEPS):
        moves = _paying(graph, centroids, tag, left, right, later, m, pairs, axis, keys, now)
        stamp += 1
        sweep, m = stamp, np.int64(0)
        for c in range(moves):
            i = np.uint64(now[c])
            own = np.int64(tag[i])
            other = left + right - own
            gain, least = _gain(graph, tag, i, own, other)
            partner = -1
            if gain <= least:
                if pairs and gain > -np.inf:
                    partner = _partner(graph, tag, i, own, other, gain, least)
                if partner < 0:
                    continue
            stamp += 1
            if not _leave(graph, measures, tag, i, own, other, tally, search, stamp):
                continue
            if partner >= 0:
                stamp += 1
                also = np.uint64(partner)
                if not _leave(graph, measures, tag, also, own, other, tally, search, stamp):
                    _put(measures, tag, i, own, tally)
                    continue
                m = _add_near(graph, tag, left, right, also, later, m, marks, _SEEN, sweep)
                edge = _add_near(graph, tag, left, right, also, boundary, edge, marks, _LISTED, everywhere)
            m = _add_near(graph, tag, left, right, i, later, m, marks, _SEEN, sweep)
            edge = _add_near(graph, tag, left, right, i, boundary, edge, marks, _LISTED, everywhere)
        if pairs:
            pairs = False
        elif m == 0 and not paired:
            pairs, paired, m = True, True, edge
            for c in range(edge):
                later[c] = boundary[c]
        if m == 0:
            break
    return edge, stamp + 1
