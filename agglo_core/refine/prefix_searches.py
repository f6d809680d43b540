"""Searches of Fiduccia and Mattheyses: chains of moves, of which the best beginning is kept.

A search starts from one cell. It moves the cell of the largest gain among those it has come across, each
once, whether that pays or not, and takes back what came after the least length. So it gets out of what no
single move improves.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel
from agglo_core.compiled.ring_search import keeps_whole
from agglo_core.compiled.sorting import put_in, take_out

_TIE = 1e-9  # of the lengths of the first cell
_NONE = np.int64(-1)


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
    size = put_in(heap, keys, place, size, seed, gain)
    total, best, kept, count, search = 0.0, 0.0, np.int64(0), np.int64(0), stamp
    while size > 0 and count - kept < patience:
        cell, size = take_out(heap, keys, place, size)
        i = np.uint64(cell)
        target, gain = _best_move(graph, parts, sizes, bounds, share, i)
        if target < 0 or cells[parts[i]] < 2:
            continue
        if size > 0 and gain < keys[0]:  # what was known of it has changed
            size = put_in(heap, keys, place, size, cell, gain)
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
                size = put_in(heap, keys, place, size, np.int64(j), more)
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
