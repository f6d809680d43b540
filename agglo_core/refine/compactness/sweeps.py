"""K-way polish: move boundary cells so that parts become compact and their interfaces short.

Parts are numbered in a geometric order, block by block. A sweep proceeds slice by slice. In a slice,
consecutive parts of a block trade cells among themselves. Slices are independent, so several threads may
process them.

Sweeps allocate no memory, because reference counting would cost more than the work.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel
from agglo_core.compiled.prefetching import prefetch
from agglo_core.compiled.ring_search import CROWD, REACH, are_connected
from agglo_core.refine.compactness.reach import fits, take_in
from agglo_core.refine.compactness.state import (
    CEILING,
    CELLS,
    CENTRE,
    FLOOR,
    MASS,
    ROOM,
    SWEEPS,
    list_due_cells,
    mark_boundary_cells,
)

_TIE = 1e-9  # relative to the terms of a change, for rounding; ties go to the lower part number

_STEPS = (24, 16, 8, 4)
"""Number of visits from each step of the prefetching to the visit (benchmarks/partition.py).

With more visits, the data may leave the cache before they are used, with fewer, they may arrive too late.
"""


_SHORT = 32
"""Number of cells up to which counting is the fastest way to sort (benchmarks/partition.py)."""


@helper
def _square(cells, state, i, p):
    """Return the squared distance from cell i to the centre of part p."""
    x = cells.centroids[i, 0] - state.tally[p, CENTRE]
    y = cells.centroids[i, 1] - state.tally[p, CENTRE + 1]
    z = cells.centroids[i, 2] - state.tally[p, CENTRE + 2] if cells.centroids.shape[1] > 2 else 0.0
    return x * x + y * y + z * z


@helper
def _beside(cells, state, i, work):
    """List the other parts adjacent to cell i in ``queue``, and sum the interface with each in ``share``.

    Returns the part count, and the interface with the cell's own part. Readers of ``share`` must clear
    it.

    The loop has no branch, because it would be mispredicted half the time. A part with interface 0 may be
    listed repeatedly.
    """
    home, home_length, n_parts = np.uint32(state.parts[i]), 0.0, np.uint64(0)
    for h in range(np.uint64(cells.indptr[i]), np.uint64(cells.indptr[i + ONE])):
        p, length = np.uint32(state.parts[np.uint32(cells.indices[h])]), cells.interface[h]
        shared = work.share[p]
        work.queue[n_parts] = p
        n_parts += np.uint64((p != home) & (shared == 0.0))
        work.share[p] = shared + length
    home_length, work.share[home] = work.share[home], 0.0
    return n_parts, home_length


@helper
def _best_move(cells, state, bounds, price, i, work):
    """Find the part in the slice to which cell i moves with most gain, or −1 if none.

    Returns the part, the changes in inertia and interface, and True if the cell is adjacent to parts of its
    block beyond the slice. The ``price`` is the inertia equivalent of interface 1. ``bounds`` are the first
    part and the last part plus 1 in the slice, and in its block.
    """
    n_parts, home_length = _beside(cells, state, i, work)
    target, best, inertia, cut, beyond = np.int64(-1), 0.0, 0.0, 0.0, False
    if n_parts == 0:
        return target, inertia, cut, beyond
    # 1. A part with mass m and centre c loses the inertia w m / (m − w) |x − c|² with a cell of weight w at x
    #    (Steiner), or nothing if the cell is its whole mass.
    home, w = np.uint32(state.parts[i]), cells.weights[i]
    mass, loss = state.tally[home, MASS], 0.0
    if mass - w > 1e-12 * mass:
        # This order of factors avoids underflow for lengths of 1e-50.
        loss = _square(cells, state, i, home) * (w * (mass / (mass - w)))
    # 2. A part with mass m that receives the cell gains w m / (m + w) |x − c|². Parts beyond the slice may
    #    change in another thread, so they are only reported.
    lo, hi, start, stop = bounds
    for m in range(n_parts):
        p = np.uint32(work.queue[m])
        shared, work.share[p] = work.share[p], 0.0
        if not lo <= p < hi:
            beyond |= start <= p < stop
            continue
        mass, gain = state.tally[p, MASS], 0.0
        if mass > 0.0:
            gain = _square(cells, state, i, p) * (w * (mass / (mass + w)))
        # 3. Change in inertia plus price times interface. If changes differ by rounding only, the lower part
        #    number wins, so the order of neighbours does not matter.
        change = gain - loss + price * (home_length - shared)
        tie = _TIE * (gain + loss + price * (home_length + shared))
        first = target < 0
        if change < (0.0 if first else best) - tie or (not first and change <= best + tie and p < target):
            target, best, inertia, cut = np.int64(p), change, gain - loss, home_length - shared
    return target, inertia, cut, beyond


@helper
def _leaves_whole(cells, state, i, target, work, stamp):
    """Move cell i to ``target`` if its part stays locally connected, and return True if it moved.

    Other threads may read the cell's label meanwhile, and see one part of the slice or another.
    """
    home, filled = state.parts[i], np.uint64(0)
    for h in range(np.uint64(cells.indptr[i]), np.uint64(cells.indptr[i + ONE])):
        j = np.uint32(cells.indices[h])
        work.queue[filled] = j  # no branch: it would be mispredicted half the time
        filled += np.uint64(state.parts[j] == home)
    # The new label hides the cell from the search.
    state.parts[i] = target
    search = (work.queue, work.root, state.marks)
    if filled > ONE and not are_connected(
        cells.indptr, cells.indices, state.parts, home, search, filled, stamp, REACH, CROWD
    ):
        state.parts[i] = home
        return False
    return True


@helper
def _put(cells, state, i, home, target):
    """Update both parts' sums after a move of cell i from ``home`` to ``target``."""
    w, measure = cells.weights[i], cells.measures[i]
    home_mass, target_mass = state.tally[home, MASS] - w, state.tally[target, MASS] + w
    home_step = w / home_mass if home_mass > 0.0 else 0.0
    target_step = w / target_mass if target_mass > 0.0 else 0.0
    # Centres change like running means: c ± (x − c) w / m, with the new mass m.
    for a in range(cells.centroids.shape[1]):
        x = cells.centroids[i, a]
        state.tally[home, CENTRE + a] -= (x - state.tally[home, CENTRE + a]) * home_step
        state.tally[target, CENTRE + a] += (x - state.tally[target, CENTRE + a]) * target_step
    state.tally[home, MASS], state.tally[target, MASS] = home_mass, target_mass
    state.tally[home, ROOM] -= measure
    state.tally[target, ROOM] += measure
    state.tally[home, CELLS] -= 1.0
    state.tally[target, CELLS] += 1.0


