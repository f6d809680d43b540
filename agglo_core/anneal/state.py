"""Arrays of simulated annealing, and random cell moves."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.compiled.compiling import ONE, helper
from agglo_core.compiled.ring_search import CROWD, REACH, are_connected

COLUMNS = 4  # number of columns of part sums
MEASURE, SURFACE, DIAMETER, COUNT = 0, 1, 2, 3
"""Columns of part sums: measure, measure of the faces, diameter, cell count."""


class Cells(NamedTuple):
    """Cell graph with geometry, vertices per cell, and cells per vertex.

    ``surfaces (n,)`` are the total face measures per cell, ``radii (n,)`` the largest vertex distances
    from the centroid, and ``spans (n,)`` the diameters. Two CSRs contain the vertices of each cell
    (``offsets``, ``vertices``) and the cells at each vertex (``meeting_offsets``, ``meeting``).
    """

    indptr: Any
    indices: Any
    interface: Any
    measures: Any
    centroids: Any
    offsets: Any
    vertices: Any
    points: Any
    surfaces: Any
    radii: Any
    spans: Any
    meeting_offsets: Any
    meeting: Any


class Parts(NamedTuple):
    """Part per cell, and for each part its sums, its two farthest vertices and its cell list.

    ``tally (k, 4)`` has the columns named above, ``ends (k, 2)`` the two farthest vertices. The cells in a
    part form a linked list: ``first (k,)``, then ``after`` and ``before``, ``(n,)`` each, terminated by −1.
    """

    labels: Any
    tally: Any
    ends: Any
    first: Any
    after: Any
    before: Any


class Work(NamedTuple):
    """Workspace for searches: cells, union-find roots, cell marks, vertex marks, vertices of a part."""

    queue: Any
    root: Any
    marks: Any
    seen: Any
    found: Any


@helper
def may_leave(i, p, q, cells, parts, work, stamp):
    """Give cell i the label q if part p stays locally connected without it.

    Returns True in this case. Sums and lists remain unchanged.
    """
    filled, i = np.uint64(0), np.uint64(i)
    # 1. List the neighbours in part p. If there are none, p consists of this cell, or is already
    #    disconnected.
    for h in range(np.uint64(cells.indptr[i]), np.uint64(cells.indptr[i + ONE])):
        j = np.uint32(cells.indices[h])
        work.queue[filled] = j  # no branch: it would be mispredicted half the time
        filled += np.uint64(parts.labels[j] == p)
    if filled == 0:
        return False
    # 2. A single neighbour is always connected. With several, ring searches around the cell decide. The new
    #    label hides the cell from them.
    parts.labels[i] = q
    search = (work.queue, work.root, work.marks)
    if filled > ONE and not are_connected(
        cells.indptr, cells.indices, parts.labels, p, search, filled, stamp, REACH, CROWD
    ):
        parts.labels[i] = p
        return False
    return True


@helper
def exchange(i, p, q, parts):
    """Move cell i from part p's list to part q's list."""
    if parts.before[i] >= 0:
        parts.after[parts.before[i]] = parts.after[i]
    else:
        parts.first[p] = parts.after[i]
    if parts.after[i] >= 0:
        parts.before[parts.after[i]] = parts.before[i]
    parts.after[i], parts.before[i] = parts.first[q], -1
    if parts.first[q] >= 0:
        parts.before[parts.first[q]] = i
    parts.first[q] = i


class Shares(NamedTuple):
    """Groups of parts (shares): cells by share, offsets ``(S + 1,)``, and the share per part ``(k,)``.

    The parts in a share trade cells only among themselves, so several threads may process the shares.
    """

    cells: Any
    starts: Any
    of_part: Any


# Increment and multipliers of the random number generator splitmix64.
_STEP, _MIX, _LAST = (np.uint64(c) for c in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))
_HALF, _MIDDLE, _SHORT = np.uint64(30), np.uint64(27), np.uint64(31)  # shifts of splitmix64, in bits
# Mask and length of the lower half of the 64 bits, and number of bits dropped to leave 53 for a fraction.
_LOW, _WORD, _ROUGH = np.uint64(0xFFFFFFFF), np.uint64(32), np.uint64(11)
_UNIT = 2.0**-53  # scales integers of 53 bits to the interval from 0 to 1


@helper
def _random(state):
    """Return the next splitmix64 state, and 64 random bits."""
    state = state + _STEP
    z = (state ^ (state >> _HALF)) * _MIX
    z = (z ^ (z >> _MIDDLE)) * _LAST
    return state, z ^ (z >> _SHORT)


@helper
def most_draws(rounds):
    """Return a bound on the draws per cell over all rounds ``(3, R)``: temperatures, penalties, draws."""
    most = np.int64(0)
    for r in range(rounds.shape[1]):
        most += np.int64(rounds[2, r]) + 1
    return most


@helper
def share_seed(seed, s):
    """Return the random seed for share s, a group of parts."""
    return np.uint64(seed) ^ np.uint64(s + 1) * _STEP


@helper
def draw_move(state, s, shares, cells, parts):
    """Draw a random cell in the group of parts s, and one of its neighbours.

    Returns the next generator state, the cell, and the parts of cell and neighbour. If the cell cannot move,
    its part is returned twice.
    """
    state, bits = _random(state)
    # 1. The upper 32 bits, times the cell count over 2³², select the cell.
    begin, count = np.uint64(shares.starts[s]), np.uint64(shares.starts[s + 1] - shares.starts[s])
    i = np.uint64(np.uint32(shares.cells[begin + ((bits >> _WORD) * count >> _WORD)]))
    # 2. The lower 32 bits select the neighbour likewise. A part keeps its last cell, and trades only within
    #    its share, because threads process the other shares.
    first, p = np.uint64(cells.indptr[i]), parts.labels[i]
    degree = np.uint64(cells.indptr[i + ONE]) - first
    if degree == 0 or parts.tally[p, COUNT] < 2.0:
        return state, np.int64(i), p, p
    q = parts.labels[np.uint32(cells.indices[first + ((bits & _LOW) * degree >> _WORD)])]
    return state, np.int64(i), p, (q if shares.of_part[q] == s else p)


@helper
def draw_loss(state, heat):
    """Draw the admissible loss heat · log(u) < 0, with u uniform in (0, 1) (Metropolis criterion)."""
    state, bits = _random(state)
    return state, heat * np.log((np.float64(bits >> _ROUGH) + 0.5) * _UNIT)
