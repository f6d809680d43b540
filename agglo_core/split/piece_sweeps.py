"""Pieces cut where it costs least, along several axes, again and again."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.axes import half_circle, halvings
from agglo_core.compiled.compiling import ONE, helper, kernel
from agglo_core.compiled.thresholds import NO_CUT, axes_block, bar_of, sweep_block, thresholds_between
from agglo_core.split.piece_driver import largest_piece, split_pieces, tag_sides
from agglo_core.split.piece_frames import load_piece, point_room, principal_frame
from agglo_core.split.piece_splits import side_tags


@helper
def most_edges(todo, counts, cells, indptr):
    """An upper bound of the edges inside any of the pieces."""
    most = np.int64(0)
    for k in range(counts[0]):
        ends = np.int64(0)
        for c in range(todo[k, 0], todo[k, 1]):
            ends += indptr[cells[c] + 1] - indptr[cells[c]]
        most = max(most, ends)
    return most // 2 + 1


@helper(allocates=True)
def score_room(m, edges):
    """Work arrays of the sweeps: scores, bins, their tally; ends and lengths of edges."""
    ends = np.empty(edges, np.int32), np.empty(edges, np.int32), np.empty(edges)
    return np.empty(m), np.empty(m, np.int32), np.zeros((32, 5)), ends


@helper
def edges_of_piece(graph, cells, lo, hi, tag, marks, room):
    """Write each edge inside a piece once, its ends numbered within the piece; returns how many.

    The cells are tagged as on the left, and their numbers in the second column of the marks.
    """
    indptr, indices, interface, _, _, _, _, _ = graph
    tails, heads, lengths = room
    own, _ = side_tags(lo, hi)
    start, n, count = np.uint64(lo), np.uint64(hi - lo), np.uint64(0)
    for k in range(n):
        tag[np.uint32(cells[start + k])], marks[np.uint32(cells[start + k]), 1] = own, k
    for k in range(n):
        i = np.uint64(np.uint32(cells[start + k]))
        for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
            j = np.uint32(indices[h])
            tails[count], heads[count], lengths[count] = k, marks[j, 1], interface[h]
            count += np.uint64((tag[j] == own) & (j > i))  # no branch: it would be mispredicted
    return np.int64(count)


@helper(reorder_sums=True)
def _project_in_space(n, a, b, c, x, y, z, shares, score):
    """Fill ``score = a x + b y + c z``; returns its extremes and standard deviation."""
    low, high, square = np.inf, -np.inf, 0.0
    for i in range(n):
        score[i] = a * x[i] + b * y[i] + c * z[i]
        low, high = min(low, score[i]), max(high, score[i])
        square += shares[i] * score[i] * score[i]
    return low, high, np.sqrt(square)


@helper
def _frame_block(n, edges, local, shares, scales, frame, axis, score, bins, tally):
    """As ``axes_block`` does, in space, along the axes of a frame and the four diagonals of its cube.

    Writes the best direction to ``axis``, and returns cost, last bin below, lowest threshold and thresholds
    per unit.
    """
    best, chosen = (NO_CUT, 0, 0.0, 0.0), 0
    x, y, z, third = local[0], local[1], local[2], np.sqrt(1.0 / 3.0)
    for c in range(8):
        d, a0, a1, a2 = c if c < 7 else chosen, third, third, third
        if d < 3:
            a0, a1, a2 = np.float64(d == 0), np.float64(d == 1), np.float64(d == 2)
        else:
            a1 -= 2.0 * third * ((d - 3) >> 1)
            a2 -= 2.0 * third * ((d - 3) & 1)
        for k in range(3):
            axis[k] = a0 * frame[0, k] + a1 * frame[1, k] + a2 * frame[2, k]
        low, high, spread = _project_in_space(n, axis[0], axis[1], axis[2], x, y, z, shares, score)
        if c == 7:
            break  # the best one, once more
        low, rate = thresholds_between(low, high, spread)
        cost, last = sweep_block(n, low, rate, score, edges, local, shares, scales, bins, tally)
        if cost < best[0] - 1e-9 * abs(best[0]):
            best, chosen = (cost, last, low, rate), c
    return best


@helper(allocates=True)
def _cut(graph, cells, lo, hi, extent, own, tag, marks, near, sums):
    (local, shares, section), (score, bins, tally, ends), (turns, finer, frame) = own
    n, axis, scales = hi - lo, sums[2], (section[0], section[1], section[2])
    edges = ends, edges_of_piece(graph, cells, lo, hi, tag, marks, ends)
    if graph[3].shape[1] == 2:
        best, p, q = axes_block(n, edges, local, shares, scales, turns, finer, score, bins, tally)
        axis[0], axis[1], axis[2] = p, q, 0.0
    else:
        principal_frame(n, False, local, shares, frame)
        best = _frame_block(n, edges, local, shares, scales, frame, axis, score, bins, tally)
    return tag_sides(graph, cells, lo, hi, score, bar_of(best), 1.0, extent, tag, near, sums)


@kernel
def split_along_axes(axes, graph, shape, cells, tag, marks, todo, ready, leaf, counts, tally, goal, work):
    """Split pieces, the last in ``todo`` first; the arguments but the first are those of ``PieceGrowth``.

    In the plane so many axes are tried.
    """
    m, directions = largest_piece(todo, counts), (half_circle(axes), halvings(axes, 0), np.empty((3, 3)))
    own = point_room(m), score_room(m, most_edges(todo, counts, cells, graph[0])), directions
    split_pieces(
        load_piece, _cut, own, graph, shape, cells, tag, marks, todo, ready, leaf, counts, tally, goal, work
    )
