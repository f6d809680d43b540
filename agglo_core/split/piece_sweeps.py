"""Recursive bisection by sweeps: cut each piece at the cheapest threshold along several axes."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel
from agglo_core.compiled.frames import half_circle, halvings
from agglo_core.compiled.thresholds import NO_CUT, axes_block, bar_of, sweep_block, thresholds_between
from agglo_core.split.piece_driver import START, STOP, largest_piece, split_pieces, tag_sides
from agglo_core.split.piece_frames import load_piece, new_points, principal_frame
from agglo_core.split.piece_splits import side_tags


class Scores(NamedTuple):
    """Heights of a piece's cells along an axis ``(m,)``, their bins, and sums over the bins ``(32, 5)``.

    ``edges`` are the tails, heads and lengths of the edges inside the piece.
    """

    heights: Any
    bins: Any
    tally: Any
    edges: Any


class SweepWork(NamedTuple):
    """Workspace to search for the best straight cut along several axes.

    ``turns`` and ``finer`` are the cosines and sines of the axes in 2-D, ``frame (3, 3)`` is the piece's
    frame in 3-D.
    """

    points: Any
    scores: Any
    turns: Any
    finer: Any
    frame: Any


@helper
def most_edges(lists, cells, indptr):
    """Return an upper bound on the edge count inside any piece."""
    todo, most = lists.todo, np.int64(0)
    for k in range(lists.counts[0]):
        ends = np.int64(0)
        for c in range(todo[k, START], todo[k, STOP]):
            ends += indptr[cells[c] + 1] - indptr[cells[c]]
        most = max(most, ends)
    return most // 2 + 1


@helper(allocates=True)
def new_scores(m, edges):
    """Allocate ``Scores`` for pieces with at most m cells and ``edges`` edges."""
    ends = np.empty(edges, np.int32), np.empty(edges, np.int32), np.empty(edges)
    return Scores(np.empty(m), np.empty(m, np.int32), np.zeros((32, 5)), ends)


@helper
def edges_of_piece(graph, pieces, lo, hi, edges):
    """List each edge inside a piece once, with its cells numbered locally, and return the edge count.

    All cells get the tag of the left side, and their local numbers in the second column of the marks.
    """
    indptr, indices, interface = graph.indptr, graph.indices, graph.interface
    cells, tag, marks = pieces
    tails, heads, lengths = edges
    left_tag, _ = side_tags(lo, hi)
    start, n, count = np.uint64(lo), np.uint64(hi - lo), np.uint64(0)
    # 1. Tags and local numbers.
    for k in range(n):
        tag[np.uint32(cells[start + k])], marks[np.uint32(cells[start + k]), 1] = left_tag, k
    # 2. Edges to a higher-numbered cell in the piece. All edges are written, and invalid edges are
    #    overwritten by the next edge.
    for k in range(n):
        i = np.uint64(np.uint32(cells[start + k]))
        for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
            j = np.uint32(indices[h])
            tails[count], heads[count], lengths[count] = k, marks[j, 1], interface[h]
            count += np.uint64((tag[j] == left_tag) & (j > i))  # no branch: it would be mispredicted
    return np.int64(count)


@helper(reorder_sums=True)
def _project_in_space(n, a, b, c, x, y, z, shares, score):
    """Write ``score = a x + b y + c z``, and return its extremes and standard deviation."""
    low, high, square = np.inf, -np.inf, 0.0
    for i in range(n):
        score[i] = a * x[i] + b * y[i] + c * z[i]
        low, high = min(low, score[i]), max(high, score[i])
        square += shares[i] * score[i] * score[i]
    return low, high, np.sqrt(square)


@helper
def _frame_block(n, edges, local, shares, scales, frame, axis, score, bins, tally):
    """Find the cheapest cut in 3-D along the axes of a frame and its four space diagonals.

    Writes the best direction to ``axis`` and the heights along it to ``score``. Returns cost, last bin below,
    lowest threshold and thresholds per unit. The arguments follow ``axes_block``.
    """
    best, best_direction = (NO_CUT, 0, 0.0, 0.0), 0
    x, y, z, third = local[0], local[1], local[2], np.sqrt(1.0 / 3.0)
    for c in range(8):
        # 1. Direction d in the frame: axis 0, 1 or 2, or a diagonal (1, ±1, ±1) / √3.
        d, a0, a1, a2 = c if c < 7 else best_direction, third, third, third
        if d < 3:
            a0, a1, a2 = np.float64(d == 0), np.float64(d == 1), np.float64(d == 2)
        else:
            a1 -= 2.0 * third * ((d - 3) >> 1)
            a2 -= 2.0 * third * ((d - 3) & 1)
        for k in range(3):
            axis[k] = a0 * frame[0, k] + a1 * frame[1, k] + a2 * frame[2, k]
        low, high, spread = _project_in_space(n, axis[0], axis[1], axis[2], x, y, z, shares, score)
        if c == 7:
            break  # the last round only restores the heights along the best direction
        # 2. The cheapest threshold along this direction must improve the cost by more than rounding.
        low, rate = thresholds_between(low, high, spread)
        cost, last = sweep_block(n, low, rate, score, edges, local, shares, scales, bins, tally)
        if cost < best[0] - 1e-9 * abs(best[0]):
            best, best_direction = (cost, last, low, rate), c
    return best


@helper(allocates=True)
def _cut(graph, pieces, lo, hi, extent, work, candidates, sides):
    """Bisect the loaded piece at the cheapest threshold: the ``cut`` of ``piece_driver.split_pieces_by``."""
    (local, shares, section), (heights, bins, tally, ends), turns, finer, frame = work
    # 1. Edges inside the piece.
    n, normal, scales = hi - lo, sides.normal, (section[0], section[1], section[2])
    edges = ends, edges_of_piece(graph, pieces, lo, hi, ends)
    # 2. The cheapest cut along all axes.
    if graph.centroids.shape[1] == 2:
        best, p, q = axes_block(n, edges, local, shares, scales, turns, finer, heights, bins, tally)
        normal[0], normal[1], normal[2] = p, q, 0.0
    else:
        principal_frame(n, False, local, shares, frame)
        best = _frame_block(n, edges, local, shares, scales, frame, normal, heights, bins, tally)
    # 3. Tags and candidates.
    return tag_sides(graph, pieces, lo, hi, heights, bar_of(best), 1.0, extent, candidates, sides)


@kernel
def split_along_axes(axes, graph, shape, pieces, lists, limits, budget):
    """Bisect mesh pieces by sweeps, in 2-D along ``axes`` axes: see ``piece_driver.split_pieces_by``."""
    m = largest_piece(lists)
    scores = new_scores(m, most_edges(lists, pieces.cells, graph.indptr))
    work = SweepWork(new_points(m), scores, half_circle(axes), halvings(axes, 0), np.empty((3, 3)))
    split_pieces(load_piece, _cut, work, graph, shape, pieces, lists, limits, budget)
