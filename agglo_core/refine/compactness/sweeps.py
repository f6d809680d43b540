"""K-way polish: boundary cells move to where they make parts compact and their interfaces short.

Parts are numbered in a geometric order, those of a block one after the other. A sweep is made slice by slice:
in a slice, parts of a block that follow one another trade cells among themselves. Slices know nothing of what
happens in the others meanwhile, so that several threads may work at them.

Nothing is allocated in a sweep, so that references need not be counted, which would cost more than the work.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel
from agglo_core.compiled.ring_search import CROWD, REACH, connected
from agglo_core.refine.compactness.reach import fits, take_in
from agglo_core.refine.compactness.state import CELLS, CENTRE, FLOOR, MASS, ROOM, listed_cells

_TIE = 1e-9  # of the terms of a change: smaller ones are rounding; ties go to the part of the least number

_CACHED = 40_000
"""Cells, up to which all that is read for them stays in the cache: reading ahead would cost time only."""

_AHEAD = np.int64(64)
"""Cells that are read ahead at a time: their waits for memory overlap."""


@helper
def _square(given, state, i, p):
    """Square of the distance of cell i from the centre of part p."""
    x = given.centroids[i, 0] - state.tally[p, CENTRE]
    y = given.centroids[i, 1] - state.tally[p, CENTRE + 1]
    z = given.centroids[i, 2] - state.tally[p, CENTRE + 2] if given.centroids.shape[1] > 2 else 0.0
    return x * x + y * y + z * z


@helper
def _beside(given, state, i, work):
    """List the other parts adjacent to cell i in ``queue``, and sum the interface with each in ``share``.

    Returns how many, and the interface with its own part. Whoever reads ``share`` clears it.

    No branch: it would be mispredicted half the time. A part may be listed again if it shares nothing.
    """
    home, own, found = np.uint32(state.parts[i]), 0.0, np.uint64(0)
    for h in range(np.uint64(given.indptr[i]), np.uint64(given.indptr[i + ONE])):
        p, length = np.uint32(state.parts[np.uint32(given.indices[h])]), given.interface[h]
        shared = work.share[p]
        work.queue[found] = p
        found += np.uint64((p != home) & (shared == 0.0))
        work.share[p] = shared + length
    own, work.share[home] = work.share[home], 0.0
    return found, own


@helper
def _best_move(given, state, bounds, price, i, work):
    """Find the part of the slice that cell i should move to, or −1, and the changes of inertia and interface.

    The ``price`` is the inertia that an interface of 1 is worth. ``bounds`` are the parts of the slice, from
    the first to the last plus 1, and those of its block. The last of the results tells whether the cell is
    adjacent to parts of its block beyond the slice.
    """
    found, own = _beside(given, state, i, work)
    target, best, inertia, cut, beyond = np.int64(-1), 0.0, 0.0, 0.0, False
    if found == 0:
        return target, inertia, cut, beyond
    # 1. A part of mass m and centre c loses w m / (m − w) |x − c|² of inertia with a cell of weight w at x
    #    (Steiner), nothing if the cell is all its mass.
    home, w = np.uint32(state.parts[i]), given.weights[i]
    mass, lost = state.tally[home, MASS], 0.0
    if mass - w > 1e-12 * mass:
        lost = _square(given, state, i, home) * (w * (mass / (mass - w)))  # else lengths of 1e-50 vanish
    # 2. A part of mass m that gets the cell gains w m / (m + w) |x − c|². Parts beyond the slice may change
    #    at the same time in another thread: they are only reported.
    lo, hi, start, stop = bounds
    for m in range(found):
        p = np.uint32(work.queue[m])
        shared, work.share[p] = work.share[p], 0.0
        if not lo <= p < hi:
            beyond |= start <= p < stop
            continue
        mass, won = state.tally[p, MASS], 0.0
        if mass > 0.0:
            won = _square(given, state, i, p) * (w * (mass / (mass + w)))
        # 3. Change of inertia plus price times interface. Of changes that differ by rounding only, the part
        #    of the least number has it, so that the order of neighbours does not matter.
        change = won - lost + price * (own - shared)
        tie = _TIE * (won + lost + price * (own + shared))
        first = target < 0
        if change < (0.0 if first else best) - tie or (not first and change <= best + tie and p < target):
            target, best, inertia, cut = np.int64(p), change, won - lost, own - shared
    return target, inertia, cut, beyond


@helper
def _leaves_whole(given, state, i, target, work, stamp):
    """Move cell i to ``target`` if its part stays connected near it, and return whether it moved.

    What other threads read of the cell meanwhile is one part of the slice or another.
    """
    home, filled = state.parts[i], np.uint64(0)
    for h in range(np.uint64(given.indptr[i]), np.uint64(given.indptr[i + ONE])):
        j = np.uint32(given.indices[h])
        work.queue[filled] = j  # no branch: it would be mispredicted half the time
        filled += np.uint64(state.parts[j] == home)
    # The cell is out of the way of the search as soon as it has the other label.
    state.parts[i] = target
    search = (work.queue, work.root, state.marks)
    if filled > ONE and not connected(
        given.indptr, given.indices, state.parts, home, search, filled, stamp, REACH, CROWD
    ):
        state.parts[i] = home
        return False
    return True


@helper
def _put(given, state, i, home, target):
    """Update the sums of both parts after cell i went from ``home`` to ``target``."""
    w, measure = given.weights[i], given.measures[i]
    left, joined = state.tally[home, MASS] - w, state.tally[target, MASS] + w
    less = w / left if left > 0.0 else 0.0
    more = w / joined if joined > 0.0 else 0.0
    # Centres move as running means do: c ± (x − c) w / m, with the new mass m.
    for a in range(given.centroids.shape[1]):
        x = given.centroids[i, a]
        state.tally[home, CENTRE + a] -= (x - state.tally[home, CENTRE + a]) * less
        state.tally[target, CENTRE + a] += (x - state.tally[target, CENTRE + a]) * more
    state.tally[home, MASS], state.tally[target, MASS] = left, joined
    state.tally[home, ROOM] -= measure
    state.tally[target, ROOM] += measure
    state.tally[home, CELLS] -= 1.0
    state.tally[target, CELLS] += 1.0


@helper
def _sort_listed(given, state, work, b, start, stop):
    """Put the cells listed from ``start`` to ``stop`` in the order of their places (Shell's sort)."""
    # 1. Keys: places along the axis of the block.
    for c in range(start, stop):
        i = np.uint32(state.listed[c])
        key = given.axes[b, 0] * given.centroids[i, 0] + given.axes[b, 1] * given.centroids[i, 1]
        if given.centroids.shape[1] > 2:
            key += given.axes[b, 2] * given.centroids[i, 2]
        work.keys[c - start] = key
    # 2. Sort by falling gaps. Few cells are sorted by insertion, at once with gap 1.
    gap = (stop - start) // 2 if stop - start > 16 else 1
    while gap > 0:
        for c in range(gap, stop - start):
            i, key, j = state.listed[start + c], work.keys[c], c
            while j >= gap and work.keys[j - gap] > key:
                work.keys[j] = work.keys[j - gap]
                state.listed[start + j] = state.listed[start + j - gap]
                j -= gap
            work.keys[j], state.listed[start + j] = key, i
        gap = gap // 2 if gap < 5 else (5 * gap - 1) // 11


@helper
def _may_leave(given, state, i, target, work, stamp, reach, limit, corners):
    """Move cell i to ``target`` if its part is not emptied, torn or too small, the other not too wide.

    Returns whether it moved. Only its label is changed.
    """
    home = np.uint32(state.parts[i])
    if state.tally[home, CELLS] < 2.0:
        return False
    if state.tally[home, ROOM] - given.measures[i] < state.tally[home, FLOOR]:
        return False
    if not fits(i, target, state.parts, reach, limit, corners):
        return False
    return _leaves_whole(given, state, i, target, work, stamp)


@helper
def _read_ahead(given, state, work, first, last):
    """Bring what is to be read for the cells listed from ``first`` to ``last`` into the cache, all at once.

    A part is far in memory from the one before it; its cells one by one would wait for each line.
    """
    read = np.int64(0)
    for c in range(first, last):
        i = np.uint64(np.uint32(state.listed[c]))
        begin, end = np.uint64(given.indptr[i]), np.uint64(given.indptr[i + ONE]) - ONE
        p = np.uint32(state.parts[np.uint32(given.indices[begin])])
        q = np.uint32(state.parts[np.uint32(given.indices[end])])
        read += np.int64(given.interface[begin] > given.interface[end])
        read += np.int64(state.tally[p, MASS] > state.tally[q, MASS])
        read += np.int64(given.centroids[i, 0] > given.weights[i]) + state.due[i]
    work.root[0] = read  # else nothing would be read


@kernel(allocates=False)
def sweep_slices(given, state, work, slices, start, stop, sweep, alpha, limit, reach, corners):
    """Look once at each cell that is due in the slices from ``start`` to ``stop``.

    Returns how many moved. Moves lower J · L^α, inertia times interface to the power ``alpha``, linearised
    about the ``blocks`` at the start of the sweep. The gains of a slice become what its moves added to
    inertia and interface. In a part, cells are taken by their places, so that their numbering does not
    matter.
    """
    n = np.int64(len(state.parts))
    stamp, moved, ahead = sweep * (n + 1), np.int64(0), np.int64(0)
    listed = state.first[slices.rows[stop - 1, 1]]
    for s in range(start, stop):
        lo, hi, b = slices.rows[s, 0], slices.rows[s, 1], slices.rows[s, 4]
        begin, end = slices.rows[s, 2], slices.rows[s, 3]
        if not state.going[b]:
            continue
        # 1. d(J · L^α) is proportional to dJ + price dL, with the price α J / L of the block.
        price = alpha * (state.blocks[b, 0] / state.blocks[b, 1])
        for r in range(lo, hi):
            # 2. The cells of a part that are due. Of many cells, what is read for the next ones of the list
            #    is fetched first, whatever their part.
            first, last = state.first[r], state.first[r + 1]
            if n > _CACHED and last + _AHEAD > ahead:
                ahead = max(ahead, last)
                _read_ahead(given, state, work, ahead, min(ahead + _AHEAD, listed))
                ahead += _AHEAD
            if first == last:
                continue
            _sort_listed(given, state, work, b, first, last)
            for c in range(first, last):
                i = np.uint64(np.uint32(state.listed[c]))
                home = np.uint32(state.parts[i])
                # 3. The best move. A cell adjacent to parts beyond the slice is looked at again in the next
                #    sweep, in whose slices they may be together; others wait until a neighbour moves.
                target, inertia, cut, beyond = _best_move(given, state, (lo, hi, begin, end), price, i, work)
                state.due[i] = sweep + 1 if beyond else -1
                if target < 0:
                    continue
                # 4. It is made if both parts stay admissible; sums, widths and gains follow.
                stamp += 1
                to = np.uint32(target)
                if not _may_leave(given, state, i, to, work, stamp, reach, limit, corners):
                    continue
                _put(given, state, i, home, to)
                take_in(i, home, to, reach, limit, corners)
                slices.gains[s, 0] += inertia
                slices.gains[s, 1] += cut
                moved += 1
                # 5. Neighbours in the block are due in the next sweep, unless this one has yet to come to
                #    them.
                for h in range(np.uint64(given.indptr[i]), np.uint64(given.indptr[i + ONE])):
                    j = np.uint32(given.indices[h])
                    p = state.parts[j]
                    if begin <= p < end and not (lo <= p < hi and state.due[j] == sweep):
                        state.due[j] = sweep + 1
    return moved


@kernel(allocates=False)
def sweep_all(given, state, work, even, odd, sweeps, alpha, limit, reach, corners):
    """Make at most ``sweeps`` sweeps, over the even and the odd slices by turns, in one thread."""
    by_turns = (even, odd)
    for sweep in range(sweeps):
        slices, before = by_turns[sweep % 2], by_turns[1 - sweep % 2]
        if listed_cells(state, work, sweep, before, alpha) == 0:
            break
        sweep_slices(given, state, work, slices, 0, len(slices.rows), sweep, alpha, limit, reach, corners)
