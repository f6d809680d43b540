"""Interface relaxation: move boundary cells to the part with the longer common boundary."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.compiled.ring_search import keeps_whole

# Number of neighbours above which interface lengths are summed for all parts at once, not part by part in
# quadratic time (benchmarks/pathologies.py, hub).
_MANY = 16
_SWEEPS = 10  # maximum per block; sweeps stop earlier if no move pays (benchmarks/gnn.py, table bisection)
_TIE = 1e-9  # relative to the cell's total interface: smaller savings are rounding


@helper
def _best_move(graph, parts, i, pairs, lengths):
    """Find the best move of cell i: target part, neighbour that moves along, and saved length.

    The target is −1 if nothing is saved, the neighbour −1 if the cell moves alone. With ``pairs``, a cell
    that saves nothing alone may move with a neighbour. ``lengths (k,)`` is a workspace. Below, L(i, p) is the
    interface length between cell i and part p.
    """
    indptr, indices, interface = graph
    home, home_length, total = parts[i], 0.0, 0.0
    target, length = -1, 0.0
    # 1. With many neighbours, compute L(i, p) for all adjacent parts p at once. Only entries that are read
    #    are cleared.
    use_table = indptr[i + 1] - indptr[i] > _MANY
    if use_table:
        for h in range(indptr[i], indptr[i + 1]):
            lengths[parts[indices[h]]] = 0.0
        for h in range(indptr[i], indptr[i + 1]):
            lengths[parts[indices[h]]] += interface[h]
    # 2. The target is the part p ≠ home with the largest L(i, p). With few neighbours the sum is recomputed
    #    for each part, without access to the array.
    for h in range(indptr[i], indptr[i + 1]):
        p = parts[indices[h]]
        total += interface[h]
        if p == home:
            home_length += interface[h]
        if p in (home, target):
            continue
        shared = lengths[p] if use_table else 0.0
        for g in range(indptr[i], indptr[i] if use_table else indptr[i + 1]):
            if parts[indices[g]] == p:
                shared += interface[g]
        if shared > length:
            target, length = p, shared
    # 3. Alone, the cell saves L(i, target) − L(i, home).
    least = _TIE * total
    if target >= 0 and length - home_length > least:
        return target, -1, length - home_length
    if target < 0 or not pairs:
        return -1, -1, 0.0
    # 4. A neighbour j in its part that moves along adds L(j, target) − L(j, home). Their common interface is
    #    in both L(·, home) but stays interior, so it is added back twice.
    partner, best = -1, least
    for h in range(indptr[i], indptr[i + 1]):
        j = indices[h]
        if parts[j] == home:
            pair_saving = length - home_length + 2.0 * interface[h]
            for g in range(indptr[j], indptr[j + 1]):  # no branch: it would be mispredicted
                p = parts[indices[g]]
                pair_saving += interface[g] * ((p == target) - np.int64(p == home))
            if pair_saving > best:
                partner, best = j, pair_saving
    if partner < 0:
        return -1, -1, 0.0
    return target, partner, best


@helper
def sort_by_key(items, keys, m):
    """Sort ``items[:m]`` by ascending ``keys[item]`` (heap sort)."""
    # 1. Build a max-heap: sift each item up from the end.
    for heap in range(1, m):
        child = heap
        while child > 0:
            parent = (child - 1) // 2
            if keys[items[parent]] >= keys[items[child]]:
                break
            items[parent], items[child] = items[child], items[parent]
            child = parent
    # 2. Move the largest item to the end, and sift the displaced item down from the root.
    for last in range(m - 1, 0, -1):
        items[0], items[last] = items[last], items[0]
        parent = 0
        while True:
            child = 2 * parent + 1
            if child >= last:
                break
            if child + 1 < last and keys[items[child + 1]] > keys[items[child]]:
                child += 1
            if keys[items[parent]] >= keys[items[child]]:
                break
            items[parent], items[child] = items[child], items[parent]
            parent = child


@helper
def _part_sums(start, stop, centroids, measures, tally, moments):
    """Sum measure, cell count and first moment by part, and return the highest label + 1."""
    parts, part_measures, part_cells = tally
    present = 0
    for i in range(start, stop):
        present = max(present, parts[i] + 1)
    # The arrays serve all blocks: clear only this block's labels.
    for p in range(present):  # loops compile faster than slices
        part_measures[p] = 0.0
        part_cells[p] = 0
        for k in range(centroids.shape[1]):
            moments[p, k] = 0.0
    for i in range(start, stop):
        p = parts[i]
        part_measures[p] += measures[i]
        part_cells[p] += 1
        for k in range(centroids.shape[1]):
            moments[p, k] += measures[i] * centroids[i, k]
    return present


@helper
def _axis_and_floors(present, floor, part_measures, moments, axis, floors):
    """Compute the sweep axis of a block, and the smallest allowed measures of its parts.

    The axis points from the block centroid to the centroid of the smallest part. ``floors`` are ``floor``
    times the measure of each part. With two parts both get ``floor`` times the smaller measure.
    """
    small, total = -1, 0.0
    for k in range(len(axis)):
        axis[k] = 0.0
    # 1. Smallest non-empty part, and the block's first moment.
    for p in range(present):
        if part_measures[p] > 0.0 and (small < 0 or part_measures[p] < part_measures[small]):
            small = p
        total += part_measures[p]
        for k in range(len(axis)):
            axis[k] += moments[p, k]
    # 2. Axis and floors.
    for k in range(len(axis)):
        axis[k] = moments[small, k] / part_measures[small] - axis[k] / total if small >= 0 else 0.0
    for p in range(present):
        floors[p] = floor * (part_measures[small] if present == 2 and small >= 0 else part_measures[p])


@helper
def _put(measures, tally, i, target):
    """Move cell i to part ``target``."""
    parts, part_measures, part_cells = tally
    part_measures[parts[i]] -= measures[i]
    part_cells[parts[i]] -= 1
    parts[i] = target
    part_measures[target] += measures[i]
    part_cells[target] += 1


@helper
def _leave(graph, measures, tally, floors, i, target, search, stamp):
    """Move cell i to ``target`` unless its part would become disconnected, empty or too small."""
    parts, part_measures, part_cells = tally
    indptr, indices, _ = graph
    home = parts[i]
    if part_measures[home] - measures[i] < floors[home] or part_cells[home] < 2:
        return False
    if not keeps_whole(indptr, indices, parts, i, search, stamp):
        return False
    _put(measures, tally, i, target)
    return True


@helper
def _collect_movers(graph, parts, cells, m, pairs, lengths, axis, centroids, keys, movers):
    """List the cells whose move shortens the interface, sorted along ``axis``, and return their number."""
    n_movers = 0
    for c in range(m):
        i = cells[c]
        if _best_move(graph, parts, i, pairs, lengths)[0] >= 0:
            movers[n_movers] = i
            n_movers += 1
            keys[i] = 0.0
            for k in range(len(axis)):
                keys[i] += axis[k] * centroids[i, k]
    sort_by_key(movers, keys, n_movers)
    return n_movers


@helper
def _add_new(graph, i, cells, m, marks, stamp):
    """Append the neighbours of cell i without the mark ``stamp`` to ``cells[:m]``, and return its length."""
    indptr, indices, _ = graph
    for h in range(indptr[i], indptr[i + 1]):
        j = indices[h]
        if marks[j] != stamp:
            marks[j] = stamp
            cells[m] = j
            m += 1
    return m


@helper(allocates=True)
def _relax_labels(offsets, indptr, indices, interface, centroids, measures, labels, floor):
    """Compute the labels that :func:`relax_interface` returns.

    ``visits`` lists the candidates for the next sweep, ``movers`` the candidates that pay. ``boundary`` lists
    all cells that are or were adjacent to another part. ``visit_marks`` and ``listed`` mark the cells in
    ``visits`` and in ``boundary``.
    """
    n, d = len(measures), centroids.shape[1]
    parts = labels.copy()
    n_parts = 0
    for i in range(n):  # parts.max() takes half a second to compile
        n_parts = max(n_parts, parts[i] + 1)
    graph = (indptr, indices, interface)
    tally = (parts, np.empty(n_parts), np.empty(n_parts, np.int64))
    search = (np.empty(n, np.int32), np.empty(n, np.int32), np.zeros((n, 2), np.int32))
    floors, moments, axis = np.empty(n_parts), np.empty((n_parts, d)), np.empty(d)
    lengths = np.empty(n_parts)
    keys, movers, visits, boundary = (
        np.empty(n),
        np.empty(n, np.int64),
        np.empty(n, np.int64),
        np.empty(n, np.int64),
    )
    # Zero pages are allocated on first use.
    listed, visit_marks = np.zeros(n, np.int32), np.zeros(n, np.int32)
    stamp, sweep = 0, 0
    for b in range(len(offsets) - 1):
        start, stop = offsets[b], offsets[b + 1]
        # 1. Part sums, sweep axis, and smallest allowed measures.
        present = _part_sums(start, stop, centroids, measures, tally, moments)
        _axis_and_floors(present, floor, tally[1], moments, axis, floors)
        # 2. All cells adjacent to another part are candidates for the first sweep.
        edge = 0  # number of cells that are or were adjacent to another part
        for i in range(start, stop):
            home, is_adjacent = parts[i], False
            for h in range(indptr[i], indptr[i + 1]):
                is_adjacent |= parts[indices[h]] != home  # no branch: it would be mispredicted
            if is_adjacent:
                boundary[edge] = visits[edge] = i
                listed[i] = b + 1
                edge += 1
        # 3. Sweep until no cell with a changed neighbourhood is left.
        candidates, pairs, pairs_tried = edge, False, False
        for _ in range(_SWEEPS):
            m = _collect_movers(
                graph, parts, visits, candidates, pairs, lengths, axis, centroids, keys, movers
            )
            sweep += 1
            candidates = 0
            for c in range(m):
                # 4. Earlier moves in the sweep may have changed this cell's savings, so search its best move
                #    again. Move unless the part would become disconnected, empty or too small.
                i, home = movers[c], parts[movers[c]]
                target, partner, _gained = _best_move(graph, parts, i, pairs, lengths)
                stamp += 2
                if target < 0 or not _leave(graph, measures, tally, floors, i, target, search, stamp):
                    continue
                if partner >= 0:
                    # 5. A pair moves completely or not at all: the first cell is put back if the second must
                    #    stay.
                    if not _leave(graph, measures, tally, floors, partner, target, search, stamp + 1):
                        _put(measures, tally, i, home)
                        continue
                    candidates = _add_new(graph, partner, visits, candidates, visit_marks, sweep)
                    edge = _add_new(graph, partner, boundary, edge, listed, b + 1)
                # 6. Moves of the neighbours may pay now.
                candidates = _add_new(graph, i, visits, candidates, visit_marks, sweep)
                edge = _add_new(graph, i, boundary, edge, listed, b + 1)
            # 7. When no single cell pays any more, pairs are tried once along the whole boundary, followed by
            #    single cells again.
            if pairs:
                pairs = False
            elif candidates == 0 and not pairs_tried:
                pairs, pairs_tried, candidates = True, True, edge
                for c in range(edge):
                    visits[c] = boundary[c]
            if candidates == 0:
                break
    return parts


@kernel
def relax_interface(offsets, indptr, indices, interface, centroids, measures, labels, floor):
    """Shorten the interface L by sweeps of moves, and return labels ``(n,)`` (paper: adjust partition).

    Block b contains the cells from ``offsets[b]`` to ``offsets[b + 1]``, without edges to other blocks. No
    part is disconnected or emptied, and no part falls below ``floor`` times its measure at entry (for two
    parts: times the smaller measure). Sweeps run along the line from the block centroid to the centroid of
    its smallest part: single cells until none pays, pairs once, and single cells again.
    """
    return _relax_labels(offsets, indptr, indices, interface, centroids, measures, labels, floor)