@helper
def _sort_listed(cells, state, work, b, start, stop):
    """Sort the cells listed from ``start`` to ``stop`` by position along the block axis."""
    # 1. Keys: positions along the block axis.
    for c in range(start, stop):
        i = np.uint32(state.listed[c])
        key = cells.axes[b, 0] * cells.centroids[i, 0] + cells.axes[b, 1] * cells.centroids[i, 1]
        if cells.centroids.shape[1] > 2:
            key += cells.axes[b, 2] * cells.centroids[i, 2]
        work.keys[c - start] = key
    # 2. Few cells, the usual case: count the cells before each one. Nothing depends on mispredicted branches.
    #    If all keys differ, the sum of the counts is that of the numbers below the number of cells.
    size, total = stop - start, np.int64(0)
    if size <= _SHORT:
        for c in range(size):
            key, rank = work.keys[c], np.int64(0)
            for k in range(size):
                rank += np.int64(work.keys[k] < key)
            work.queue[rank] = state.listed[start + c]
            total += rank
        if 2 * total == size * (size - 1):
            for c in range(size):
                state.listed[start + c] = work.queue[c]
            return
    # 3. Otherwise sort with decreasing gaps (Shell sort).
    gap = (size) // 2
    while gap > 0:
        for c in range(gap, size):
            i, key, j = state.listed[start + c], work.keys[c], c
            while j >= gap and work.keys[j - gap] > key:
                work.keys[j] = work.keys[j - gap]
                state.listed[start + j] = state.listed[start + j - gap]
                j -= gap
            work.keys[j], state.listed[start + j] = key, i
        gap = gap // 2 if gap < 5 else (5 * gap - 1) // 11


@helper
def _may_leave(cells, state, i, target, work, stamp, reach, limit, corners):
    """Move cell i to ``target`` if both parts stay admissible, and return True if it moved.

    The old part must not become empty, disconnected or too small, and the new part not too wide. Only the
    cell's label changes.
    """
    home = np.uint32(state.parts[i])
    # 1. Tests of the old part: cell count and measure.
    if state.tally[home, CELLS] < 2.0:
        return False
    if state.tally[home, ROOM] - cells.measures[i] < state.tally[home, FLOOR]:
        return False
    if state.tally[target, ROOM] + cells.measures[i] > state.tally[target, CEILING]:
        return False
    # 2. Width of the new part, then connectivity of the old part.
    if limit < np.inf and not fits(i, target, state.parts, reach, limit, corners):
        return False
    return _leaves_whole(cells, state, i, target, work, stamp)


