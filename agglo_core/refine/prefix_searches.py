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

_TIE = 1e-9  # of the lengths of the first cell: a better beginning must gain more than rounding
_NONE = np.int64(-1)


@helper
def _best_move(graph, parts, sizes, bounds, share, i):
    """Find the target part of cell i that gains most with sizes in their bounds, or −1.

    Returns the gain, too: it is the length of the interface with the target less that with its own part; it
    may be negative. ``share (k,)`` is a work array of zeros.
    """
    indptr, indices, lengths, weights = graph
    block, least, most = bounds
    home, target, best, own = np.uint32(parts[i]), _NONE, -np.inf, 0.0
    first, last = np.uint64(indptr[i]), np.uint64(indptr[i + ONE])
    # 1. Length that the cell shares with each part around it.
    for h in range(first, last):
        share[parts[np.uint32(indices[h])]] += lengths[h]
    own, free = share[home], sizes[home] - weights[i] >= least[home]
    # 2. The largest such length, of parts of the block with room for the cell. Each part is seen once: its
    #    entry is cleared for the next use.
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
    """Search from one cell, keeping the best beginning of its moves.

    Returns how many moves were kept, and the last stamp used. The cells moved are in ``done``, in turn. The
    search ends ``patience`` moves after the best beginning.
    """
    indptr, indices, lengths, weights = graph
    heap, keys, place, moved, came_from, done, share, rings = work
    size = np.int64(0)
    target, gain = _best_move(graph, parts, sizes, bounds, share, seed)
    if target < 0:
        return np.int64(0), stamp
    tie = 0.0
    for h in range(np.uint64(indptr[seed]), np.uint64(indptr[seed + ONE])):
        tie += _TIE * lengths[h]
    # 1. The heap of cells that may move, the largest gain on top; moves of the seed come first.
    size = put_in(heap, keys, place, size, seed, gain)
    total, best, kept, count, search = 0.0, 0.0, np.int64(0), np.int64(0), stamp
    while size > 0 and count - kept < patience:
        cell, size = take_out(heap, keys, place, size)
        i = np.uint64(cell)
        # 2. The cell on top, with its gain as it is now. If that has sunk below the next one, the cell
        #    waits.
        target, gain = _best_move(graph, parts, sizes, bounds, share, i)
        if target < 0 or cells[parts[i]] < 2:
            continue
        if size > 0 and gain < keys[0]:
            size = put_in(heap, keys, place, size, cell, gain)
            continue
        # 3. A cell that holds its part together stays where it is.
        stamp += 1
        if not keeps_whole(indptr, indices, parts, i, rings, stamp):
            continue
        # 4. Move it, whether that pays or not, and note after how many moves most was gained in sum.
        done[count], came_from[count], moved[i] = cell, parts[i], search
        count += 1
        _move(weights, parts, sizes, cells, i, target)
        total += gain
        if total > best + tie:
            best, kept = total, count
        # 5. The gains of its neighbours have changed; those moved before in this search stay.
        for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
            j = np.uint64(np.uint32(indices[h]))
            if moved[j] == search:
                continue
            to, more = _best_move(graph, parts, sizes, bounds, share, j)
            if to >= 0:
                size = put_in(heap, keys, place, size, np.int64(j), more)
    # 6. Empty the heap, and take back the moves after the best beginning, the last one first.
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
        Cost of each edge if it is cut.
    weights : (n,) float
        Summands of the sizes of parts.
    labels : (n,) int
        Parts, connected.
    block, least, most : (k,)
        Each part trades cells with others of its block alone, and its size stays within these bounds.
    patience : int
        Moves after the best beginning until a search ends.
    """
    n, k = len(labels), len(block)
    parts, sizes, cells = labels.astype(np.int32), np.zeros(k), np.zeros(k, np.int64)
    # 1. Sizes and numbers of cells of the parts.
    for i in range(n):
        sizes[parts[i]] += weights[i]
        cells[parts[i]] += 1
    graph, bounds = (indptr, indices, lengths, weights), (block, least, most)
    # 2. Work arrays of all searches; all cells are due at first.
    heap, keys, place = np.empty(n, np.int32), np.empty(n), np.full(n, -1, np.int32)
    moved, came_from = np.zeros(n, np.int64), np.empty(n, np.int32)
    done, share = np.empty(n, np.int32), np.zeros(k)
    rings = (np.empty(n + 1, np.int32), np.empty(n + 1, np.int32), np.zeros((n, 2), np.int64))
    work, due, stamp = (heap, keys, place, moved, came_from, done, share, rings), np.ones(n, np.bool_), 1
    # 3. A search from each cell that is due, until a round improves nothing.
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
            # 4. Around cells that moved the gains have changed: these and their neighbours are due again.
            for c in range(kept):
                near = np.uint64(np.uint32(done[c]))
                due[near] = True
                for h in range(np.uint64(indptr[near]), np.uint64(indptr[near + ONE])):
                    due[np.uint32(indices[h])] = True
        if improved == 0:
            break
    return parts.astype(np.int64)
