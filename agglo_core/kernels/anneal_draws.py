"""Which cell annealing tries next, and how much worse a move may be: random numbers of its own."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.anneal_state import COUNT
from agglo_core.kernels.compiling import ONE, helper

__all__ = ["EVERY", "drawn_loss", "drawn_move", "ramp", "window"]

EVERY = 128
"""Draws between two changes of temperature, penalty and window."""

_MANY, _WINDOW, _LEVELS, _SLIDE = 1536, 768, 80, 311
"""More cells are annealed in windows of so many, which slide along the order of the cells: each is visited at
so many temperatures, and begins so many cells further on each time."""

_STEP, _MIX, _LAST = (np.uint64(c) for c in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))
_HALF, _MIDDLE, _SHORT = np.uint64(30), np.uint64(27), np.uint64(31)
_LOW, _WORD, _ROUGH = np.uint64(0xFFFFFFFF), np.uint64(32), np.uint64(11)
_UNIT = 2.0**-53


@helper
def _random(state):
    """The next state of the generator splitmix64, and 64 random bits."""
    state = state + _STEP
    z = (state ^ (state >> _HALF)) * _MIX
    z = (z ^ (z >> _MIDDLE)) * _LAST
    return state, z ^ (z >> _SHORT)


@helper
def ramp(turn, moves, ramps):
    """Temperature and penalty at this turn, each on its way from the first to the last by equal factors."""
    hot, cold, soft, stiff = ramps
    done = turn / moves
    return hot * np.exp(np.log(cold / hot) * done), soft * np.exp(np.log(stiff / soft) * done)


@helper
def window(turn, moves, n):
    """The first cell of those drawn from at this turn, and how many there are; they go on from the start."""
    windows = n // _WINDOW if n > _MANY else 1
    if windows == 1:
        return np.uint64(0), np.uint64(n)
    visit = turn // max(1, moves // (_LEVELS * windows))
    w, slide = visit % windows, visit // windows * _SLIDE % _WINDOW
    first = w * n // windows
    return np.uint64(first + slide), np.uint64((w + 1) * n // windows - first)


@helper
def drawn_move(state, span, cells, parts):
    """A cell of the window, its part, and that of one of its neighbours: the same if nothing can move."""
    state, bits = _random(state)
    n = np.uint64(len(parts.labels))
    i = span[0] + ((bits >> _WORD) * span[1] >> _WORD)
    i = i - n if i >= n else i
    begin, p = np.uint64(cells.indptr[i]), parts.labels[i]
    beside = np.uint64(cells.indptr[i + ONE]) - begin
    if beside == 0 or parts.tally[p, COUNT] < 2.0:
        return state, np.int64(i), p, p
    q = parts.labels[np.uint32(cells.indices[begin + ((bits & _LOW) * beside >> _WORD)])]
    return state, np.int64(i), p, q


@helper
def drawn_loss(state, heat):
    """By how much the score may fall, a negative number: Metropolis' rule, drawn before the move."""
    state, bits = _random(state)
    return state, heat * np.log((np.float64(bits >> _ROUGH) + 0.5) * _UNIT)
