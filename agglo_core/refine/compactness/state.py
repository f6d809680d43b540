"""Data of the k-way polish: arrays, initial sums, and the list of cells to visit in each sweep.

Shapes below: n cells in d dimensions, k parts, B blocks, S slices. During the sweeps parts are numbered in
the order of ``strip_order``, so that each block's parts are a range.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel

SWEEPS = 24
"""Maximum number of sweeps in a round, even. Rounds with little gain end earlier (``list_due_cells``).

More sweeps leave parts of many cells more compact, and take longer (benchmarks/polish.py).
"""

_LITTLE = 5e-4
"""Relative gain: a sweep that lowers a block's objective by less than this fraction is the last sweep of the
round in this block.

A smaller value costs sweeps with almost no change, a larger value leaves parts less compact
(benchmarks/polish.py).
"""

_FEW = 0.05
"""Fraction of the cells due at the start of a round in a block: the round ends when fewer are due.

Few cells gain little, and the next round visits all boundary cells anyway (benchmarks/polish.py).
"""

_SHIFT = 12.0
"""Number of cells, of the mean measure in the part, by which a part may grow or shrink.

So parts of many cells stay even. With a larger number they become more compact (benchmarks/curve.py).
"""

_COLUMNS = 8  # columns of part sums: 64 bytes, one cache line
MASS, CENTRE, CELLS, ROOM, FLOOR, CEILING = 0, 1, 4, 5, 6, 7
"""Columns of the part sums ``tally (k, 8)``, most frequently read first.

