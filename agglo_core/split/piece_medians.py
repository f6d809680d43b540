"""Pieces halved by weight across their principal axis or their longest side, as blocks are depth by depth."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.compiled.sums import chosen_sum
from agglo_core.split.ordered_frames import centre_in_order, frame_in_order, frame_room
from agglo_core.split.piece_driver import largest_piece, split_pieces, split_pieces_by
from agglo_core.split.piece_shares import order_room, split_in_order, tag_upper

_TIE = 1e-7  # of the longest side: sides no shorter than it by more count as equal, as in ``graph.blocks``
_ROUNDING = 1e-12  # of the extent: what heights in double precision may be off, with room


@helper
def _load_positions(graph, cells, lo, hi, local, weight, extents):
    """Copy positions, weights and the extents of the centroids; returns the largest extent."""
    centroids, weights = graph[3], graph[5]
    largest, start, n = 0.0, np.uint64(lo), np.uint64(hi - lo)
    for k in range(n):
        weight[k] = weights[np.uint32(cells[start + k])]
    for c in range(centroids.shape[1]):
        low, high = np.inf, -np.inf
        for k in range(n):
            x = centroids[np.uint32(cells[start + k]), c]
            local[c, k] = x
            low, high = min(low, x), max(high, x)
        extents[c] = high - low
        largest = max(largest, extents[c])
    return largest


# --- across the principal axis ----------------------------------------------------------------------------


@helper
def _load_frame(graph, cells, lo, hi, own):
    (local, weight, _, _, _, values), _ = own
    return _load_positions(graph, cells, lo, hi, local, weight, values)


@helper(allocates=True)
def _cut_across_axis(graph, cells, lo, hi, extent, own, tag, marks, near, sums):
    frame, room = own
    local, weight, along, _, _, _ = frame
    n, d = hi - lo, graph[3].shape[1]
    centre_in_order(n, d, local, weight)
    frame_in_order(n, d, frame)
    bar, slack = split_in_order(n, d, along, 0, weight, 0.5, room)
    slack += _ROUNDING * extent
    return tag_upper(graph, cells, lo, hi, room[1], along[0], bar, slack, tag, near, sums)


@kernel
def split_across_axes(graph, shape, cells, tag, marks, todo, ready, leaf, counts, tally, goal, work):
    """Split pieces, the last in ``todo`` first; the arguments are those of ``PieceGrowth``."""
    m = largest_piece(todo, counts)
    own = frame_room(m), order_room(m)
    split_pieces(
        _load_frame,
        _cut_across_axis,
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


# --- across the longest side of the box -------------------------------------------------------------------


@helper(allocates=True)
def _box_room(m):
    """Work arrays for pieces of at most m cells: positions (3, m), weights, extents (3,), and their order."""
    return np.empty((3, m)), np.empty(m), np.empty(3), order_room(m)


@helper
def _load_box(graph, cells, lo, hi, own):
    local, weight, extents, _ = own
    return _load_positions(graph, cells, lo, hi, local, weight, extents)


@helper(allocates=True)
def _cut_box_at(graph, cells, lo, hi, extent, share, own, tag, near, sums):
    """Cut at a share of what ``weight`` holds, across the first of the longest sides."""
    local, weight, extents, room = own
    n, d, axis, total = hi - lo, graph[3].shape[1], 0, 0.0
    while extents[axis] < (1.0 - _TIE) * extent:
        axis += 1
    for k in range(n):
        total += weight[k]
    for k in range(n):
        weight[k] = weight[k] / total if total > 0.0 else 1.0 / n
    bar, slack = split_in_order(n, d, local, axis, weight, share, room)
    slack += _ROUNDING * extent
    return tag_upper(graph, cells, lo, hi, room[1], local[axis], bar, slack, tag, near, sums)


@helper(allocates=True)
def _cut_box(graph, cells, lo, hi, extent, own, tag, marks, near, sums):
    return _cut_box_at(graph, cells, lo, hi, extent, 0.5, own, tag, near, sums)


@helper(allocates=True)
def _cut_box_by_mass(graph, cells, lo, hi, extent, share, edge, own, tag, near, sums):
    """Cut at a share of the mass in place of half the weight."""
    measures, weight = graph[4], own[1]
    for k in range(hi - lo):
        weight[k] = measures[cells[lo + k]]
    return _cut_box_at(graph, cells, lo, hi, extent, share, own, tag, near, sums)


@helper
def _first_quota(quota, size, measures, cells, lo, middle, hi):
    """Parts that the left side becomes: ``goals.split_quotas``, with the sums that it is given."""
    if quota == 0:
        return 0
    left, right = chosen_sum(measures, cells, lo, middle), chosen_sum(measures, cells, middle, hi)
    if not left + right > 0.0:
        left, right = float(middle - lo), float(hi - middle)
    least, most = max(1.0, quota - (hi - middle)), min(quota - 1.0, float(middle - lo))
    return np.int64(min(max(np.rint(quota * (left / (left + right))), least), most))


@kernel
def split_across_boxes(graph, shape, cells, tag, marks, todo, ready, leaf, counts, tally, goal, work):
    """Split pieces, the last in ``todo`` first; the arguments are those of ``PieceGrowth``."""
    own = _box_room(largest_piece(todo, counts))
    split_pieces_by(
        _load_box,
        _cut_box,
        _cut_box_by_mass,
        _first_quota,
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
