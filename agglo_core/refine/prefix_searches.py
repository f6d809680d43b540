"""Fiduccia–Mattheyses searches: make chains of moves, and keep the best prefix of each.

A search starts from one cell. It repeatedly moves the cell with the largest gain among the cells reached so
far, each cell once, even if the move does not pay. Moves after the shortest interface are undone. Searches
can therefore leave local minima of single moves.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel
from agglo_core.compiled.ring_search import keeps_whole
from agglo_core.compiled.sorting import put_in, take_out

_TIE = 1e-9  # relative to the seed's interface: a better prefix must gain more than rounding
_NONE = np.int64(-1)  # instead of a part: no admissible move


@helper
def _best_move(graph, parts, sizes, bounds, share, i):
    """Find the part to which moving cell i gains most within the size bounds, or −1 if there is none.

    Also returns the gain: the interface with the target minus the interface with the own part, possibly
    negative. ``share (k,)`` is a workspace of zeros.
    """
    indptr, indices, lengths, weights = graph
    block, least, most = bounds
    home, target, best, home_length = np.uint32(parts[i]), _NONE, -np.inf, 0.0
    first, last = np.uint64(indptr[i]), np.uint64(indptr[i + ONE])
    # 1. Sum the interface with each adjacent part.
    for h in range(first, last):
        share[parts[np.uint32(indices[h])]] += lengths[h]
    home_length, free = share[home], sizes[home] - weights[i] >= least[home]
    # 2. Find the longest interface among admissible parts of the block. Entries are cleared for the next use,
    #    so each part is visited once.
    for h in range(first, last):
        p = np.uint32(parts[np.uint32(indices[h])])
        shared, share[p] = share[p], 0.0
        if p == home or shared < 0.0 or not free or block[p] != block[home]:
            continue
        if shared > best and shared > 0.0 and sizes[p] + weights[i] <= most[p]:
            target, best = np.int64(p), shared
    return target, best - home_length


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
    """Make a chain of moves that starts at one cell, and keep its best prefix.

    Returns the number of kept moves and the last stamp used. ``chain`` lists the moved cells in order. The
    search ends ``patience`` moves after the best prefix.
    """
    indptr, indices, lengths, weights = graph
    heap, keys, place, moved, came_from, chain, share, rings = work
    size = np.int64(0)
    target, gain = _best_move(graph, parts, sizes, bounds, share, seed)
    if target < 0:
        return np.int64(0), stamp
    tie = 0.0
    for h in range(np.uint64(indptr[seed]), np.uint64(indptr[seed + ONE])):
        tie += _TIE * lengths[h]
    # 1. Heap of the movable cells, largest gain on top. The seed moves first.
    size = put_in(heap, keys, place, size, seed, gain)
    total, best, n_kept, count, search = 0.0, 0.0, np.int64(0), np.int64(0), stamp
    while size > 0 and count - n_kept < patience:
        cell, size = take_out(heap, keys, place, size)
        i = np.uint64(cell)
        # 2. Pop the top cell and update its gain. If the gain is now below the next key, reinsert the cell.
        target, gain = _best_move(graph, parts, sizes, bounds, share, i)
        if target < 0 or cells[parts[i]] < 2:
            continue
        if size > 0 and gain < keys[0]:
            size = put_in(heap, keys, place, size, cell, gain)
            continue
        # 3. Skip a cell whose removal would disconnect its part.
        stamp += 1
        if not keeps_whole(indptr, indices, parts, i, rings, stamp):
            continue
        # 4. Move the cell, even at a loss, and record the number of moves with the largest total gain.
        chain[count], came_from[count], moved[i] = cell, parts[i], search
        count += 1
        _move(weights, parts, sizes, cells, i, target)
        total += gain
        if total > best + tie:
            best, n_kept = total, count
        # 5. Update the gains of its neighbours, except cells already moved in this search.
        for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
            j = np.uint64(np.uint32(indices[h]))
            if moved[j] == search:
                continue
            to, more = _best_move(graph, parts, sizes, bounds, share, j)
            if to >= 0:
                size = put_in(heap, keys, place, size, np.int64(j), more)
    # 6. Empty the heap, and undo the moves after the best prefix in reverse order.
    for k in range(size):
        place[heap[k]] = -1
    for back in range(count - n_kept):
        i = chain[count - 1 - back]
        _move(weights, parts, sizes, cells, i, came_from[count - 1 - back])
    return n_kept, stamp


@kernel
def search_all(indptr, indices, lengths, weights, labels, block, least, most, rounds, patience):
    """Start chains of moves at all cells with a possible gain, in up to ``rounds`` rounds.

    Returns the labels ``(n,)``.

    Parameters
    ----------
    lengths : (m,) float
        Cost per edge when cut.
    weights : (n,) float
        Cell contributions to the part sizes.
    labels : (n,) int
        Connected parts.
    block, least, most : (k,)
        Each part only trades cells within its block, and its size stays within these bounds.
    patience : int
        Number of moves after the best prefix that ends a search.
    """
    n, k = len(labels), len(block)
    parts, sizes, cells = labels.astype(np.int32), np.zeros(k), np.zeros(k, np.int64)
    # 1. Part sizes and cell counts.
    for i in range(n):
        sizes[parts[i]] += weights[i]
        cells[parts[i]] += 1
    graph, bounds = (indptr, indices, lengths, weights), (block, least, most)
    # 2. Workspace for all searches. Initially all cells are due.
    heap, keys, place = np.empty(n, np.int32), np.empty(n), np.full(n, -1, np.int32)
    moved, came_from = np.zeros(n, np.int64), np.empty(n, np.int32)
    chain, share = np.empty(n, np.int32), np.zeros(k)
    rings = (np.empty(n + 1, np.int32), np.empty(n + 1, np.int32), np.zeros((n, 2), np.int64))
    work, due, stamp = (heap, keys, place, moved, came_from, chain, share, rings), np.ones(n, np.bool_), 1
    # 3. Search from each due cell, until a round improves nothing.
    for _ in range(rounds):
        improved = np.int64(0)
        for seed in range(n):
            if not due[seed]:
                continue
            due[seed] = False
            n_kept, stamp = _search(
                graph, parts, sizes, cells, bounds, np.uint64(seed), patience, work, stamp + 1
            )
            improved += n_kept
            # 4. Moves change the gains nearby: moved cells and their neighbours are due again.
            for c in range(n_kept):
                near = np.uint64(np.uint32(chain[c]))
                due[near] = True
                for h in range(np.uint64(indptr[near]), np.uint64(indptr[near + ONE])):
                    due[np.uint32(indices[h])] = True
        if improved == 0:
            break
    return parts.astype(np.int64)
