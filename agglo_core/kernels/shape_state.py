"""What the sweeps of the k-way polish start from, and the cells that each of them is to look at."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.kernels.compiling import kernel

__all__ = [
    "CELLS",
    "CENTRE",
    "FLOOR",
    "MASS",
    "ROOM",
    "SHARE",
    "Cells",
    "State",
    "Work",
    "listed_cells",
    "part_tally",
]

_COLUMNS = 8  # of the sums of a part: they fill a line of the cache
MASS, ROOM, FLOOR, CELLS, SHARE, CENTRE = 0, 1, 2, 3, 4, 5
"""Columns of these sums: weight, measure, least measure, cells, interface with the cell looked at, centre."""


class Cells(NamedTuple):
    """Graph of the cells; weight, measure and centroid of each ``(n, 5)``; an axis of each block."""

    indptr: Any
    indices: Any
    interface: Any
    shapes: Any
    axes: Any


class State(NamedTuple):
    """What changes in a sweep: of cells, parts, and blocks."""

    parts: Any
    tally: Any
    blocks: Any
    due: Any
    marks: Any
    gains: Any
    first: Any
    listed: Any


class Work(NamedTuple):
    """Room for a thread: cells and their roots in a search; keys, rows and values of the cells of a part."""

    queue: Any
    root: Any
    keys: Any
    rows: Any
    read: Any


@kernel
def part_tally(given, parts, starts, floor):
    """What sweeps start from: sums of each part, inertia and interface of each block, cells on interfaces.

    Returns ``tally (k, 8)``, ``blocks (B, 2)`` and ``due (n,)``: 0 for the cells that the first sweep looks
    at, else −1.
    """
    indptr, indices, interface, shapes, _ = given
    n, k = len(parts), starts[-1]
    tally, blocks = np.zeros((k, _COLUMNS)), np.zeros((len(starts) - 1, 2))
    owner, due = np.empty(k, np.int32), np.empty(n, np.int8)
    for b in range(len(blocks)):
        for p in range(starts[b], starts[b + 1]):
            owner[p] = b
    for i in range(n):
        p = parts[i]
        tally[p, MASS] += shapes[i, 0]
        tally[p, ROOM] += shapes[i, 1]
        tally[p, CELLS] += 1.0
        for a in range(3):
            tally[p, CENTRE + a] += shapes[i, 0] * shapes[i, 2 + a]
    for p in range(k):
        mass = tally[p, MASS]
        tally[p, FLOOR] = floor * tally[p, ROOM]
        for a in range(3):
            tally[p, CENTRE + a] = tally[p, CENTRE + a] / mass if mass > 0.0 else 0.0
    for i in range(n):
        p = parts[i]
        b, square, length = owner[p], 0.0, 0.0
        edge = False
        for a in range(3):
            square += (shapes[i, 2 + a] - tally[p, CENTRE + a]) ** 2
        for h in range(indptr[i], indptr[i + 1]):
            q = parts[indices[h]]
            other = (q != p) & (starts[b] <= q) & (q < starts[b + 1])  # no branch
            edge |= other
            length += interface[h] if other else 0.0
        blocks[b, 0] += shapes[i, 0] * square
        blocks[b, 1] += 0.5 * length
        due[i] = 0 if edge else -1
    return tally, blocks, due


@kernel(allocates=False)
def listed_cells(state, work, sweep, starts):
    """List the cells due in this sweep part by part, those of part p from ``first[p]`` on; their number.

    What the last sweep gained goes into ``blocks``.
    """
    count = np.int64(0)
    for i in range(len(state.parts)):
        work.queue[count] = i  # no branch: it would be mispredicted half the time
        count += state.due[i] == sweep
    for b in range(len(state.blocks)):
        for p in range(starts[b], starts[b + 1]):
            state.first[p] = 0
            for k in range(2):
                state.blocks[b, k] += state.gains[p, k]
                state.gains[p, k] = 0.0
    state.first[starts[-1]] = 0
    for c in range(count):
        state.first[state.parts[work.queue[c]]] += 1
    filled = 0
    for p in range(len(state.first)):
        filled += state.first[p]
        state.first[p] = filled
    for c in range(count - 1, -1, -1):
        i = work.queue[c]
        p = state.parts[i]
        state.first[p] -= 1
        state.listed[state.first[p]] = i
    return count
