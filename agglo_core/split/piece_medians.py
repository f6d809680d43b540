"""Pieces halved by weight across their principal axis, again and again, as blocks are depth by depth."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.split.ordered_frames import centre_in_order, frame_in_order, frame_room
from agglo_core.split.piece_driver import largest_piece, split_pieces
from agglo_core.split.piece_shares import order_room, split_in_order, tag_upper


@helper
def _load(graph, cells, lo, hi, own):
    """Fill positions and weights; returns the largest extent of the centroids along an axis."""
    local, weight, _, _, _, _ = own[0]
    centroids, weights = graph[3], graph[5]
    extent = 0.0
    for k in range(hi - lo):
        weight[k] = weights[cells[lo + k]]
    for c in range(centroids.shape[1]):
        low, high = np.inf, -np.inf
        for k in range(hi - lo):
            x = centroids[cells[lo + k], c]
            local[c, k] = x
            low, high = min(low, x), max(high, x)
        extent = max(extent, high - low)
    return extent


@helper(allocates=True)
def _cut(graph, cells, lo, hi, extent, own, tag, marks, near, sums):
    frame, room = own
    local, weight, along, _, _, _ = frame
    n, d = hi - lo, graph[3].shape[1]
    centre_in_order(n, d, local, weight)
    frame_in_order(n, d, frame)
    bar, slack = split_in_order(n, d, along, weight, 0.5, room)
    return tag_upper(graph, cells, lo, hi, room[1], along[0], bar, slack + 1e-12 * extent, tag, near, sums)


@kernel
def split_across_axes(graph, shape, cells, tag, marks, todo, ready, leaf, counts, tally, goal, work):
    """Split pieces, the last in ``todo`` first; the arguments are those of ``PieceGrowth``."""
    m = largest_piece(todo, counts)
    own = frame_room(m), order_room(m)
    split_pieces(
        _load, _cut, own, graph, shape, cells, tag, marks, todo, ready, leaf, counts, tally, goal, work
    )
