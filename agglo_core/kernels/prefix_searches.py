"""Searches of Fiduccia and Mattheyses: chains of moves, of which the best beginning is kept.

A search starts from one cell. It moves the cell of the largest gain among those it has come across, each
once, whether that pays or not, and takes back what came after the least length. So it gets out of what no
single move improves.
"""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import ONE, helper, kernel
from agglo_core.kernels.ring_search import keeps_whole

__all__ = ["search_all"]

_TIE = 1e-9  # of the lengths of the first cell
_NONE = np.int64(-1)


@helper
def _sift_up(heap, keys, place, at):
    """Move the entry ``at`` up to where the one above it has a larger key."""
    cell, key = heap[at], keys[at]
    while at > 0:
        above = (at - 1) // 2
        if keys[above] >= key:
            break
        heap[at], keys[at] = heap[above], keys[above]
        place[heap[at]] = at
        at = above
    heap[at], keys[at], place[cell] = cell, key, at


@helper
def _sift_down(heap, keys, place, at, size):
    """Move the entry ``at`` down to where those below it have smaller keys."""
    cell, key = heap[at], keys[at]
    while 2 * at + 1 < size:
        below = 2 * at + 1
        if below + 1 < size and keys[below + 1] > keys[below]:
            below += 1
        if keys[below] <= key:
            break
        heap[at], keys[at] = heap[below], keys[below]
        place[heap[at]] = at
        at = below
    heap[at], keys[at], place[cell] = cell, key, at


@helper
def _put_in(heap, keys, place, size, cell, key):
    """Put a cell in the heap, or give it another key; returns the size."""
    at = np.int64(place[cell])
    if at < 0:
        at, size = size, size + 1
        heap[at], keys[at] = cell, key
    else:
        keys[at] = key
        _sift_down(heap, keys, place, at, size)
        at = np.int64(place[cell])
    _sift_up(heap, keys, place, at)
    return size


@helper
def _take_out(heap, keys, place, size):
    """Take the cell of the largest key out of the heap; returns it and the size."""
    cell, size = heap[0], size - 1
    place[cell] = -1
    if size > 0:
        heap[0], keys[0] = heap[size], keys[size]
        place[heap[0]] = 0
        _sift_down(heap, keys, place, np.int64(0), size)
    return np.int64(cell), size


@helper
def _best_move(graph, parts, sizes, bounds, share, i):
    """The part that cell i had best move to, sizes staying in their bounds, or −1, and what that gains."""
    indptr, indices, lengths, weights = graph
    block, least, most = bounds
    home, target, best, own = np.uint32(parts[i]), _NONE, -np.inf, 0.0
    first, last = np.uint64(indptr[i]), np.uint64(indptr[i + ONE])
    for h in range(first, last):
        share[parts[np.uint32(indices[h])]] += lengths[h]
    own, free = share[home], sizes[home] - weights[i] >= least[home]
    for h in range(first, last):
        p = np.uint32(parts[np.uint32(indices[h])])
        shared, share[p] = share[p], 0.0
        if p == home or shared < 0.0 or not free or block[p] != block[home]:
            continue
        if shared > best and shared > 0.0 and sizes[p] + weights[i] <= most[p]:
            target, best = np.int64(p), shared
    return target, best - own


@helper
def _move(weights, parts, sizes, cells, i, target):
    home = parts[i]
    sizes[home] -= weights[i]
    sizes[target] += weights[i]
    cells[home] -= 1
    cells[target] += 1
    parts[i] = target


@helper
def _search(graph, parts, sizes, cells, bounds, seed, patience, work, stamp):
    """One search; returns how many moves were kept, and the last stamp used."""
    indptr, indices, lengths, weights = graph
    heap, keys, place, moved, came_from, done, share, rings = work
    size = np.int64(0)
    target, gain = _best_move(graph, parts, sizes, bounds, share, seed)
    if target < 0:
        return np.int64(0), stamp
    tie = 0.0
    for h in range(np.uint64(indptr[seed]), np.uint64(indptr[seed + ONE])):
        tie += _TIE * lengths[h]
    size = _put_in(heap, keys, place, size, seed, gain)
    total, best, kept, count, search = 0.0, 0.0, np.int64(0), np.int64(0), stamp
    while size > 0 and count - kept < patience:
        cell, size = _take_out(heap, keys, place, size)
        i = np.uint64(cell)
        target, gain = _best_move(graph, parts, sizes, bounds, share, i)
        if target < 0 or cells[parts[i]] < 2:
            continue
        if size > 0 and gain < keys[0]:  # what was known of it has changed
            size = _put_in(heap, keys, place, size, cell, gain)
            continue
        stamp += 1
        if not keeps_whole(indptr, indices, parts, i, rings, stamp):
            continue
        done[count], came_from[count], moved[i] = cell, parts[i], search
        count += 1
        _move(weights, parts, sizes, cells, i, target)
        total += gain
        if total > best + tie:
            best, kept = total, count
        for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
            j = np.uint64(np.uint32(indices[h]))
            if moved[j] == search:
                continue
            to, more = _best_move(graph, parts, sizes, bounds, share, j)
            if to >= 0:
                size = _put_in(heap, keys, place, size, np.int64(j), more)
    for k in range(size):
        place[heap[k]] = -1
    for back in range(count - kept):
        i = done[count - 1 - back]
        _move(weights, parts, sizes, cells, i, came_from[count - 1 - back])
    return kept, stamp


@kernel
def search_all(indptr, indices, lengths, weights, labels, block, least, most, rounds, patience):
    """Labels ``(n,)`` after up to ``rounds`` of searches, each from all cells that may gain something.

    Parameters
    ----------
    lengths : (m,) float
        What an edge costs if it is cut.
    weights : (n,) float
        What the sizes of parts are made of.
    labels : (n,) int
        Parts, connected.
    block, least, most : (k,)
        Each part trades cells with others of its block alone, and its size stays within these bounds.
    patience : int
        Moves after the best beginning until a search ends.
    """
    n, k = len(labels), len(block)
    parts, sizes, cells = labels.astype(np.int32), np.zeros(k), np.zeros(k, np.int64)
    for i in range(n):
        sizes[parts[i]] += weights[i]
        cells[parts[i]] += 1
    graph, bounds = (indptr, indices, lengths, weights), (block, least, most)
    heap, keys, place = np.empty(n, np.int32), np.empty(n), np.full(n, -1, np.int32)
    moved, came_from = np.zeros(n, np.int64), np.empty(n, np.int32)
    done, share = np.empty(n, np.int32), np.zeros(k)
    rings = (np.empty(n + 1, np.int32), np.empty(n + 1, np.int32), np.zeros((n, 2), np.int64))
    work, due, stamp = (heap, keys, place, moved, came_from, done, share, rings), np.ones(n, np.bool_), 1
    for _ in range(rounds):
        improved = np.int64(0)
        for seed in range(n):
            if not due[seed]:
                continue
            due[seed] = False
            kept, stamp = _search(
                graph, parts, sizes, cells, bounds, np.uint64(seed), patience, work, stamp + 1
            )
            improved += kept
            for c in range(kept):
                near = np.uint64(np.uint32(done[c]))
                due[near] = True
                for h in range(np.uint64(indptr[near]), np.uint64(indptr[near + ONE])):
                    due[np.uint32(indices[h])] = True
        if improved == 0:
            break
    return parts.astype(np.int64)
