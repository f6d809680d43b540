"""Pieces halved by weight across their principal axis, again and again."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import helper, kernel
from agglo_core.kernels.piece_driver import largest_piece, split_pieces, tag_sides
from agglo_core.kernels.piece_frames import load_piece, point_room, principal_frame
from agglo_core.kernels.piece_refinement import sort_by_keys

__all__ = ["halve", "split_across_axes"]

_TIE = 1e-7  # of the extent: what counts as equal, as in ``graph.blocks``
_BINS = 256
_FEW = 64  # values that are sorted
_HALF = 0.5 + 1e-9  # halves go down, whatever the rounding of sums


@helper
def _median(n, score, shares, some, keys, tally):
    """The score of the cell that holds the middle of the weight; the shares add up to 1.

    Bins are counted, then bins of the bin that has the middle, until few scores are left to be sorted.
    """
    m, below = n, 0.0
    for k in range(n):
        some[k], keys[k] = k, score[k]
    while m > _FEW:
        low, high = keys[0], keys[0]
        for k in range(m):
            low, high = min(low, keys[k]), max(high, keys[k])
        rate = _BINS / (high - low) if high > low else 0.0
        if not 0.0 < rate < 1e300:
            return low
        for b in range(_BINS):
            tally[b] = 0.0
        for k in range(m):
            tally[min(np.int64((keys[k] - low) * rate), _BINS - 1)] += shares[some[k]]
        chosen = 0
        while chosen < _BINS - 1 and below + tally[chosen] <= 0.5:
            below += tally[chosen]
            chosen += 1
        kept = 0
        for k in range(m):
            value = keys[k]
            some[kept], keys[kept] = some[k], value
            kept += min(np.int64((value - low) * rate), _BINS - 1) == chosen
        if kept == 0:  # rounding of sums: the rest has no weight
            return high
        m = kept
    sort_by_keys(some, keys, m)
    for k in range(m - 1):
        below += shares[some[k]]
        if below > 0.5:
            return keys[k]
    return keys[m - 1]


@helper
def _sort_tied(m, local, frame, tie, some, keys):
    """Sort cells that count as equal along the first axis by the second and, if they do there, the third."""
    for axis in range(1, 3):
        first = 0
        while first < m:
            last = first + 1
            while axis > 1 and last < m and keys[last] - keys[last - 1] <= tie:
                last += 1
            last = last if axis > 1 else m
            for k in range(first, last):
                i, along = some[k], 0.0
                for c in range(3):
                    along += frame[axis, c] * local[c, i]
                keys[k] = along
            sort_by_keys(some[first:last], keys[first:last], last - first)
            first = last


@helper
def halve(n, local, shares, frame, score, some, keys, tally):
    """Halve points by weight across the first axis of a frame; ties are broken along the others.

    Fills ``score`` with heights of which those above the returned bar are on one side; infinite if the
    points coincide. Points that count as equal, within 1e-7 of the extent, are as far from it.
    """
    low, high = np.inf, -np.inf
    for k in range(n):
        score[k] = frame[0, 0] * local[0, k] + frame[0, 1] * local[1, k] + frame[0, 2] * local[2, k]
        low, high = min(low, score[k]), max(high, score[k])
    tie = _TIE * (high - low)
    if not tie > 0.0:
        return np.inf
    bar, below, m = _median(n, score, shares, some, keys, tally), 0.0, 0
    for k in range(n):
        below += shares[k] if score[k] < bar - tie else 0.0
        some[m] = k
        m += abs(score[k] - bar) <= tie
    if m > 1:
        _sort_tied(m, local, frame, tie, some, keys)
    for k in range(m):
        i = some[k]
        score[i] = bar + tie if below + 0.5 * shares[i] > _HALF else bar - tie
        below += shares[i]
    return bar


@helper(allocates=True)
def _cut(graph, cells, lo, hi, extent, own, tag, marks, near, sums):
    (local, shares, _), (frame, score, some, keys, tally) = own
    n, planar = hi - lo, graph[3].shape[1] == 2
    principal_frame(n, planar, local, shares, frame)
    bar = halve(n, local, shares, frame, score, some, keys, tally)
    for k in range(3):
        sums[2][k] = frame[0, k]
    return tag_sides(graph, cells, lo, hi, score, bar, 1.0, extent, tag, near, sums)


@kernel
def split_across_axes(graph, shape, cells, tag, marks, todo, ready, leaf, counts, tally, goal, work):
    """Split pieces, the last in ``todo`` first; the arguments are those of ``PieceGrowth``."""
    m = largest_piece(todo, counts)
    room = np.empty((3, 3)), np.empty(m), np.empty(m, np.int32), np.empty(m), np.empty(_BINS)
    own = point_room(m), room
    split_pieces(
        load_piece, _cut, own, graph, shape, cells, tag, marks, todo, ready, leaf, counts, tally, goal, work
    )
