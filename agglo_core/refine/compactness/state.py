"""What the sweeps of the k-way polish start from, and the cells that each of them is to look at."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.compiled.compiling import ONE, kernel

_LITTLE = 5e-4
"""A sweep that lowers the objective of a block by less than this share is the last one there."""

_COLUMNS = 8  # of the sums of a part: they fill a line of the cache
MASS, CENTRE, CELLS, ROOM, FLOOR = 0, 1, 4, 5, 6
"""Columns of these sums: weight, centre, cells, measure, least measure; what is read most comes first."""


class Cells(NamedTuple):
    """Graph of the cells; centroid, weight and measure of each; an axis of each block."""

    indptr: Any
    indices: Any
    interface: Any
    centroids: Any
    weights: Any
    measures: Any
    axes: Any


class State(NamedTuple):
    """What changes in a sweep: of cells, parts, and blocks."""

    parts: Any
    tally: Any
    blocks: Any
    due: Any
    marks: Any
    first: Any
    listed: Any
    gains: Any
    going: Any


class Slices(NamedTuple):
    """Parts and block of each ``(S, 5)``: see ``slices``; what moves in each gained ``(S, 2)``."""

    rows: Any
    gains: Any


class Work(NamedTuple):
    """Room for a thread: cells and their roots in a search; keys of the cells of a part; shares of parts."""

    queue: Any
    root: Any
    keys: Any
    share: Any


@kernel
def part_tally(labels, count, centroids, weights, measures, floor):
    """Number of the part of each cell ``(n,)``, narrow, and the sums of each of ``count`` parts ``(k, 8)``.

    In the plane the third coordinate is 0.
    """
    n, solid = len(labels), centroids.shape[1] > 2
    parts, tally = np.empty(n, np.int32), np.zeros((count, _COLUMNS))
    for i in range(n):
        home, w = np.uint32(labels[i]), weights[i]
        parts[i] = home
        tally[home, MASS] += w
        tally[home, ROOM] += measures[i]
        tally[home, CELLS] += 1.0
        tally[home, CENTRE] += w * centroids[i, 0]
        tally[home, CENTRE + 1] += w * centroids[i, 1]
        tally[home, CENTRE + 2] += w * centroids[i, 2] if solid else 0.0
    for p in range(count):
        mass = tally[p, MASS]
        tally[p, FLOOR] = floor * tally[p, ROOM]
        for a in range(3):
            tally[p, CENTRE + a] = tally[p, CENTRE + a] / mass if mass > 0.0 else 0.0
    return parts, tally


@kernel
def interface_cells(given, parts, tally, block, count):
    """Inertia and interface of each block ``(count, 2)``, and which cells the first sweep looks at.

    These have 0 in ``due (n,)``, others −1. The block of each part is ``block (k,)``.
    """
    n, solid, several = len(parts), given.centroids.shape[1] > 2, count > 1
    blocks, due = np.zeros((count, 2)), np.empty(n, np.int8)
    for i in range(np.uint64(n)):
        home, length, others = np.uint32(parts[i]), 0.0, np.int64(0)
        own = np.uint32(block[home])
        for h in range(np.uint64(given.indptr[i]), np.uint64(given.indptr[i + ONE])):
            q = np.uint32(parts[np.uint32(given.indices[h])])
            other = np.int64(q != home)
            if several:
                other &= block[q] == own
            others += other
            length += given.interface[h] * other  # no branch: it would be mispredicted
        square = (given.centroids[i, 0] - tally[home, CENTRE]) ** 2
        square += (given.centroids[i, 1] - tally[home, CENTRE + 1]) ** 2
        square += (given.centroids[i, 2] - tally[home, CENTRE + 2]) ** 2 if solid else 0.0
        blocks[own, 0] += given.weights[i] * square
        blocks[own, 1] += 0.5 * length
        due[i] = 0 if others else -1
    return blocks, due


@kernel(allocates=False)
def listed_cells(state, work, sweep, before, alpha):
    """List the cells due in this sweep slice by slice, those of slice s from ``first[s]`` on; their number.

    What moves in the slices ``before`` gained goes into ``blocks``; those that gained little are done.
    """
    for s in range(len(before.rows)):
        for a in range(2):
            state.gains[before.rows[s, 4], a] += before.gains[s, a]
            before.gains[s, a] = 0.0
    for b in range(len(state.blocks)):
        inertia, interface = state.blocks[b, 0], state.blocks[b, 1]
        # a block without inertia or interface is done: there nothing is a number
        gain = state.gains[b, 0] / inertia + alpha * (state.gains[b, 1] / interface)
        state.going[b] &= sweep == 0 or -gain > _LITTLE
        for a in range(2):
            state.blocks[b, a] += state.gains[b, a]
            state.gains[b, a] = 0.0
    count = np.uint64(0)
    for i in range(len(state.parts)):
        work.queue[count] = i  # no branch: it would be mispredicted half the time
        count += np.uint64(state.due[i] == sweep)
    for r in range(len(state.first)):
        state.first[r] = 0
    for c in range(count):
        state.first[np.uint32(state.parts[np.uint32(work.queue[c])])] += 1
    filled = 0
    for r in range(len(state.first)):
        filled += state.first[r]
        state.first[r] = filled
    for c in range(count):
        last = np.uint32(work.queue[count - ONE - c])
        p = np.uint32(state.parts[last])
        state.first[p] -= 1
        state.listed[np.uint32(state.first[p])] = last
    return np.int64(count)