@helper
def _read_ahead(cells, state, work, c, last):
    """Prefetch data of the cells to be visited after the one at place c, up to the place ``last``.

    Each step reads what the step before has fetched, some visits later. So memory latencies overlap.
    """
    # 1. Cell data.
    i = np.uint64(np.uint32(state.listed[min(c + _STEPS[0], last)]))
    prefetch(cells.indptr, i)
    prefetch(cells.centroids, i)
    prefetch(cells.weights, i)
    prefetch(cells.measures, i)
    prefetch(state.parts, i)
    # 2. Neighbours.
    i = np.uint64(np.uint32(state.listed[min(c + _STEPS[1], last)]))
    begin, end = np.uint64(cells.indptr[i]), np.uint64(cells.indptr[i + ONE]) - ONE
    prefetch(cells.indices, begin)
    prefetch(cells.indices, end)
    prefetch(cells.interface, begin)
    prefetch(cells.interface, end)
    # 3. Parts of the first and the last neighbour: most others are in the same cache lines.
    i = np.uint64(np.uint32(state.listed[min(c + _STEPS[2], last)]))
    begin, end = np.uint64(cells.indptr[i]), np.uint64(cells.indptr[i + ONE]) - ONE
    prefetch(state.parts, np.uint32(cells.indices[begin]))
    prefetch(state.parts, np.uint32(cells.indices[end]))
    # 4. Sums of these parts.
    i = np.uint64(np.uint32(state.listed[min(c + _STEPS[3], last)]))
    begin, end = np.uint64(cells.indptr[i]), np.uint64(cells.indptr[i + ONE]) - ONE
    p, q = state.parts[np.uint32(cells.indices[begin])], state.parts[np.uint32(cells.indices[end])]
    prefetch(state.tally, np.uint32(p))
    prefetch(state.tally, np.uint32(q))
    prefetch(work.share, np.uint32(p))
    prefetch(work.share, np.uint32(q))


@helper
def _visit_slices(cells, state, work, slices, start, stop, sweep, alpha, limit, reach, corners):
    """Visit the cells listed in the slices from ``start`` to ``stop`` once, and return the move count.

    Moves lower J · L^α, inertia times interface to the power ``alpha``, linearised about the ``blocks`` at
    the start of the sweep. The changes in inertia and interface are added to the slice gains. Within a part,
    cells are visited by position, so their numbering does not matter.
    """
    stamp, moved = (sweep % SWEEPS) * (np.int64(len(state.parts)) + 1), np.int64(0)
    listed = state.first[slices.rows[stop - 1, 1]]
    for s in range(start, stop):
        lo, hi, b = slices.rows[s, 0], slices.rows[s, 1], slices.rows[s, 4]
        begin, end = slices.rows[s, 2], slices.rows[s, 3]
        if not state.going[b]:
            continue
        # 1. d(J · L^α) is proportional to dJ + price dL, with the block's price α J / L.
        price = alpha * (state.blocks[b, 0] / state.blocks[b, 1])
        for r in range(lo, hi):
            # 2. Due cells of a part.
            first, last = state.first[r], state.first[r + 1]
            if first == last:
                continue
            _sort_listed(cells, state, work, b, first, last)
            for c in range(first, last):
                _read_ahead(cells, state, work, c, listed - 1)
                i = np.uint64(np.uint32(state.listed[c]))
                home = np.uint32(state.parts[i])
                # 3. Find the best move. A cell adjacent to parts beyond the slice is due again in the next
                #    sweep, whose slices may contain both. Other cells wait until a neighbour moves.
                target, inertia, cut, beyond = _best_move(cells, state, (lo, hi, begin, end), price, i, work)
                state.due[i] = sweep + 1 if beyond else -1
                if target < 0:
                    continue
                # 4. Make the move if both parts stay admissible, and update sums, widths and gains.
                stamp += 1
                to = np.uint32(target)
                if not _may_leave(cells, state, i, to, work, stamp, reach, limit, corners):
                    continue
                _put(cells, state, i, home, to)
                if limit < np.inf:
                    take_in(i, home, to, reach, limit, corners)
                slices.gains[s, 0] += inertia
                slices.gains[s, 1] += cut
                moved += 1
                # 5. Neighbours in the block are due in the next sweep. A visit later in this sweep replaces
                #    the mark.
                for h in range(np.uint64(cells.indptr[i]), np.uint64(cells.indptr[i + ONE])):
                    j = np.uint32(cells.indices[h])
                    if begin <= state.parts[j] < end:
                        state.due[j] = sweep + 1
    return moved


@kernel(allocates=False)
def sweep_slices(cells, state, work, slices, start, stop, sweep, alpha, limit, reach, corners):
    """Run a sweep over the slices from ``start`` to ``stop``, for one of several threads."""
    return _visit_slices(cells, state, work, slices, start, stop, sweep, alpha, limit, reach, corners)


@kernel(allocates=False)
def sweep_all(cells, state, work, even, odd, exponents, limit, reach, corners):
    """Run all rounds in one thread, alternately over two sets of slices."""
    by_turns = (even, odd)
    for r in range(len(exponents)):
        alpha, begin = exponents[r], r * SWEEPS
        for sweep in range(begin, begin + SWEEPS):
            slices, before = by_turns[sweep % 2], by_turns[1 - sweep % 2]
            if sweep == begin > 0:  # in the first round they are marked already
                mark_boundary_cells(cells, state, sweep, 0, len(state.parts))
            if list_due_cells(cells, state, work, sweep, sweep == begin, before, alpha) == 0:
                break
            _visit_slices(
                cells, state, work, slices, 0, len(slices.rows), sweep, alpha, limit, reach, corners
            )
