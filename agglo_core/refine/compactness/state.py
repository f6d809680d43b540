"""State of the k-way polish: its records, the first sums, and the list of cells of each sweep.

Shapes below: n cells in d dimensions, k parts, B blocks, S slices. During the sweeps parts are numbered in
the order of ``strip_order``, so that those of a block are a range.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.compiled.compiling import ONE, kernel

_LITTLE = 5e-4
"""A sweep that lowers the objective of a block by less than this share is the last one there.

A smaller value costs sweeps that hardly change anything, a larger one leaves parts less compact.
"""

_COLUMNS = 8  # of the sums of a part: they fill a line of the cache
MASS, CENTRE, CELLS, ROOM, FLOOR = 0, 1, 4, 5, 6
"""Columns of the sums ``tally (k, 8)``, those read most first.

``MASS``: sum of the weights. ``CENTRE``, in three columns: centre of mass. ``CELLS``: number of cells.
``ROOM``: measure. ``FLOOR``: measure that the part must keep. The last column fills the line of the cache.
"""


class Cells(NamedTuple):
    """Dual graph of the cells with their geometry, and axes of the blocks; constant during the sweeps.

    Attributes
    ----------
    indptr, indices : (n + 1,) and (m,) int
        Neighbours of the cells as CSR.
    interface : (m,) float
        Measure of the faces that the two cells of each entry share.
    centroids, weights, measures : (n, d), (n,) and (n,) float
        Of the cells; measures are ``graph.mass``, another quantity if the run shares parts out by that.
    axes : (B, 3) float
        Axis of each block, of any length: see ``part_places``.
    """

    indptr: Any
    indices: Any
    interface: Any
    centroids: Any
    weights: Any
    measures: Any
    axes: Any


class State(NamedTuple):
    """Arrays that change in sweeps, of cells, parts and blocks.

    Attributes
    ----------
    parts : (n,) int32
        Part of each cell.
    tally : (k, 8) float
        Sums of each part, in the columns ``MASS``, ``CENTRE``, … of this module; updated with each move.
    blocks : (B, 2) float
        Inertia J and interface L of each block at the start of the sweep: the objective is J · L^α.
    due : (n,) int8
        Number of the sweep that is to look at the cell; −1 for a cell that waits for a neighbour to move.
    marks : (n, 2) int32
        Stamp of the search that reached a cell last, and the start it was reached from: see ``connected`` in
        ``compiled/ring_search.py``.
    first : (k + 1,) int32
        The cells of part p that are due are ``listed[first[p]:first[p + 1]]``.
    listed : (n,) int32
        Cells due in this sweep, by part; only the first ``first[k]`` entries are in use.
    gains : (B, 2) float
        Workspace of ``listed_cells``: what the last sweep added to J and L, summed over the slices of the
        block; otherwise 0.
    going : (B,) bool
        False once a sweep lowered the objective of the block by less than ``_LITTLE``.
    """

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
    """Slices of a sweep: parts of one block that trade cells.

    Attributes
    ----------
    rows : (S, 5) int
        First part and last plus 1 of the slice, first part and last plus 1 of its block, and the block: see
        ``slices`` in ``strips.py``.
    gains : (S, 2) float
        What the moves in the slice added to inertia and interface.
    """

    rows: Any
    gains: Any


class Work(NamedTuple):
    """Work arrays of a thread.

    Attributes
    ----------
    queue, root : (n + 1,) int32
        Cells of a search, and its union-find structure; ``queue`` also lists the parts adjacent to a cell.
    keys : (n + 1,) float
        Places of cells along the axis of their block, for sorting.
    share : (k,) float
        Interface of a cell with each part; all 0 between cells.
    """

    queue: Any
    root: Any
    keys: Any
    share: Any


@kernel
def part_tally(labels, count, centroids, weights, measures, floor):
    """Part of each cell ``(n,)`` as int32, and the sums of each of ``count`` parts ``(k, 8)``.

    Columns are named by the constants of this module. In the plane the third coordinate of a centre is 0.
    The least measure of a part is ``floor`` times its measure at entry.
    """
    n, solid = len(labels), centroids.shape[1] > 2
    parts, tally = np.empty(n, np.int32), np.zeros((count, _COLUMNS))
    # 1. Sums over the cells of each part; the columns of the centre hold the first moments as yet.
    for i in range(n):
        home, w = np.uint32(labels[i]), weights[i]
        parts[i] = home
        tally[home, MASS] += w
        tally[home, ROOM] += measures[i]
        tally[home, CELLS] += 1.0
        tally[home, CENTRE] += w * centroids[i, 0]
        tally[home, CENTRE + 1] += w * centroids[i, 1]
        tally[home, CENTRE + 2] += w * centroids[i, 2] if solid else 0.0
    # 2. First moments over weights are centres. A part without weight has its centre at the origin: its
    #    cells add nothing to the inertia.
    for p in range(count):
        mass = tally[p, MASS]
        tally[p, FLOOR] = floor * tally[p, ROOM]
        for a in range(3):
            tally[p, CENTRE + a] = tally[p, CENTRE + a] / mass if mass > 0.0 else 0.0
    return parts, tally


@kernel
def interface_cells(given, parts, tally, block, count):
    """Inertia and interface of each block ``(count, 2)``, and the cells that the first sweep looks at.

    These have 0 in ``due (n,)``, others −1. The block of each part is ``block (k,)``. The inertia J is
    Σ w |x − c|² over the cells, c the centre of their part; the interface L is the length between parts of
    one block.
    """
    n, solid, several = len(parts), given.centroids.shape[1] > 2, count > 1
    blocks, due = np.zeros((count, 2)), np.empty(n, np.int8)
    for i in range(np.uint64(n)):
        home, length, others = np.uint32(parts[i]), 0.0, np.int64(0)
        own = np.uint32(block[home])
        # 1. Length of the cell's faces with other parts of its block. Every face is met from both sides:
        #    each counts one half.
        for h in range(np.uint64(given.indptr[i]), np.uint64(given.indptr[i + ONE])):
            q = np.uint32(parts[np.uint32(given.indices[h])])
            other = np.int64(q != home)
            if several:
                other &= block[q] == own
            others += other
            length += given.interface[h] * other  # no branch: it would be mispredicted
        # 2. The cell's share of the inertia; it is due if it is adjacent to another part.
        square = (given.centroids[i, 0] - tally[home, CENTRE]) ** 2
        square += (given.centroids[i, 1] - tally[home, CENTRE + 1]) ** 2
        square += (given.centroids[i, 2] - tally[home, CENTRE + 2]) ** 2 if solid else 0.0
        blocks[own, 0] += given.weights[i] * square
        blocks[own, 1] += 0.5 * length
        due[i] = 0 if others else -1
    return blocks, due


@kernel(allocates=False)
def listed_cells(state, work, sweep, before, alpha):
    """List the cells due in this sweep, part by part.

    Returns how many. Those of part p begin at ``first[p]``, so that the cells of a slice are a range of the
    list. Gains of the last sweep, over the slices ``before``, go into ``blocks``; blocks that gained little
    are done.
    """
    # 1. Gains of the slices are summed by block, and cleared.
    for s in range(len(before.rows)):
        for a in range(2):
            state.gains[before.rows[s, 4], a] += before.gains[s, a]
            before.gains[s, a] = 0.0
    for b in range(len(state.blocks)):
        # 2. Relative change of the objective J · L^α to first order, dJ / J + α dL / L: a block goes on
        #    while that falls enough.
        inertia, interface = state.blocks[b, 0], state.blocks[b, 1]
        # a block without inertia or interface is done: there nothing is a number
        gain = state.gains[b, 0] / inertia + alpha * (state.gains[b, 1] / interface)
        state.going[b] &= sweep == 0 or -gain > _LITTLE
        for a in range(2):
            state.blocks[b, a] += state.gains[b, a]
            state.gains[b, a] = 0.0
    # 3. The cells that are due, by number.
    count = np.uint64(0)
    for i in range(len(state.parts)):
        work.queue[count] = i  # no branch: it would be mispredicted half the time
        count += np.uint64(state.due[i] == sweep)
    # 4. Counting sort by part, with the numbers of cells, then where each part ends. Filled from behind,
    #    cells of a part keep their order, and ``first`` has moved to where each part starts.
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