``MASS``: sum of the weights. ``CENTRE``, three columns: centre of mass. ``CELLS``: cell count. ``ROOM``:
measure. ``FLOOR`` and ``CEILING``: smallest and largest measure that the part may have.
"""


class Cells(NamedTuple):
    """Dual graph with cell geometry and block axes, constant during the sweeps.

    Attributes
    ----------
    indptr, indices : (n + 1,) and (m,) int
        Cell neighbours as CSR.
    interface : (m,) float
        Measure of the common faces for each entry.
    centroids, weights, measures : (n, d), (n,) and (n,) float
        Cell data. ``measures`` are ``graph.mass``, another quantity if the run distributes parts by that
        quantity.
    axes : (B, 3) float
        Axis per block, of any length: see ``part_places``.
    """

    indptr: Any
    indices: Any
    interface: Any
    centroids: Any
    weights: Any
    measures: Any
    axes: Any


class State(NamedTuple):
    """Arrays that change during sweeps, for cells, parts and blocks.

    Attributes
    ----------
    parts : (n,) int32
        Part per cell.
    block : (k,) int
        Block per part.
    tally : (k, 8) float
        Part sums in the columns ``MASS``, ``CENTRE``, … of this module, updated with each move.
    blocks : (B, 2) float
        Inertia J and interface L per block at the start of the sweep. The objective is J · L^α.
    due : (n,) int8
        Number of the sweep that visits the cell, or −1 for a cell that waits for a neighbour to move.
    marks : (n, 2) int32
        Stamp of the last search in this round that reached a cell, and the start of that search: see
        ``are_connected`` in ``compiled/ring_search.py``.
    first : (k + 1,) int32
        The due cells of part p are ``listed[first[p]:first[p + 1]]``.
    listed : (n,) int32
        Cells due in this sweep, by part. Only the first ``first[k]`` entries are in use.
    gains : (B, 2) float
        Workspace for ``list_due_cells``, 0 between its steps.
    going : (B,) bool
        False for blocks in which the round has ended.
    at_first : (B,) float
        Number of cells due at the start of the round.
    """

    parts: Any
    block: Any
    tally: Any
    blocks: Any
    due: Any
    marks: Any
    first: Any
    listed: Any
    gains: Any
    going: Any
    at_first: Any


class Slices(NamedTuple):
    """Slices of a sweep: part groups in one block that exchange cells.

    Attributes
    ----------
    rows : (S, 5) int
        First part and last part plus 1 in the slice, first part and last part plus 1 in its block, and the
        block number: see ``slices`` in ``strips.py``.
    gains : (S, 2) float
        Changes in inertia and interface by the moves in the slice.
    """

    rows: Any
    gains: Any


class Work(NamedTuple):
    """Workspace of a thread.

    Attributes
    ----------
    queue, root : (n + 1,) int32
        Cells of a search, and its union-find structure. ``queue`` also lists the parts adjacent to a cell.
    keys : (n + 1,) float
        Cell positions along the block axis, for sorting.
    share : (k,) float
        Interface of a cell with each part, all 0 between cells.
    """

    queue: Any
    root: Any
    keys: Any
    share: Any


@kernel
def part_tally(labels, count, centroids, weights, measures, floor):
    """Return the part per cell ``(n,)`` as int32, and the sums per part ``(k, 8)``.

    The constants of this module name the columns. In 2-D the third coordinate of a centre is 0. The smallest
    allowed measure is ``floor`` times the measure at entry, and more for parts of many cells (``_SHIFT``).
    """
    n, solid = len(labels), centroids.shape[1] > 2
    parts, tally = np.empty(n, np.int32), np.zeros((count, _COLUMNS))
    # 1. Sum over the cells in each part. The centre columns hold first moments for now.
    for i in range(n):
        home, w = np.uint32(labels[i]), weights[i]
        parts[i] = home
        tally[home, MASS] += w
        tally[home, ROOM] += measures[i]
        tally[home, CELLS] += 1.0
        tally[home, CENTRE] += w * centroids[i, 0]
        tally[home, CENTRE + 1] += w * centroids[i, 1]
        tally[home, CENTRE + 2] += w * centroids[i, 2] if solid else 0.0
    # 2. First moments over weights are centres. A part without weight has its centre at the origin, because
    #    its cells do not contribute to the inertia.
    for p in range(count):
        mass = tally[p, MASS]
        change = _SHIFT / max(tally[p, CELLS], 1.0)
        tally[p, FLOOR] = max(floor, 1.0 - change) * tally[p, ROOM]
        tally[p, CEILING] = (1.0 + change) * tally[p, ROOM]
        for a in range(3):
            tally[p, CENTRE + a] = tally[p, CENTRE + a] / mass if mass > 0.0 else 0.0
    return parts, tally


@kernel
def interface_cells(cells, parts, tally, block, count):
    """Return inertia and interface per block ``(count, 2)``, and the cells to visit in the first sweep.

    In ``due (n,)`` these cells have 0, other cells −1. The block of each part is ``block (k,)``. The inertia
    J is Σ w |x − c|² over the cells, with the centre c of their part. The interface L is the length between
    parts of one block.
    """
    n, solid, several = len(parts), cells.centroids.shape[1] > 2, count > 1
    blocks, due = np.zeros((count, 2)), np.empty(n, np.int8)
    for i in range(np.uint64(n)):
        home, length, n_crossing = np.uint32(parts[i]), 0.0, np.int64(0)
        home_block = np.uint32(block[home])
        # 1. Sum the cell's faces with other parts of its block. Every face is visited from both sides, so
        #    each visit counts one half.
        for h in range(np.uint64(cells.indptr[i]), np.uint64(cells.indptr[i + ONE])):
            q = np.uint32(parts[np.uint32(cells.indices[h])])
            crosses = np.int64(q != home)
            if several:
                crosses &= block[q] == home_block
            n_crossing += crosses
            length += cells.interface[h] * crosses  # no branch: it would be mispredicted
        # 2. Add the cell's inertia. The cell is due if it is adjacent to another part.
        square = (cells.centroids[i, 0] - tally[home, CENTRE]) ** 2
        square += (cells.centroids[i, 1] - tally[home, CENTRE + 1]) ** 2
        square += (cells.centroids[i, 2] - tally[home, CENTRE + 2]) ** 2 if solid else 0.0
        blocks[home_block, 0] += cells.weights[i] * square
        blocks[home_block, 1] += 0.5 * length
        due[i] = 0 if n_crossing else -1
    return blocks, due


@kernel(allocates=False)
def mark_boundary_cells(cells, state, sweep, start, stop):
    """Make the cells from ``start`` adjacent to another part of their block due, and clear the marks."""
    several = len(state.blocks) > 1
    for i in range(np.uint64(start), np.uint64(stop)):
        home, is_adjacent = np.uint32(state.parts[i]), np.int64(0)
        for h in range(np.uint64(cells.indptr[i]), np.uint64(cells.indptr[i + ONE])):
            p = np.uint32(state.parts[np.uint32(cells.indices[h])])
            crosses = np.int64(p != home)
            if several:
                crosses &= state.block[p] == state.block[home]
            is_adjacent |= crosses  # no branch: it would be mispredicted
        state.due[i] = sweep if is_adjacent else -1
        state.marks[i, 0] = 0


@helper
def _sort_by_part(state, work, sweep):
    """List the cells due in this sweep by part, and return their number (counting sort)."""
    # 1. List them by number.
    count = np.uint64(0)
    for i in range(len(state.parts)):
        work.queue[count] = i  # no branch: it would be mispredicted half the time
        count += np.uint64(state.due[i] == sweep)
    # 2. Count the cells of each part, compute the end of each part, and fill from behind. Cells keep their
    #    order within a part, and ``first`` moves to the start of each part.
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


@kernel(allocates=False)
def list_due_cells(cells, state, work, sweep, begins, before, alpha):
    """List the cells to visit in this sweep, sorted by part, and return their number, or 0.

    The cells of part p begin at ``first[p]``, so the cells of a slice are a range in the list. The gains of
    the last sweep, over the slices ``before``, are added to ``blocks``. When a round ``begins``, all boundary
    cells must be marked. A round ends in a block after a sweep with little gain, or when few cells are due.
    The number is 0 if it has ended in all blocks.
    """
    # 1. Sum the slice gains by block, and clear them.
    for s in range(len(before.rows)):
        for a in range(2):
            state.gains[before.rows[s, 4], a] += before.gains[s, a]
            before.gains[s, a] = 0.0
    for b in range(len(state.blocks)):
        # 2. Relative change of the objective J · L^α to first order: dJ / J + α dL / L. A block continues
        #    while this decreases enough.
        inertia, interface = state.blocks[b, 0], state.blocks[b, 1]
        # The round ends in a block without inertia or interface, because the gain is NaN.
        gain = state.gains[b, 0] / inertia + alpha * (state.gains[b, 1] / interface)
        state.going[b] = begins or (state.going[b] and -gain > _LITTLE)
        for a in range(2):
            state.blocks[b, a] += state.gains[b, a]
            state.gains[b, a] = 0.0
    # 3. List the due cells.
    count = _sort_by_part(state, work, sweep)
    # 4. End the round in blocks with few due cells.
    for r in range(len(state.block)):
        state.gains[state.block[r], 0] += state.first[r + 1] - state.first[r]
    any_going = False
    for b in range(len(state.blocks)):
        if begins:
            state.at_first[b] = state.gains[b, 0]
        state.going[b] &= begins or state.gains[b, 0] > _FEW * state.at_first[b]
        any_going |= state.going[b]
        state.gains[b, 0] = 0.0
    return count if any_going else np.int64(0)
