"""All splits of pieces, in place: what every bisector needs but the cut itself."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper
from agglo_core.compiled.widths import is_wider
from agglo_core.split.piece_refinement import refine_sides
from agglo_core.split.piece_shares import holds_share, shift_cut
from agglo_core.split.piece_splits import (
    cells_beside,
    is_connected,
    narrowness,
    part_list,
    piece_room,
    quota_of_left,
    side_sizes,
    side_tags,
    sides_connected,
)

WHOLE, APART = 1, 2
"""How a finished piece is marked where it starts: APART if it is not connected, of which only tiny ones are
asked."""

UNCUT, TORN, MENDED = 0, 1, 2
"""What was done to a piece that is to be split: nothing; its sides are tagged, and one is not connected; both
were connected since."""

_ROUNDING = 1e-12  # of the extent: what heights in double precision may be off, with room


@helper
def largest_piece(todo, counts):
    """Cells of the largest piece to be split."""
    largest = np.int64(0)
    for k in range(counts[0]):
        largest = max(largest, todo[k, 1] - todo[k, 0])
    return largest


@helper
def tag_halves(cells, lo, hi, tag, measures, near, size, count):
    """Tag both halves of the list of a piece that no plane cuts; returns how many cells are ``near``."""
    left, right = side_tags(lo, hi)
    m, ones = hi - lo, (hi - lo) // 2
    size[0], size[1], count[0], count[1] = 0.0, 0.0, m - ones, ones
    for k in range(m):
        i = cells[lo + k]
        side = np.int64(k >= m - ones)
        tag[i], near[k] = right if side else left, i
        size[side] += measures[i]
    return m


@helper
def tag_sides(graph, cells, lo, hi, heights, bar, unit, extent, tag, near, sums):
    """Tag the cells of a piece: right where ``heights`` exceed ``bar``, left elsewhere; both sides get some.

    Writes measures and cells of both sides to ``sums``, and the cells that may be beside the cut to ``near``:
    those no further from it than their neighbours are from them, if ``unit`` times heights are lengths.
    Returns how many.
    """
    measures, reach, length = graph[4], graph[6], graph[7][0]
    size, count, _ = sums
    unit, extent = unit * length, _ROUNDING * extent * length
    left, right = side_tags(lo, hi)
    ones, below, above, m, start = np.int64(0), 0.0, 0.0, np.uint64(0), np.uint64(lo)
    for k in range(np.uint64(hi - lo)):
        i = np.uint32(cells[start + k])
        side, measure = heights[k] > bar, measures[i]
        tag[i] = right if side else left
        above += measure if side else 0.0
        below += 0.0 if side else measure
        ones += side
        near[m] = i
        m += np.uint64(abs(heights[k] - bar) * unit <= reach[i] + extent)
    size[0], size[1], count[0], count[1] = below, above, hi - lo - ones, ones
    if 0 < ones < hi - lo:
        return np.int64(m)
    return tag_halves(cells, lo, hi, tag, measures, near, size, count)


@helper(allocates=True)
def _to_share(graph, cells, lo, hi, extent, share, edge, own, tag, near, sums):
    """Move the cut of a piece, of which ``edge`` cells are ``near``, if it is off a share below 1/2."""
    if holds_share(sums[0], share):
        return edge
    return shift_cut(graph, cells, lo, hi, tag, share, near, sums)


@helper
def _left_quota(quota, size, measures, cells, lo, middle, hi):
    """Parts that the left side of a piece becomes."""
    return quota_of_left(quota, size, middle - lo, hi - middle)


@helper(allocates=True)
def _sides(cut, shift, own, graph, cells, lo, hi, extent, share, tag, marks, sums, floor, room, stamp):
    """Cut a piece, move the cut to a ``share`` below 1/2, and refine the sides.

    Returns the cells along the cut, and the next stamp.
    """
    indptr, indices, interface, centroids, measures, _, _, _ = graph
    size, count, axis = sums
    edge = cut(graph, cells, lo, hi, extent, own, tag, marks, room[0], sums)
    if share < 0.5:
        edge = shift(graph, cells, lo, hi, extent, share, edge, own, tag, room[0], sums)
    left, right = side_tags(lo, hi)
    edge = cells_beside(indptr, indices, tag, left, right, room[0], edge)
    if floor < 0.0:
        return edge, stamp
    sign = 1.0 if size[1] < size[0] else -1.0
    for k in range(3):
        axis[k] *= sign
    structure, sides = (indptr, indices, interface), (size, count)
    return refine_sides(
        structure, centroids, measures, tag, left, right, axis, sides, floor, edge, room, stamp
    )


@helper(allocates=True)
def split_pieces(
    load, cut, own, graph, shape, cells, tag, marks, todo, ready, leaf, counts, tally, goal, work
):
    """Split pieces as :func:`split_pieces_by` does, with cuts that aim at halves.

    Where the lighter side is to hold less, the cut is moved, straight across the line between the centroids.
    """
    split_pieces_by(
        load,
        cut,
        _to_share,
        _left_quota,
        own,
        graph,
        shape,
        cells,
        tag,
        marks,
        todo,
        ready,
        leaf,
        counts,
        tally,
        goal,
        work,
    )


@helper(allocates=True)
def split_pieces_by(
    load,
    cut,
    shift,
    divide,
    own,
    graph,
    shape,
    cells,
    tag,
    marks,
    todo,
    ready,
    leaf,
    counts,
    tally,
    goal,
    work,
):
    """Split pieces, the last in ``todo`` first, until ``work`` cells were handled or no room is left.

    Parameters
    ----------
    load : helper ``(graph, cells, lo, hi, own) -> extent``
        Looks at the piece ``cells[lo:hi]`` and returns its extent along some axis, or any less.
    cut : helper ``(graph, cells, lo, hi, extent, own, tag, marks, near, sums) -> int``
        Tags the cells of the piece that was loaded, writes measures and cells of both sides and the normal of
        the cut (3 numbers) to ``sums``, and to ``near`` the cells that may be beside the cut: returns how
        many. :func:`tag_sides` does all but the normal. The second column of the marks may be written to.
    shift : helper ``(graph, cells, lo, hi, extent, share, edge, own, tag, near, sums) -> int``
        Moves the cut until the lighter side holds a ``share`` of the mass below 1/2, if it does not; ``edge``
        cells are ``near``. Writes and returns what ``cut`` does.
    divide : helper ``(quota, size, measures, cells, lo, middle, hi) -> int``
        Parts that the left side ``cells[lo:middle]`` becomes, if the ``size`` of both sides are measures.
    own : tuple
        What these helpers work with.
    cells, tag, marks
        The list of cells, of which each piece is a slice: see ``piece_splits``.
    todo, ready : (K, 5) int
        Rows of pieces: first place, last place plus 1, quota (0 for a size), depth, what was done to it.
        Those of at most ``later`` cells, and those of more than ``tiny`` of which a side is not connected, go
        to ``ready`` instead; tiny pieces of larger ones are listed there, too.
    leaf : (n,) uint8
        Marks where finished pieces start: 1, or 2 if one is not connected.
    counts : (3,) int
        Rows of ``todo`` and ``ready`` in use, and the next stamp.
    tally : (depths, 3) int
        Counts pieces, cells and mended pieces by depth.
    goal : tuple
        Largest diameter or 0; floor of the refinement or −1; later; tiny; 1 to count, −1 to count backwards;
        share of the mass for the lighter side of a piece, by quota (see ``graph.side_shares``).
    """
    indptr, indices, _, _, measures, _, _, _ = graph
    limit, floor, later, tiny, one, shares = goal
    waiting, listed, stamp = counts[0], counts[1], counts[2]
    room, size = piece_room(largest_piece(todo, counts), marks), np.empty(2)
    ends = np.empty((3, graph[3].shape[1]))
    sums = (size, np.empty(2, np.int64), np.empty(3))
    while waiting > 0 and work > 0 and waiting + 2 <= len(todo) and listed + 2 <= len(ready):
        waiting -= 1
        lo, hi, quota, depth = todo[waiting, 0], todo[waiting, 1], todo[waiting, 2], todo[waiting, 3]
        state, put_off, torn = todo[waiting, 4], hi - lo <= later, False
        finished = quota == 1 or hi - lo == 1
        if state == UNCUT and not (finished or put_off):
            extent = load(graph, cells, lo, hi, own)
            if limit > 0.0 and extent <= limit:
                narrow = narrowness(cells, lo, hi, shape, limit, ends)
                if narrow < 0:
                    narrow = not is_wider(cells[lo:hi], shape[0], shape[1], shape[2], ends[0], limit)
                finished = narrow != 0
            if not finished:
                share = shares[min(quota, len(shares) - 1)]
                edge, stamp = _sides(
                    cut, shift, own, graph, cells, lo, hi, extent, share, tag, marks, sums, floor, room, stamp
                )
                stamp += 2
                torn = hi - lo > tiny and not sides_connected(
                    indptr, indices, tag, lo, hi, edge, room, stamp - 2
                )
        if finished:
            stamp += 1
            apart = hi - lo <= tiny and not is_connected(
                indptr, indices, cells, lo, hi, tag, room[3], marks, stamp
            )
            leaf[lo] = APART if apart else WHOLE
            continue
        if put_off or torn:
            for k in range(4):
                ready[listed, k] = todo[waiting, k]
            ready[listed, 4] = TORN if torn else UNCUT
            listed += 1
            continue
        if state == MENDED:
            side_sizes(tag, measures, cells, lo, hi, size)
        row = min(depth, len(tally) - 1)
        tally[row, 2] += state == MENDED
        middle = part_list(tag, cells, lo, hi, room[0])
        first = divide(quota, size, measures, cells, lo, middle, hi)
        tally[row, 0] += one
        tally[row, 1] += one * (hi - lo)
        work -= hi - lo
        todo[waiting, 0], todo[waiting, 1], todo[waiting, 2] = middle, hi, quota - first
        todo[waiting + 1, 0], todo[waiting + 1, 1], todo[waiting + 1, 2] = lo, middle, first
        for k in range(waiting, waiting + 2):
            todo[k, 3], todo[k, 4] = depth + 1, UNCUT
            if todo[k, 1] - todo[k, 0] <= tiny < hi - lo:
                for c in range(5):
                    ready[listed, c] = todo[k, c]
                listed += 1
        waiting += 2
    counts[0], counts[1], counts[2] = waiting, listed, stamp
