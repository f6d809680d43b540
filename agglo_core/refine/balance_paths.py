"""Balance kernels: pass cells from parts that are too large to parts that are too small.

A path leads through adjacent parts. Each part takes cells from the previous part and passes on about as many,
so the sizes in between hardly change.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel
from agglo_core.compiled.ring_search import CROWD, are_connected
from agglo_core.compiled.sorting import put_in, take_out
from agglo_core.refine.compactness.reach import part_lists

# Maximum number of paths per part. Each costs a search over parts and its moves, but more paths leave fewer
# parts out of balance (benchmarks/interfaces.py, row balance).
_TRIES = 6


class Parts(NamedTuple):
    """Labels, sizes, cell counts and linked cell lists of the parts."""

    labels: Any
    sizes: Any
    cells: Any
    first: Any
    after: Any
    before: Any


class Shift(NamedTuple):
    """Workspace for moving cells between two parts: a heap of cells, search arrays, and two part centres."""

    heap: Any
    keys: Any
    place: Any
    rings: Any
    centres: Any


class Paths(NamedTuple):
    """Workspace for the search of paths along which cells are passed from part to part.

    ``queue (k,)`` holds the parts in search order, later those of a path; ``came (k,)`` is the
    predecessor per part, ``seen (k + 1,)`` the number of the search that reached it. Rows of ``moves``
    are the moved cell and its old part. Rows of ``barred`` are their number, then pairs of parts.
    """

    queue: Any
    came: Any
    seen: Any
    moves: Any
    shift: Any
    barred: Any


@helper
def _move(weights, parts, i, target):
    """Move cell i to part ``target``."""
    home, w = parts.labels[i], weights[i]
    # Unlink the cell from its part's list.
    if parts.before[i] >= 0:
        parts.after[parts.before[i]] = parts.after[i]
    else:
        parts.first[home] = parts.after[i]
    if parts.after[i] >= 0:
        parts.before[parts.after[i]] = parts.before[i]
    # Insert the cell at the front of the target's list.
    parts.after[i], parts.before[i] = parts.first[target], -1
    if parts.first[target] >= 0:
        parts.before[parts.first[target]] = i
    parts.first[target], parts.labels[i] = i, target
    parts.sizes[home] -= w
    parts.sizes[target] += w
    parts.cells[home] -= 1
    parts.cells[target] += 1


@helper
def _centre(graph, weights, parts, p, centre):
    """Compute the centre of mass of part p, or zeros if its weight is zero."""
    (_, _, centroids), total = graph, 0.0
    for a in range(len(centre)):
        centre[a] = 0.0
    i = parts.first[p]
    while i >= 0:
        total += weights[i]
        for a in range(len(centre)):
            centre[a] += weights[i] * centroids[i, a]
        i = parts.after[i]
    for a in range(len(centre)):
        centre[a] /= total if total > 0.0 else 1.0


@helper
def _beside(graph, parts, i, target):
    """Return True if cell i has a neighbour in part ``target``."""
    (indptr, indices, _), is_adjacent = graph, False
    for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
        is_adjacent |= parts.labels[np.uint32(indices[h])] == target
    return is_adjacent


@helper
def _can_spare(indptr, indices, labels, i, rings, stamp):
    """Return True if the part of cell i stays connected without it.

    The search has no distance limit, so that it can pass all the way around a ring.
    """
    home, queue, filled = labels[i], rings[0], np.int64(0)
    for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
        queue[filled] = np.uint32(indices[h])
        filled += labels[np.uint32(indices[h])] == home
    if filled < 2:
        return True
    labels[i] = -1  # hide the cell from the search
    whole = are_connected(indptr, indices, labels, home, rings, filled, stamp, np.int64(len(labels)), CROWD)
    labels[i] = home
    return whole


@helper
def _shift(graph, weights, parts, home, target, amount, n_moves, paths, stamp):
    """Move cells of total size about ``amount`` from ``home`` to ``target``, closest to the target first.

    Moves are recorded in rows of ``paths.moves`` from ``n_moves`` on, up to the row count.
    Returns the end row, the moved size and the last stamp.
    """
    indptr, indices, centroids = graph
    heap, keys, place, rings, centres = paths.shift
    moves = paths.moves
    # 1. Direction from one part's centre to the other's.
    _centre(graph, weights, parts, home, centres[0])
    _centre(graph, weights, parts, target, centres[1])
    size, total, i = np.int64(0), 0.0, parts.first[home]
    for a in range(centroids.shape[1]):
        centres[0, a] = centres[1, a] - centres[0, a]
    # 2. Heap of the part's cells adjacent to the target, farthest along this direction on top.
    while i >= 0:
        if _beside(graph, parts, np.uint64(i), target):
            key = 0.0
            for a in range(centroids.shape[1]):
                key += centres[0, a] * centroids[i, a]
            size = put_in(heap, keys, place, size, np.int64(i), key)
        i = parts.after[i]
    # 3. Move cells until the amount is reached. The first cell may exceed it. A later cell that would exceed
    #    it ends the shift. Cells that keep the part connected are skipped.
    while size > 0 and parts.cells[home] > 1 and n_moves < len(moves):
        cell, size = take_out(heap, keys, place, size)
        i = np.uint64(cell)
        if total > 0.0 and total + weights[i] > amount * (1.0 + 1e-9):
            break
        stamp += 1
        if not _can_spare(indptr, indices, parts.labels, i, rings, stamp):
            continue
        moves[n_moves, 0], moves[n_moves, 1] = cell, home
        _move(weights, parts, i, target)
        n_moves, total = n_moves + 1, total + weights[i]
        if total >= amount * (1.0 - 1e-9):
            break
        # 4. The cell's neighbours are adjacent to the target now, including cells skipped before.
        for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
            j = np.uint64(np.uint32(indices[h]))
            if parts.labels[j] == home and place[j] < 0:
                key = 0.0
                for a in range(centroids.shape[1]):
                    key += centres[0, a] * centroids[j, a]
                size = put_in(heap, keys, place, size, np.int64(j), key)
    # 5. Clear the heap for the next use.
    for k in range(size):
        place[heap[k]] = -1
    return n_moves, total, stamp


@helper
def _way(graph, parts, bounds, start, sign, paths):
    """Find the part nearest to ``start`` whose size deviates from the mean the other way, or −1 if none.

    The search is breadth-first over the block's parts. ``paths.came`` stores the predecessor of each part on
    the path. ``paths.barred`` pairs are skipped.
    """
    indptr, indices, _ = graph
    block, mean = bounds
    queue, predecessor, marks, barred = paths.queue, paths.came, paths.seen, paths.barred
    # Marks from earlier searches differ from this search's number, which is stored behind the marks.
    turn = marks[len(marks) - 1] + 1
    marks[len(marks) - 1] = turn
    queue[0], marks[start], filled, head = start, turn, 1, 0
    while head < filled:
        p = queue[head]
        head += 1
        # 1. Stop at a part that lacks size if the start has too much (sign 1), or the reverse (−1).
        if p != start and sign * (parts.sizes[p] - mean[block[p]]) < 0.0:
            return np.int64(p)
        # 2. Otherwise continue with the parts adjacent to its cells.
        i = parts.first[p]
        while i >= 0:
            for h in range(np.uint64(indptr[i]), np.uint64(indptr[np.uint64(i) + ONE])):
                q = parts.labels[np.uint32(indices[h])]
                if marks[q] == turn or block[q] != block[p]:
                    continue
                free = True
                for b in range(barred[0, 0]):
                    free &= barred[b + 1, 0] != p or barred[b + 1, 1] != q
                if free:
                    marks[q], predecessor[q], queue[filled] = turn, p, q
                    filled += 1
            i = parts.after[i]
    return np.int64(-1)


@helper
def _unevenness(parts, way, length, mean):
    """Return the sum of squared deviations from the mean size over the parts on a path."""
    total = 0.0
    for s in range(length):
        total += (parts.sizes[way[s]] - mean) ** 2
    return total


@helper
def _hand_on(graph, weights, parts, mean, length, sign, paths, stamp):
    """Pass cells from part to part along a path if this brings the part sizes closer to the mean.

    The path has ``length`` parts and starts at the part to correct (``sign`` 1: too large, −1: too small).
    Returns True if cells were passed on, and the last stamp.
    """
    way, moves, barred, n_moves = paths.queue, paths.moves, paths.barred, np.int64(0)
    before = _unevenness(parts, way, length, mean)
    # 1. Amount: the smaller deviation of both path ends from the mean.
    amount = min(abs(parts.sizes[way[0]] - mean), abs(parts.sizes[way[length - 1]] - mean))
    whole = True
    # 2. From the large end to the small end, each part passes on as much as it received.
    for s in range(length - 1):
        home, target = (way[s], way[s + 1]) if sign > 0 else (way[length - 1 - s], way[length - 2 - s])
        start = n_moves
        n_moves, amount, stamp = _shift(graph, weights, parts, home, target, amount, n_moves, paths, stamp)
        if n_moves == start:
            # No cell can move between these two parts: later paths avoid the pair.
            barred[0, 0] += 1
            p, q = (home, target) if sign > 0 else (target, home)
            barred[barred[0, 0], 0], barred[barred[0, 0], 1] = p, q
            whole = False
            break
    # 3. Accept only if the sum of squares decreases, so that the iteration terminates.
    if whole and _unevenness(parts, way, length, mean) < before * (1.0 - 1e-12):
        return True, stamp
    if whole:
        barred[0, 0] = _TRIES  # another path would not do better
    # 4. Otherwise undo all moves in reverse order.
    for back in range(n_moves):
        _move(weights, parts, moves[n_moves - 1 - back, 0], moves[n_moves - 1 - back, 1])
    return False, stamp


@helper
def _trade_cells(graph, weights, parts, bounds, p, sign, paths, stamp):
    """Reduce part p (sign 1) or enlarge it (−1) by passing cells along one of several paths.

    Returns True if a path succeeded, and the last stamp.
    """
    block, mean = bounds
    queue, predecessor, barred = paths.queue, paths.came, paths.barred
    barred[0, 0] = 0
    while barred[0, 0] < _TRIES:
        end = _way(graph, parts, bounds, p, sign, paths)
        if end < 0:
            break
        # Trace the path back from its last part to p: first its length, then its parts in order.
        length, q = 1, end
        while q != p:
            length, q = length + 1, predecessor[q]
        for s in range(length):
            queue[length - 1 - s] = end
            end = predecessor[end]
        passed, stamp = _hand_on(graph, weights, parts, mean[block[p]], length, sign, paths, stamp)
        if passed:
            return True, stamp
    return False, stamp


@kernel
def even_out(indptr, indices, centroids, weights, labels, block, mean, tolerance):
    """Move cells until part sizes are within ``tolerance (B,)`` of the block mean, if possible.

    Returns the labels ``(n,)``.

    Parameters
    ----------
    weights : (n,) float
        Cell contributions to the part sizes.
    labels : (n,) int
        Connected parts. They stay connected and non-empty.
    block : (k,) int
        Block per part. Cells do not move between blocks.
    mean, tolerance : (B,) float
        Mean part size in each block, and the largest allowed deviation.
    """
    n, k = len(labels), len(block)
    part_labels = labels.astype(np.int32)
    # 1. Labels, sizes and cell lists of the parts.
    first, after, before = part_lists(part_labels, k)
    parts = Parts(part_labels, np.zeros(k), np.zeros(k, np.int64), first, after, before)
    for i in range(n):
        parts.sizes[part_labels[i]] += weights[i]
        parts.cells[part_labels[i]] += 1
    graph, bounds, stamp = (indptr, indices, centroids), (block, mean), np.int64(0)
    # 2. Workspace for connectivity searches, for the heap of a shift, and for paths between parts.
    rings = (np.empty(n + 1, np.int32), np.empty(n + 1, np.int32), np.zeros((n, 2), np.int64))
    heap, keys, place = np.empty(n, np.int32), np.empty(n), np.full(n, -1, np.int32)
    shift = Shift(heap, keys, place, rings, np.empty((2, centroids.shape[1])))
    queue, predecessor, marks = np.empty(k, np.int32), np.zeros(k, np.int32), np.zeros(k + 1, np.int64)
    moves, barred = np.empty((n, 2), np.int64), np.zeros((_TRIES + 2, 2), np.int64)
    paths = Paths(queue, predecessor, marks, moves, shift, barred)
    # 3. Each part that is too large or too small trades cells until its size is admissible or no path
    #    succeeds. Repeat while cells move, because blocked moves may become possible.
    changed = True
    while changed:
        changed = False
        for p in range(k):
            b, traded = block[p], True
            while traded and abs(parts.sizes[p] - mean[b]) > tolerance[b]:
                sign = 1.0 if parts.sizes[p] > mean[b] else -1.0
                traded, stamp = _trade_cells(graph, weights, parts, bounds, p, sign, paths, stamp)
                changed |= traded
    return part_labels.astype(np.int64)
