"""The recursion of all bisectors: pieces are cut, refined, tested and parted in place.

A bisector gives two helpers, one that loads a piece and one that cuts it; all else happens here.
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
"""Columns of lists of pieces: the slice of cells, the parts wanted (0 for a size), the depth, and what was
done to the piece; and how many columns there are."""

UNCUT, TORN, MENDED = 0, 1, 2
"""States of a piece that is to be split: nothing was done; its sides are tagged, and one is not connected;
both were connected since."""

WHOLE, APART = 1, 2
"""How a finished piece is marked where it starts: APART if it is not connected, which is tested for tiny
pieces alone."""

_ROUNDING = 1e-12  # of the extent: bound of the error of heights in double precision, with a margin


class Lists(NamedTuple):
    """Lists of pieces, and counts, that change as pieces are split.

    Rows of ``todo`` and ``ready`` are pieces still to be split and pieces put off, ``leaf (n,)`` marks where
    finished pieces start, ``counts (3,)`` are the rows in use and the next stamp, and ``tally (depths, 3)``
    counts pieces, cells and mended pieces by depth.
    """

    todo: Any
    ready: Any
    leaf: Any
    counts: Any
    tally: Any


class Limits(NamedTuple):
    """Limits: when pieces are finished or put off, and at which shares they are cut.

    ``diameter`` is h* or 0; ``floor`` that of the refinement, negative for none. Pieces of at most ``later``
    cells are put off; connections are tested in those of more than ``tiny``. ``step`` is 1 to count, −1 to
    count backwards. ``shares`` are those of the lighter side, by quota (``split.side_shares``).
    """

    diameter: Any
    floor: Any
    later: Any
    tiny: Any
    step: Any
    shares: Any


@helper
def largest_piece(lists):
    """Return the number of cells of the largest piece to be split."""
    largest = np.int64(0)
    for k in range(lists.counts[0]):
        largest = max(largest, lists.todo[k, STOP] - lists.todo[k, START])
    return largest


@helper
def tag_halves(graph, pieces, lo, hi, candidates, sides):
    """Tag both halves of the list of a piece that no plane cuts; all its cells are candidates."""
    cells, tag, measures = pieces.cells, pieces.tag, sides.measures
    left, right = side_tags(lo, hi)
    m, ones = hi - lo, (hi - lo) // 2
    measures[0], measures[1], sides.counts[0], sides.counts[1] = 0.0, 0.0, m - ones, ones
    for k in range(m):
        i = cells[lo + k]
        side = np.int64(k >= m - ones)
        tag[i], candidates[k] = right if side else left, i
        measures[side] += graph.measures[i]
    return m


@helper
def tag_sides(graph, pieces, lo, hi, heights, bar, unit, extent, candidates, sides):
    """Tag the cells of a piece: right where ``heights`` exceed ``bar``, left elsewhere; both sides get some.

    Writes measures and numbers of cells of both ``sides``, and as ``candidates`` the cells that may be
    adjacent to the cut: those no further from it than their neighbours are from them, if ``unit`` times
    heights are lengths. Returns how many.
    """
    cells, tag, reach, length = pieces.cells, pieces.tag, graph.reach, graph.units.length
    unit, slack = unit * length, _ROUNDING * extent * length
    left, right = side_tags(lo, hi)
    ones, below, above, m, start = np.int64(0), 0.0, 0.0, np.uint64(0), np.uint64(lo)
    for k in range(np.uint64(hi - lo)):
        i = np.uint32(cells[start + k])
        side, measure = heights[k] > bar, graph.measures[i]
        tag[i] = right if side else left
        above += measure if side else 0.0
        below += 0.0 if side else measure
        ones += side
        candidates[m] = i
        m += np.uint64(abs(heights[k] - bar) * unit <= reach[i] + slack)
    sides.measures[0], sides.measures[1] = below, above
    sides.counts[0], sides.counts[1] = hi - lo - ones, ones
    if 0 < ones < hi - lo:
        return np.int64(m)
    return tag_halves(graph, pieces, lo, hi, candidates, sides)


@helper(allocates=True)
def _shift_off_share(graph, pieces, lo, hi, extent, share, edge, work, candidates, sides):
    """Move the cut of a piece unless the lighter side holds the share already."""
    if holds_share(sides, share):
        return edge
    return shift_cut(graph, pieces, lo, hi, share, candidates, sides)


@helper
def _quota_by_measure(quota, sides, graph, pieces, lo, middle, hi):
    return quota_of_left(quota, sides.measures, middle - lo, hi - middle)


@helper(allocates=True)
def _cut_and_refine(cut, shift, work, graph, pieces, lo, hi, extent, share, sides, floor, workspace, stamp):
    """Tag the sides of a piece that is loaded; the boundary of the workspace lists cells along the cut.

    Returns how many, and the next stamp.
    """
    # 1. The cut of the bisector, which aims at halves or, near the leaves, at another share of the mass.
    edge = cut(graph, pieces, lo, hi, extent, work, workspace.boundary, sides)
    if share < 0.5:
        edge = shift(graph, pieces, lo, hi, extent, share, edge, work, workspace.boundary, sides)
    # 2. Of the candidates, the cells adjacent to the other side.
    left, right = side_tags(lo, hi)
    edge = cells_beside(graph.indptr, graph.indices, pieces.tag, left, right, workspace.boundary, edge)
    if floor < 0.0:
        return edge, stamp
    # 3. The refinement goes through cells along the normal, from the larger to the smaller side.
    sign = 1.0 if sides.measures[1] < sides.measures[0] else -1.0
    for k in range(3):
        sides.normal[k] *= sign
    return refine_sides(graph, pieces, left, right, sides, floor, edge, workspace, stamp)


@helper(allocates=True)
def split_pieces(load, cut, work, graph, shape, pieces, lists, limits, budget):
    """Split pieces as :func:`split_pieces_by` does, by cuts that aim at halves.

    Where the lighter side is to hold less, the cut is moved, straight across the line between the centroids.
    """
    split_pieces_by(
        load, cut, _shift_off_share, _quota_by_measure, work, graph, shape, pieces, lists, limits, budget
    )


@helper(allocates=True)
def split_pieces_by(load, cut, shift, divide, work, graph, shape, pieces, lists, limits, budget):
    """Split pieces until all are finished or put off, depth first (paper, Algorithm 1).

    Ends early once ``budget`` cells were handled, each once for every split, or the lists are full.

    Parameters
    ----------
    load : helper ``(graph, pieces, lo, hi, work) -> extent``
        Looks at the piece ``cells[lo:hi]``; returns its extent along some axis (a lower bound serves).
    cut : helper ``(graph, pieces, lo, hi, extent, work, candidates, sides) -> int``
        The bisection model M: tags the cells of the piece that was loaded, writes the ``sides``, and as
        ``candidates`` the cells that may be adjacent to the cut; returns how many. :func:`tag_sides` does all
        but the normal. The second column of the marks may be written to.
    shift : helper ``(graph, pieces, lo, hi, extent, share, edge, work, candidates, sides) -> int``
        Moves the cut until the lighter side holds a ``share`` of the mass below 1/2, if it does not. ``edge``
        and the result are numbers of candidates.
    divide : helper ``(quota, sides, graph, pieces, lo, middle, hi) -> int``
        Quota of the left side, ``cells[lo:middle]``.
    work
        Anything that these helpers share.
    graph : PieceGraph
    shape : CellVertices
    pieces : Pieces, changed
    lists : Lists, changed
        The last piece of ``todo`` goes first. Pieces put off, those of more than ``tiny`` cells of which a
        side is not connected, and tiny pieces of larger ones go to ``ready``.
    limits : Limits
    budget : int
    """
    # Fields that are read for each piece: taken once, or their references would be counted each time.
    todo, ready, leaf, counts, tally = lists
    diameter, floor, later, tiny, step, shares = limits
    cells, measures = pieces.cells, graph.measures
    vertex_offsets, vertices, points = shape
    waiting, listed, stamp = counts[0], counts[1], counts[2]
    workspace, sides = new_workspace(largest_piece(lists)), new_sides()
    boundary, queue, side_sums = workspace.boundary, workspace.queue, sides.measures
    ends = np.empty((3, graph.centroids.shape[1]))
    while waiting > 0 and budget > 0 and waiting + 2 <= len(todo) and listed + 2 <= len(ready):
        waiting -= 1
        lo, hi, quota = todo[waiting, START], todo[waiting, STOP], todo[waiting, QUOTA]
        depth, state = todo[waiting, DEPTH], todo[waiting, STATE]
        put_off, torn = hi - lo <= later, False
        # 1. Finished? A single cell, one part wanted, or diam ≤ h*. Extents bound the diameter from below:
        #    only pieces that pass them, then bounds from both sides, are measured exactly.
        finished = quota == 1 or hi - lo == 1
        if state == UNCUT and not (finished or put_off):
            extent = load(graph, pieces, lo, hi, work)
            if diameter > 0.0 and extent <= diameter:
                piece = cells[lo:hi]
                narrow = narrowness(piece, shape, diameter, ends)
                if narrow < 0:
                    narrow = not is_wider(piece, vertex_offsets, vertices, points, ends[0], diameter)
                finished = narrow != 0
            # 2. Y ← M(G, X), and the partition is adjusted. Both sides connected? Tiny pieces are not tested.
            if not finished:
                share = shares[min(quota, len(shares) - 1)]
                edge, stamp = _cut_and_refine(
                    cut, shift, work, graph, pieces, lo, hi, extent, share, sides, floor, workspace, stamp
                )
                stamp += 2
                torn = hi - lo > tiny and not sides_connected(
                    graph, pieces, lo, hi, edge, workspace, stamp - 2
                )
        if finished:
            stamp += 1
            apart = hi - lo <= tiny and not is_connected(graph, pieces, lo, hi, queue, stamp)
            leaf[lo] = APART if apart else WHOLE
            continue
        # 3. Torn pieces wait: all of them are mended in one call.
        if put_off or torn:
            for c in range(STATE):
                ready[listed, c] = todo[waiting, c]
            ready[listed, STATE] = TORN if torn else UNCUT
            listed += 1
            continue
        if state == MENDED:
            side_measures(pieces, measures, lo, hi, side_sums)
        # 4. Each side becomes a slice of the cells and gets its share of the quota.
        middle = part_list(pieces, lo, hi, boundary)
        first = divide(quota, sides, graph, pieces, lo, middle, hi)
        row = min(depth, len(tally) - 1)
        tally[row, 0] += step
        tally[row, 1] += step * (hi - lo)
        tally[row, 2] += state == MENDED
        budget -= hi - lo
        # 5. Both sides are pieces to be split, the left one next.
        todo[waiting, START], todo[waiting, STOP], todo[waiting, QUOTA] = middle, hi, quota - first
        todo[waiting + 1, START], todo[waiting + 1, STOP], todo[waiting + 1, QUOTA] = lo, middle, first
        for k in range(waiting, waiting + 2):
            todo[k, DEPTH], todo[k, STATE] = depth + 1, UNCUT
            if todo[k, STOP] - todo[k, START] <= tiny < hi - lo:
                for c in range(COLUMNS):
                    ready[listed, c] = todo[k, c]
                listed += 1
        waiting += 2
    counts[0], counts[1], counts[2] = waiting, listed, stamp
