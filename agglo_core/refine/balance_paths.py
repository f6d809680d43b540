"""Balance: cells are handed on from parts that are too large to parts that are too small.

The way goes through parts beside one another, each of which takes some cells from the one before it and hands
others on, so that the sizes of those between stay nearly as they were.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel
from agglo_core.compiled.ring_search import CROWD, connected
from agglo_core.compiled.sorting import put_in, take_out
from agglo_core.refine.compactness.reach import part_lists

_TRIES = 6  # ways tried for one part before it is given up; each costs a search over parts and its moves


class Parts(NamedTuple):
    """Labels, sizes and numbers of cells of parts, and their cells as lists."""

    labels: Any
    sizes: Any
    cells: Any
    first: Any
    after: Any
    before: Any


@helper
def _move(weights, parts, i, target):
    """Move cell i to part ``target``."""
    home, w = parts.labels[i], weights[i]
    # Unlink the cell from the list of its part.
    if parts.before[i] >= 0:
        parts.after[parts.before[i]] = parts.after[i]
    else:
        parts.first[home] = parts.after[i]
    if parts.after[i] >= 0:
        parts.before[parts.after[i]] = parts.before[i]
    # Put it first in the list of the target.
    parts.after[i], parts.before[i] = parts.first[target], -1
    if parts.first[target] >= 0:
        parts.before[parts.first[target]] = i
    parts.first[target], parts.labels[i] = i, target
    parts.sizes[home] -= w
    parts.sizes[target] += w
    parts.cells[home] -= 1
    parts.cells[target] += 1


@helper
def _centre(graph, weights, parts, p, out):
    """Centre of part p, or the sum of its centroids if it weighs nothing."""
    (_, _, centroids), total = graph, 0.0
    for a in range(len(out)):
        out[a] = 0.0
    i = parts.first[p]
    while i >= 0:
        total += weights[i]
        for a in range(len(out)):
            out[a] += weights[i] * centroids[i, a]
        i = parts.after[i]
    for a in range(len(out)):
        out[a] /= total if total > 0.0 else 1.0


@helper
def _beside(graph, parts, i, target):
    """Return whether cell i has a neighbour in part ``target``."""
    (indptr, indices, _), found = graph, False
    for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
        found |= parts.labels[np.uint32(indices[h])] == target
    return found


@helper
def _can_spare(indptr, indices, labels, i, rings, stamp):
    """Return whether the part of cell i stays connected without it, be it all the way around a ring."""
    home, queue, filled = labels[i], rings[0], np.int64(0)
    for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
        queue[filled] = np.uint32(indices[h])
        filled += labels[np.uint32(indices[h])] == home
    if filled < 2:
        return True
    labels[i] = -1  # out of the way
    whole = connected(indptr, indices, labels, home, rings, filled, stamp, np.int64(len(labels)), CROWD)
    labels[i] = home
    return whole


@helper
def _shift(graph, weights, parts, home, target, amount, moved, done, work, stamp):
    """Move cells of about this size from ``home`` to ``target``, those first that lie most towards it.

    They are noted in rows of ``moved`` (cell, part that it left) from ``done`` on, as long as there are rows.
    Returns where they end, the size that was moved, and the last stamp.
    """
    indptr, indices, centroids = graph
    heap, keys, place, rings, centres = work[4]
    # 1. The direction from the centre of the one part to that of the other.
    _centre(graph, weights, parts, home, centres[0])
    _centre(graph, weights, parts, target, centres[1])
    size, total, i = np.int64(0), 0.0, parts.first[home]
    for a in range(centroids.shape[1]):
        centres[0, a] = centres[1, a] - centres[0, a]
    # 2. Cells of the part adjacent to the target, those furthest along this direction on top of a heap.
    while i >= 0:
        if _beside(graph, parts, np.uint64(i), target):
            key = 0.0
            for a in range(centroids.shape[1]):
                key += centres[0, a] * centroids[i, a]
            size = put_in(heap, keys, place, size, np.int64(i), key)
        i = parts.after[i]
    # 3. They move until the amount is reached. One cell may exceed it, later ones must not: the first that
    #    would ends the shift. Cells that hold the part together are passed over.
    while size > 0 and parts.cells[home] > 1 and done < len(moved):
        cell, size = take_out(heap, keys, place, size)
        i = np.uint64(cell)
        if total > 0.0 and total + weights[i] > amount * (1.0 + 1e-9):
            break
        stamp += 1
        if not _can_spare(indptr, indices, parts.labels, i, rings, stamp):
            continue
        moved[done, 0], moved[done, 1] = cell, home
        _move(weights, parts, i, target)
        done, total = done + 1, total + weights[i]
        if total >= amount * (1.0 - 1e-9):
            break
        # 4. Its neighbours are adjacent to the target from now on, also those that were passed over before.
        for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
            j = np.uint64(np.uint32(indices[h]))
            if parts.labels[j] == home and place[j] < 0:
                key = 0.0
                for a in range(centroids.shape[1]):
                    key += centres[0, a] * centroids[j, a]
                size = put_in(heap, keys, place, size, np.int64(j), key)
    # 5. What is left in the heap is forgotten, for the next use.
    for k in range(size):
        place[heap[k]] = -1
    return done, total, stamp


@helper
def _way(graph, parts, bounds, start, sign, barred, work):
    """Find the part nearest to ``start`` whose size is on the other side of the mean, or −1.

    A search in breadth over the parts of the block. ``came`` has the part before each part of the way. It
    does not go from one part to the next where the pair is ``barred``: a count in row 0, pairs after it.
    """
    indptr, indices, _ = graph
    block, mean = bounds[0], bounds[1]
    queue, came, seen = work[0], work[1], work[2]
    # Marks of earlier searches differ from the number of this one, which is kept behind them.
    turn = seen[len(seen) - 1] + 1
    seen[len(seen) - 1] = turn
    queue[0], seen[start], filled, done = start, turn, 1, 0
    while done < filled:
        p = queue[done]
        done += 1
        # 1. Reached a part that lacks what the start has too much of (sign 1), or the reverse (−1)?
        if p != start and sign * (parts.sizes[p] - mean[block[p]]) < 0.0:
            return np.int64(p)
        # 2. Else go on to the parts adjacent to its cells.
        i = parts.first[p]
        while i >= 0:
            for h in range(np.uint64(indptr[i]), np.uint64(indptr[np.uint64(i) + ONE])):
                q = parts.labels[np.uint32(indices[h])]
                if seen[q] == turn or block[q] != block[p]:
                    continue
                free = True
                for b in range(barred[0, 0]):
                    free &= barred[b + 1, 0] != p or barred[b + 1, 1] != q
                if free:
                    seen[q], came[q], queue[filled] = turn, p, q
                    filled += 1
            i = parts.after[i]
    return np.int64(-1)


@helper
def _unevenness(parts, way, length, mean):
    """Sum of the squared deviations from the mean size over the parts of a way."""
    total = 0.0
    for s in range(length):
        total += (parts.sizes[way[s]] - mean) ** 2
    return total


@helper
def _hand_on(graph, weights, parts, mean, length, sign, barred, work, stamp):
    """Hand cells on along the way in the queue, unless that brings sizes no nearer to the mean.

    The way has ``length`` parts, from that looked at (``sign`` 1: too large, −1: too small). Returns whether
    cells were handed on, and the last stamp.
    """
    way, moved, done = work[0], work[3], np.int64(0)
    before = _unevenness(parts, way, length, mean)
    # 1. At most as much as brings the nearer one of both ends to the mean.
    amount = min(abs(parts.sizes[way[0]] - mean), abs(parts.sizes[way[length - 1]] - mean))
    whole = True
    # 2. From the large end to the small one, each part hands on as much as it got.
    for s in range(length - 1):
        home, target = (way[s], way[s + 1]) if sign > 0 else (way[length - 1 - s], way[length - 2 - s])
        start = done
        done, amount, stamp = _shift(graph, weights, parts, home, target, amount, moved, done, work, stamp)
        if done == start:
            # No cell can go between these two: later ways go around the pair.
            barred[0, 0] += 1
            one, other = (home, target) if sign > 0 else (target, home)
            barred[barred[0, 0], 0], barred[barred[0, 0], 1] = one, other
            whole = False
            break
    # 3. Kept only if the sum of squares falls, so that trades come to an end.
    if whole and _unevenness(parts, way, length, mean) < before * (1.0 - 1e-12):
        return True, stamp
    if whole:
        barred[0, 0] = _TRIES  # another way would not do better
    # 4. Otherwise all moves are undone, the last one first.
    for back in range(done):
        _move(weights, parts, moved[done - 1 - back, 0], moved[done - 1 - back, 1])
    return False, stamp


@helper
def _traded(graph, weights, parts, bounds, p, sign, work, stamp):
    """Hand cells on from part p (sign 1), or to it (−1), by one of several ways.

    Returns whether one served, and the last stamp.
    """
    queue, came, barred = work[0], work[1], work[5]
    barred[0, 0] = 0
    while barred[0, 0] < _TRIES:
        end = _way(graph, parts, bounds, p, sign, barred, work)
        if end < 0:
            break
        # The way, from its last part back to p: its length, then its parts in their order.
        length, q = 1, end
        while q != p:
            length, q = length + 1, came[q]
        for s in range(length):
            queue[length - 1 - s] = end
            end = came[end]
        mean = bounds[1][bounds[0][p]]
        done, stamp = _hand_on(graph, weights, parts, mean, length, sign, barred, work, stamp)
        if done:
            return True, stamp
    return False, stamp


@kernel
def even_out(indptr, indices, centroids, weights, labels, block, mean, room):
    """Labels ``(n,)`` of parts whose sizes are within ``room (B,)`` of the mean of their block, if possible.

    Parameters
    ----------
    weights : (n,) float
        Summands of the sizes of parts.
    labels : (n,) int
        Parts, connected; they stay so, and none is emptied.
    block : (k,) int
        Block of each part; cells are not handed on between blocks.
    mean, room : (B,) float
        Mean size of the parts of each block, and the largest deviation allowed.
    """
    n, k = len(labels), len(block)
    own = labels.astype(np.int32)
    # 1. Labels, sizes and lists of cells of the parts.
    first, after, before = part_lists(own, k)
    parts = Parts(own, np.zeros(k), np.zeros(k, np.int64), first, after, before)
    for i in range(n):
        parts.sizes[own[i]] += weights[i]
        parts.cells[own[i]] += 1
    graph, bounds, stamp = (indptr, indices, centroids), (block, mean), np.int64(0)
    # 2. Work arrays: of searches for connection, of the heap of a shift, of ways between parts.
    rings = (np.empty(n + 1, np.int32), np.empty(n + 1, np.int32), np.zeros((n, 2), np.int64))
    heap, keys, place = np.empty(n, np.int32), np.empty(n), np.full(n, -1, np.int32)
    shift = (heap, keys, place, rings, np.empty((2, centroids.shape[1])))
    queue, came, seen = np.empty(k, np.int32), np.zeros(k, np.int32), np.zeros(k + 1, np.int64)
    work = (queue, came, seen, np.empty((n, 2), np.int64), shift, np.zeros((_TRIES + 2, 2), np.int64))
    # 3. Each part that is too large or too small trades until it is neither or no way serves, again and
    #    again as long as anything moves: what is blocked now may be free later.
    changed = True
    while changed:
        changed = False
        for p in range(k):
            b, going = block[p], True
            while going and abs(parts.sizes[p] - mean[b]) > room[b]:
                sign = 1.0 if parts.sizes[p] > mean[b] else -1.0
                going, stamp = _traded(graph, weights, parts, bounds, p, sign, work, stamp)
                changed |= going
    return own.astype(np.int64)
