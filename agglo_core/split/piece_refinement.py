"""Refinement of the two sides of a piece: cells beside the cut move until its interface is shortest."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import ONE, helper
from agglo_core.compiled.ring_search import keeps_whole
from agglo_core.compiled.sorting import sort_by_keys

_SWEEPS = 10
_SEEN, _LISTED = np.int64(2), np.int64(3)  # columns of the marks; bare numbers would be types of their own
_TIE = 1e-9


@helper
def _sum_up(graph, tag, i, left, right, sums, place):
    """Write to ``sums[place]`` what cell i shares with the other side and with its own."""
    indptr, indices, interface = graph
    own, there, here = np.int64(tag[i]), 0.0, 0.0
    other = left + right - own
    for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
        t, length = tag[np.uint32(indices[h])], interface[h]
        there += length if t == other else 0.0
        here += length if t == own else 0.0
    sums[place, 0], sums[place, 1] = there, here


@helper
def _gain(known, i):
    """Interface saved if the listed cell i goes to the other side, and the least that counts as something."""
    sums, marks, stamp = known
    place = marks[i, _LISTED] - stamp
    there, here = sums[place, 0], sums[place, 1]
    return there - here if there > 0.0 else -np.inf, _TIE * (there + here)


@helper
def _partner(graph, tag, i, own, gain, least, known):
    """The neighbour with which cell i should move, −1 if no pair pays.

    Cells not listed are not beside the other side: they lose at least what they share with cell i.
    """
    indptr, indices, interface = graph
    sums, marks, stamp = known
    partner, best = np.int64(-1), least
    for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
        j = np.uint64(np.uint32(indices[h]))
        if tag[j] != own:
            continue
        place, both = marks[j, _LISTED] - stamp, gain + 2.0 * interface[h]
        if place >= 0:
            both += sums[place, 0] - sums[place, 1]
        elif gain + interface[h] <= best:
            continue
        else:
            for g in range(np.uint64(indptr[j]), np.uint64(indptr[j + ONE])):
                both -= interface[g] if tag[np.uint32(indices[g])] == own else 0.0
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
def _paying(graph, centroids, tag, known, later, m, pairs, axis, keys, now):
    """Write to ``now`` the cells of ``later[:m]`` worth moving, along ``axis``; returns how many."""
    found = 0
    for c in range(m):
        i = np.uint64(later[c])
        gain, least = _gain(known, i)
        pays = gain > least
        if not pays and pairs and gain > -np.inf:
            pays = _partner(graph, tag, i, np.int64(tag[i]), gain, least, known) >= 0
        if pays:
            now[found], keys[found] = i, 0.0
            for k in range(centroids.shape[1]):
                keys[found] += axis[k] * centroids[i, k]
            found += 1
    sort_by_keys(now, keys, found)
    return found


@helper
def _note_move(graph, tag, left, right, i, lists, filled, known, sweep):
    """Sum up cell i and its neighbours in the piece, and list them; returns the new lengths of the lists.

    The first list is that of all cells that are known, the second of those to be looked at after this sweep.
    """
    indptr, indices, _ = graph
    (listed, later), (edge, m), (sums, marks, stamp) = lists, filled, known
    before = np.int64(indptr[i]) - 1
    for h in range(before, np.int64(indptr[i + ONE])):
        j = np.uint64(np.uint32(indices[h])) if h > before else i
        if tag[j] != left and tag[j] != right:
            continue
        if marks[j, _LISTED] < stamp:
            marks[j, _LISTED] = stamp + edge
            listed[edge] = j
            edge += 1
        _sum_up(graph, tag, j, left, right, sums, marks[j, _LISTED] - stamp)
        if marks[j, _SEEN] != sweep:
            marks[j, _SEEN] = sweep
            later[m] = j
            m += 1
    return edge, m


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
    boundary, now, later, queue, root, keys, sums, marks = room
    size, count = sides
    tally = (size, count, floor * min(size[0], size[1]))
    search, known, lists = (queue, root, marks), (sums, marks, stamp), (boundary, later)
    listing, m = stamp, edge
    for c in range(edge):
        i = np.uint64(boundary[c])
        later[c], marks[i, _LISTED] = i, listing + c
        _sum_up(graph, tag, i, left, right, sums, c)
    pairs, paired = False, False
    for _ in range(_SWEEPS):
        moves = _paying(graph, centroids, tag, known, later, m, pairs, axis, keys, now)
        stamp += 1
        sweep, m = stamp, np.int64(0)
        for c in range(moves):
            i = np.uint64(now[c])
            own = np.int64(tag[i])
            other = left + right - own
            gain, least = _gain(known, i)
            partner = np.int64(-1)
            if gain <= least:
                if pairs and gain > -np.inf:
                    partner = _partner(graph, tag, i, own, gain, least, known)
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
                edge, m = _note_move(graph, tag, left, right, also, lists, (edge, m), known, sweep)
            edge, m = _note_move(graph, tag, left, right, i, lists, (edge, m), known, sweep)
        if pairs:
            pairs = False
        elif m == 0 and not paired:
            pairs, paired, m = True, True, edge
            for c in range(edge):
                later[c] = boundary[c]
        if m == 0:
            break
    return edge, max(stamp, listing + edge) + 1
