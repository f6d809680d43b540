"""K-way polish: boundary cells move to where they make parts compact and their interfaces short.

Parts are numbered in a geometric order, those of a block one after the other. A sweep is made slice by slice:
in a slice, parts of a block that follow one another trade cells among themselves. Slices know nothing of what
happens in the others meanwhile, so that several threads may work at them.

Nothing is allocated in a sweep, so that references need not be counted, which would cost more than the work.
"""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import helper, kernel
from agglo_core.kernels.reach import fits, take_in
from agglo_core.kernels.ring_search import CROWD, REACH, connected
from agglo_core.kernels.shape_state import CELLS, CENTRE, FLOOR, MASS, ROOM, SHARE

__all__ = ["sweep_slices"]

_TIE = 1e-9


@helper
def _sort_listed(given, state, work, b, lo, hi):
    """Put the cells listed from ``lo`` to ``hi`` in the order of their places (Shell's sort).

    All that is needed of them is read beforehand, in loops in which no load waits for another.
    """
    for c in range(lo, hi):
        i = state.listed[c]
        key = 0.0
        for a in range(3):
            key += given.axes[b, a] * given.shapes[i, 2 + a]
        work.keys[c - lo], work.rows[c - lo] = key, given.indptr[i]
    for c in range(hi - lo):
        row = work.rows[c]
        work.read[c] = given.interface[row] + given.indices[row]
    gap = (hi - lo) // 2 if hi - lo > 16 else 1
    while gap > 0:
        for c in range(gap, hi - lo):
            i, key, j = state.listed[lo + c], work.keys[c], c
            while j >= gap and work.keys[j - gap] > key:
                work.keys[j] = work.keys[j - gap]
                state.listed[lo + j] = state.listed[lo + j - gap]
                j -= gap
            work.keys[j], state.listed[lo + j] = key, i
        gap = gap // 2 if gap < 5 else (5 * gap - 1) // 11


@helper
def _square(given, state, i, p):
    """Square of the distance of cell i from the centre of part p."""
    square = 0.0
    for a in range(3):
        square += (given.shapes[i, 2 + a] - state.tally[p, CENTRE + a]) ** 2
    return square


@helper
def _best_move(given, state, bounds, scale, i, work):
    """The part of the slice that cell i should move to, or −1, and what that adds to inertia and interface.

    The last of the results: whether parts of its block beyond the slice are beside the cell.
    """
    lo, hi, start, stop = bounds
    home, own, total = state.parts[i], 0.0, 0.0
    found, beyond = 0, False
    for h in range(given.indptr[i], given.indptr[i + 1]):
        p, length = state.parts[given.indices[h]], given.interface[h]
        total += length
        if p == home:
            own += length
        elif lo <= p < hi:
            if state.tally[p, SHARE] == 0.0:
                work.queue[found] = p
                found += 1
            state.tally[p, SHARE] += length
        else:
            beyond |= start <= p < stop
    target, best, inertia, cut = np.int64(-1), 0.0, 0.0, 0.0
    if found == 0:
        return target, inertia, cut, beyond
    w = given.shapes[i, 0]
    mass, lost = state.tally[home, MASS], 0.0
    if mass - w > 1e-12 * mass:
        lost = _square(given, state, i, home) * w * mass / (mass - w)
    length, energy = scale
    for m in range(found):
        p = np.int64(work.queue[m])
        shared, state.tally[p, SHARE] = state.tally[p, SHARE], 0.0
        mass, won = state.tally[p, MASS], 0.0
        if mass > 0.0:
            won = _square(given, state, i, p) * w * mass / (mass + w)
        change = length * (won - lost) + energy * (own - shared)
        tie = _TIE * (length * (won + lost) + energy * total)
        first = target < 0
        if change < (0.0 if first else best) - tie or (not first and change <= best + tie and p < target):
            target, best, inertia, cut = p, change, won - lost, own - shared
    return target, inertia, cut, beyond


@helper
def _leaves_whole(given, state, i, target, work, stamp):
    """Whether the part of cell i stays connected near it without it; then the cell is in ``target``.

    What other threads read of the cell meanwhile is one part of the slice or another.
    """
    home, filled = state.parts[i], 0
    for h in range(given.indptr[i], given.indptr[i + 1]):
        work.queue[filled] = given.indices[h]  # no branch: it would be mispredicted half the time
        filled += state.parts[given.indices[h]] == home
    state.parts[i] = target
    search = (work.queue, work.root, state.marks)
    if filled > 1 and not connected(
        given.indptr, given.indices, state.parts, home, search, filled, stamp, REACH, CROWD
    ):
        state.parts[i] = home
        return False
    return True


@helper
def _put(given, state, i, home, target):
    """Sums of the parts after cell i went from ``home`` to ``target``."""
    w, measure = given.shapes[i, 0], given.shapes[i, 1]
    left, joined = state.tally[home, MASS] - w, state.tally[target, MASS] + w
    for a in range(3):
        x = given.shapes[i, 2 + a]
        if left > 0.0:
            state.tally[home, CENTRE + a] -= (x - state.tally[home, CENTRE + a]) * w / left
        if joined > 0.0:
            state.tally[target, CENTRE + a] += (x - state.tally[target, CENTRE + a]) * w / joined
    state.tally[home, MASS], state.tally[target, MASS] = left, joined
    state.tally[home, ROOM] -= measure
    state.tally[target, ROOM] += measure
    state.tally[home, CELLS] -= 1.0
    state.tally[target, CELLS] += 1.0


@kernel(allocates=False)
def sweep_slices(given, state, work, slices, sweep, alpha, limit, reach, corners):
    """Look once at each cell that is due in the slices; returns how many moved.

    Each row of ``slices`` is: first part, last part plus 1, and the same of its block, and the block. Moves
    lower inertia times interface to the power ``alpha``, of which the slopes stay for the sweep those of
    ``blocks``. ``gains (k, 2)`` become what moves from each part added to inertia and interface. In a part,
    cells are taken by their places, so that their numbering does not matter.
    """
    n = np.int64(len(state.parts))
    stamp, moved = sweep * (n + 1), np.int64(0)
    for s in range(len(slices)):
        lo, hi, start, stop, b = slices[s, 0], slices[s, 1], slices[s, 2], slices[s, 3], slices[s, 4]
        scale = (state.blocks[b, 1], alpha * state.blocks[b, 0])
        for home in range(lo, hi):
            _sort_listed(given, state, work, b, state.first[home], state.first[home + 1])
            for c in range(state.first[home], state.first[home + 1]):
                i = state.listed[c]
                bounds = (lo, hi, start, stop)
                target, inertia, cut, beyond = _best_move(given, state, bounds, scale, i, work)
                state.due[i] = sweep + 1 if beyond else -1
                if target < 0 or state.tally[home, CELLS] < 2.0:
                    continue
                if state.tally[home, ROOM] - given.shapes[i, 1] < state.tally[home, FLOOR]:
                    continue
                if not fits(i, target, state.parts, reach, limit, corners):
                    continue
                stamp += 1
                if not _leaves_whole(given, state, i, target, work, stamp):
                    continue
                _put(given, state, i, home, target)
                take_in(i, home, target, reach, limit, corners)
                state.gains[home, 0] += inertia
                state.gains[home, 1] += cut
                moved += 1
                for h in range(given.indptr[i], given.indptr[i + 1]):
                    j = given.indices[h]
                    p = state.parts[j]
                    if start <= p < stop and not (lo <= p < hi and state.due[j] == sweep):
                        state.due[j] = sweep + 1
    return moved
