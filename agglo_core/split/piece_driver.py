"""Recursive bisection of mesh pieces within one cell list: cut, refine, test and separate the sides.

A bisector supplies two helpers, to load and to cut a piece. Everything else happens here.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.compiled.compiling import helper
from agglo_core.compiled.widths import is_wider
from agglo_core.split.piece_refinement import refine_sides
from agglo_core.split.piece_shares import holds_share, shift_cut
from agglo_core.split.piece_splits import (
    cells_beside,
    is_connected,
    narrowness,
    new_sides,
    new_workspace,
    part_list,
    quota_of_left,
    side_measures,
    side_tags,
    sides_connected,
)

START, STOP, QUOTA, DEPTH, STATE, COLUMNS = 0, 1, 2, 3, 4, 5
"""Columns in lists of pieces, and their number: the first and last cell plus 1, the number of parts (0 for a
size goal), the depth, and the state of the piece."""

UNCUT, TORN, MENDED = 0, 1, 2
"""States of a piece to split: untouched, sides tagged with one side disconnected, and both sides reconnected.
"""

WHOLE, APART = 1, 2
"""Marks of finished pieces at their first cell. APART means disconnected, and is only tested for tiny pieces.
"""

_ROUNDING = 1e-12  # relative to the extent of the piece: bound on the rounding error of heights, with margin


class Lists(NamedTuple):
    """Lists of mesh pieces (to split, postponed, finished), and counters.

    Rows in ``todo`` and ``ready`` are pieces to split and postponed pieces. ``leaf (n,)`` marks the start of
    finished pieces. ``counts (3,)`` are the numbers of rows in use and the next stamp. ``tally (depths, 3)``
    counts pieces, cells and repaired pieces by depth.
    """

    todo: Any
    ready: Any
    leaf: Any
    counts: Any
    tally: Any


class Limits(NamedTuple):
    """Thresholds that make a piece finished or postponed, and the mass shares of cuts.

    ``diameter`` is h* or 0. ``floor`` is the refinement's floor, negative for no refinement. Pieces with at
    most ``later`` cells are postponed. Connectivity is tested in pieces with more than ``tiny`` cells.
    ``step`` is 1 to count up, −1 to count down. ``shares`` are the lighter side's shares by quota
    (``split.side_shares``).
    """

    diameter: Any
    floor: Any
    later: Any
    tiny: Any
    step: Any
    shares: Any


@helper
def largest_piece(lists):
    """Return the cell count of the largest piece to split."""
    largest = np.int64(0)
    for k in range(lists.counts[0]):
        largest = max(largest, lists.todo[k, STOP] - lists.todo[k, START])
    return largest


@helper
def tag_halves(graph, pieces, lo, hi, candidates, sides):
    """Assign the first half of a piece's cell list to the left side, and the rest to the right.

    This serves if no plane cuts the piece. All cells are candidates.
    """
    cells, tag, measures = pieces.cells, pieces.tag, sides.measures
    left_tag, right_tag = side_tags(lo, hi)
    m, n_right = hi - lo, (hi - lo) // 2
    measures[0], measures[1], sides.counts[0], sides.counts[1] = 0.0, 0.0, m - n_right, n_right
    for k in range(m):
        i = cells[lo + k]
        side = np.int64(k >= m - n_right)
        tag[i], candidates[k] = right_tag if side else left_tag, i
        measures[side] += graph.measures[i]
    return m


@helper
def tag_sides(graph, pieces, lo, hi, heights, bar, unit, extent, candidates, sides):
    """Assign each cell of a piece to a side: right where ``heights`` exceed ``bar``, otherwise left.

    Neither side is empty. Writes measures and cell counts of both ``sides``, and as ``candidates`` the cells
    that may be adjacent to the cut: cells no farther from the cut than from their farthest neighbour, if
    ``unit`` times heights are lengths. Returns the candidate count.
    """
    # 1. Tag each cell, sum both sides, and list the candidates without branches.
    cells, tag, reach, length = pieces.cells, pieces.tag, graph.reach, graph.units.length
    unit, slack = unit * length, _ROUNDING * extent * length
    left_tag, right_tag = side_tags(lo, hi)
    n_right, left_measure, right_measure, m, start = np.int64(0), 0.0, 0.0, np.uint64(0), np.uint64(lo)
    for k in range(np.uint64(hi - lo)):
        i = np.uint32(cells[start + k])
        side, measure = heights[k] > bar, graph.measures[i]
        tag[i] = right_tag if side else left_tag
        right_measure += measure if side else 0.0
        left_measure += 0.0 if side else measure
        n_right += side
        candidates[m] = i
        m += np.uint64(abs(heights[k] - bar) * unit <= reach[i] + slack)
    # 2. If a side is empty, halve the list instead.
    sides.measures[0], sides.measures[1] = left_measure, right_measure
    sides.counts[0], sides.counts[1] = hi - lo - n_right, n_right
    if 0 < n_right < hi - lo:
        return np.int64(m)
    return tag_halves(graph, pieces, lo, hi, candidates, sides)


@helper(allocates=True)
def _shift_off_share(graph, pieces, lo, hi, extent, share, edge, work, candidates, sides):
    """Move the cut of a piece if the lighter side does not yet have its mass share."""
    if holds_share(sides, share):
        return edge
    return shift_cut(graph, pieces, lo, hi, share, candidates, sides)


@helper
def _quota_by_measure(quota, sides, graph, pieces, lo, middle, hi):
    return quota_of_left(quota, sides.measures, middle - lo, hi - middle)


@helper(allocates=True)
def _cut_and_refine(cut, shift, work, graph, pieces, lo, hi, extent, share, sides, floor, workspace, stamp):
    """Bisect the loaded piece, refine the cut, and list the cells along it in the workspace.

    Returns the number of listed cells, and the next stamp.
    """
    # 1. Call the bisector, which aims at halves, or near the leaves at another mass share.
    edge = cut(graph, pieces, lo, hi, extent, work, workspace.boundary, sides)
    if share < 0.5:
        edge = shift(graph, pieces, lo, hi, extent, share, edge, work, workspace.boundary, sides)
    # 2. Keep the candidates adjacent to the other side.
    left_tag, right_tag = side_tags(lo, hi)
    edge = cells_beside(
        graph.indptr, graph.indices, pieces.tag, left_tag, right_tag, workspace.boundary, edge
    )
    if floor < 0.0:
        return edge, stamp
    # 3. Refine along the normal, from the larger to the smaller side.
    sign = 1.0 if sides.measures[1] < sides.measures[0] else -1.0
    for k in range(3):
        sides.normal[k] *= sign
    return refine_sides(graph, pieces, left_tag, right_tag, sides, floor, edge, workspace, stamp)


@helper(allocates=True)
def split_pieces(load, cut, work, graph, shape, pieces, lists, limits, budget):
    """Split mesh pieces as :func:`split_pieces_by` does, by cuts that aim at equal halves.

    If the lighter side must hold less, the cut is moved: a straight cut across the line between the
    centroids.
    """
    split_pieces_by(
        load, cut, _shift_off_share, _quota_by_measure, work, graph, shape, pieces, lists, limits, budget
    )


@helper(allocates=True)
def split_pieces_by(load, cut, shift, divide, work, graph, shape, pieces, lists, limits, budget):
    """Split mesh pieces depth-first until all are finished or postponed (paper, Algorithm 1).

    Ends early after ``budget`` cells, counted once per split, or when the lists are full.

    Parameters
    ----------
    load : helper ``(graph, pieces, lo, hi, work) -> extent``
        Loads the piece ``cells[lo:hi]``; returns its extent along some axis (a lower bound).
    cut : helper ``(graph, pieces, lo, hi, extent, work, candidates, sides) -> int``
        The bisection model M: tags the cells of the loaded piece, and writes the ``sides``, and as
        ``candidates`` the cells that may be adjacent to the cut. Returns the candidate count.
        :func:`tag_sides` does everything except the normal. The helper may write to the second column of the
        marks.
    shift : helper ``(graph, pieces, lo, hi, extent, share, edge, work, candidates, sides) -> int``
        Moves the cut, if necessary, until the lighter side holds a mass ``share`` below 1/2. ``edge`` and the
        result are candidate counts.
    divide : helper ``(quota, sides, graph, pieces, lo, middle, hi) -> int``
        Quota of the left side, ``cells[lo:middle]``.
    work
        Workspace of these helpers.
    graph : PieceGraph
    shape : CellVertices
    pieces : Pieces, changed
    lists : Lists, changed
        The last piece in ``todo`` goes first. Postponed pieces, pieces with more than ``tiny`` cells and a
        disconnected side, and tiny pieces cut from larger pieces go to ``ready``.
    limits : Limits
    budget : int
    """
    # Unpack the fields once: access in the loop would count references for each piece.
    todo, postponed, leaf, counts, tally = lists
    diameter, floor, postponed_size, tiny, step, shares = limits
    cells, measures = pieces.cells, graph.measures
    vertex_offsets, vertices, points = shape
    n_todo, n_postponed, stamp = counts[0], counts[1], counts[2]
    workspace, sides = new_workspace(largest_piece(lists)), new_sides()
    boundary, queue, side_sums = workspace.boundary, workspace.queue, sides.measures
    ends = np.empty((3, graph.centroids.shape[1]))
    while n_todo > 0 and budget > 0 and n_todo + 2 <= len(todo) and n_postponed + 2 <= len(postponed):
        n_todo -= 1
        lo, hi, quota = todo[n_todo, START], todo[n_todo, STOP], todo[n_todo, QUOTA]
        depth, state = todo[n_todo, DEPTH], todo[n_todo, STATE]
        is_postponed, is_torn = hi - lo <= postponed_size, False
        # 1. Finished? A single cell, quota 1, or diam ≤ h*. Extents bound the diameter from below. Only
        #    pieces that pass this bound, then bounds from both sides, are measured exactly.
        finished = quota == 1 or hi - lo == 1
        if state == UNCUT and not (finished or is_postponed):
            extent = load(graph, pieces, lo, hi, work)
            if diameter > 0.0 and extent <= diameter:
                piece = cells[lo:hi]
                narrow = narrowness(piece, shape, diameter, ends)
                if narrow < 0:
                    narrow = not is_wider(piece, vertex_offsets, vertices, points, ends[0], diameter)
                finished = narrow != 0
            # 2. Y ← M(G, X), and adjust the partition. Then test whether both sides are connected, except in
            #    tiny pieces.
            if not finished:
                share = shares[min(quota, len(shares) - 1)]
                edge, stamp = _cut_and_refine(
                    cut, shift, work, graph, pieces, lo, hi, extent, share, sides, floor, workspace, stamp
                )
                stamp += 2
                is_torn = hi - lo > tiny and not sides_connected(
                    graph, pieces, lo, hi, edge, workspace, stamp - 2
                )
        if finished:
            stamp += 1
            apart = hi - lo <= tiny and not is_connected(graph, pieces, lo, hi, queue, stamp)
            leaf[lo] = APART if apart else WHOLE
            continue
        # 3. Torn pieces wait, and are repaired together in one call.
        if is_postponed or is_torn:
            for c in range(STATE):
                postponed[n_postponed, c] = todo[n_todo, c]
            postponed[n_postponed, STATE] = TORN if is_torn else UNCUT
            n_postponed += 1
            continue
        if state == MENDED:
            side_measures(pieces, measures, lo, hi, side_sums)
        # 4. Each side becomes a slice of the cells with its share of the quota.
        middle = part_list(pieces, lo, hi, boundary)
        first = divide(quota, sides, graph, pieces, lo, middle, hi)
        row = min(depth, len(tally) - 1)
        tally[row, 0] += step
        tally[row, 1] += step * (hi - lo)
        tally[row, 2] += state == MENDED
        budget -= hi - lo
        # 5. Push both sides, left side on top.
        todo[n_todo, START], todo[n_todo, STOP], todo[n_todo, QUOTA] = middle, hi, quota - first
        todo[n_todo + 1, START], todo[n_todo + 1, STOP], todo[n_todo + 1, QUOTA] = lo, middle, first
        for k in range(n_todo, n_todo + 2):
            todo[k, DEPTH], todo[k, STATE] = depth + 1, UNCUT
            if todo[k, STOP] - todo[k, START] <= tiny < hi - lo:
                for c in range(COLUMNS):
                    postponed[n_postponed, c] = todo[k, c]
                n_postponed += 1
        n_todo += 2
    counts[0], counts[1], counts[2] = n_todo, n_postponed, stamp
