"""Kernels of the fast model: sweeps in the direction of the network, or along some axes."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import (
    NO_CUT,
    axes_block,
    half_circle,
    halvings,
    helper,
    kernel,
    piece_driver,
    piece_splits,
    piece_sweeps,
    planar_frame,
    turned,
)
from agglo_gnn.band_sweeps import band_room, band_sweep, write_all_rows
from agglo_gnn.network_kernels import network_room, point
from agglo_gnn.raster_kernels import fill_raster, raster_room, to_frame

__all__ = ["bisect_fast", "split_fast"]

_SMALL = 96  # cells below which a cut is sought far from the mean, too
_AXES = 4
_FINER = 2  # halvings of the angle between them, about the best
_LONG = 0.5  # ratio of principal moments below which a piece is long
_FEW = 400  # cells below which axes are tried and the network is not asked: it would rarely decide


@helper
def _number_cells(cells, lo, hi, tag, marks):
    """Tag the cells of a piece as on the left, and write their numbers to the second column of the marks."""
    own, _ = piece_splits.side_tags(lo, hi)
    for k in range(hi - lo):
        tag[cells[lo + k]], marks[cells[lo + k], 1] = own, k


@helper
def _equal(n, shares):
    low, high = shares[0], shares[0]
    for i in range(n):
        low, high = min(low, shares[i]), max(high, shares[i])
    return high - low <= 1e-6 * high


@helper
def _asked(n, own):
    """Frame of a piece, its moments there, and the direction in which the network points."""
    (local, shares, scales), _, raster, (_, _, uv), net, _, layers = own
    grid, place, nodes, near, areas, features = raster
    frame = to_frame(n, local, shares, scales[1], uv, features)
    count = fill_raster(n, uv, shares, grid, place, nodes, near, areas)
    return (
        frame,
        (features[0], features[1], features[2]),
        point(count, nodes, near, areas, features, net, layers),
    )


@helper
def _unasked(n, own):
    """As ``_asked``, but the direction is the principal axis."""
    local, shares, _ = own[0]
    a, b, xx, xy, yy = planar_frame(n, local[0], local[1], shares)
    uu, vv = a * a * xx + 2.0 * a * b * xy + b * b * yy, b * b * xx - 2.0 * a * b * xy + a * a * yy
    return (a, b, -b, a), (uu, a * b * (yy - xx) + (a * a - b * b) * xy, vv), (1.0, 0.0)


@helper
def _cut_near_mean(graph, cells, lo, hi, own, tag, marks, axis):
    """Cheapest cut near the mean, along the direction of the network or some axes.

    The network is asked from some hundred cells on. With fewer, or all alike, the axes are tried, and the
    best of all turned a little. Returns what ``band_sweep`` does, leaves the score in the score room and
    its gradient in ``axis``.
    """
    (local, shares, scales), (score, bins, tally, _), _, (turns, finer, _), _, rows, _ = own
    n = hi - lo
    few = n < _FEW or _equal(n, shares)
    (ux, uy, vx, vy), (uu, uv, vv), pointed = _unasked(n, own) if n < _FEW else _asked(n, own)
    best, p, q, cos, sin = (NO_CUT, 0, 0.0, 0.0), 1.0, 0.0, 1.0, 0.0
    first, last = (-len(turns), 2 * len(finer)) if few else (0, 0)
    points = local, shares, (scales[0], scales[1], scales[2])
    _number_cells(cells, lo, hi, tag, marks)
    if few:
        write_all_rows(graph, cells, lo, hi, tag, marks, rows)
    for c in range(first, last + 1):
        f = (c - 1) // 2
        if c < 0:
            a, b = turns[c - first, 0], turns[c - first, 1]
            if vv < _LONG * uu and abs(a) < 0.9:
                continue  # a long piece is not cut lengthwise
        elif c == 0:
            a, b = pointed
            if n < _FEW:
                continue  # it was the first of the axes
        elif c % 2 == 1:
            cos, sin = p, q
            a, b = turned(cos, sin, finer[f, 0], finer[f, 1])
        else:
            a, b = turned(cos, sin, finer[f, 0], -finer[f, 1])
        spread = np.sqrt(uu * a * a + 2.0 * uv * a * b + vv * b * b)
        x, y = a * ux + b * vx, a * uy + b * vy
        trial = band_sweep(graph, cells, lo, hi, tag, marks, points, x, y, spread, few, rows, bins, tally)
        if trial[0] < best[0] - 1e-9 * abs(best[0]):
            best, p, q = trial, a, b
    axis[0], axis[1] = p * ux + q * vx, p * uy + q * vy
    for i in range(n):
        score[i] = axis[0] * local[0, i] + axis[1] * local[1, i]
    return best


@helper
def _cut(graph, cells, lo, hi, extent, own, tag, marks, near, sums):
    """Tag both sides of a piece that is loaded, as ``piece_driver.split_pieces`` wants it."""
    (local, shares, scales), (score, bins, tally, ends), _, (turns, finer, _), _, _, _ = own
    n, axis, best = hi - lo, sums[2], (NO_CUT, 0, 0.0, 0.0)
    axis[2] = 0.0
    if n >= _SMALL and scales[1] > 1e-299:
        best = _cut_near_mean(graph, cells, lo, hi, own, tag, marks, axis)
    if best[0] == NO_CUT:
        some = finer[: (n >= 16) + (n >= 32)]  # few cells have few cuts
        edges = ends, piece_sweeps.edges_of_piece(graph, cells, lo, hi, tag, marks, ends)
        section = scales[0], scales[1], scales[2]
        best, axis[0], axis[1] = axes_block(n, edges, local, shares, section, turns, some, score, bins, tally)
    unit = 1.0 / np.hypot(axis[0], axis[1])
    return piece_driver.tag_sides(
        graph, cells, lo, hi, score, piece_sweeps.bar_of(best), unit, extent, tag, near, sums
    )


@helper(allocates=True)
def _room(m, edges, net):
    """Work arrays for pieces of at most m cells, and the network."""
    directions = half_circle(_AXES), halvings(_AXES, _FINER), np.empty((2, m))
    points, scores, raster = piece_sweeps.point_room(m), piece_sweeps.score_room(m, edges), raster_room(m)
    rows, layers = band_room(m, edges), network_room(len(raster[2]), net)
    return points, scores, raster, directions, net, rows, layers


@kernel
def bisect_fast(offsets, indptr, indices, interface, centroids, weights, measures, net):
    """Side of each node of a planar graph: the network's cut, or along some axes if it is small."""
    n, largest, most = len(weights), np.int64(0), np.int64(0)
    for b in range(len(offsets) - 1):
        largest = max(largest, offsets[b + 1] - offsets[b])
        most = max(most, indptr[offsets[b + 1]] - indptr[offsets[b]])
    own, sums = _room(largest, most // 2 + 1, net), (np.empty(2), np.empty(2, np.int64), np.empty(3))
    cells, tag, marks = np.empty(n, np.int32), np.empty(n, np.int32), np.empty((n, 2), np.int32)
    near, reach = np.empty(largest + 1, np.int32), np.zeros(n, np.float32)
    graph = (indptr, indices, interface, centroids, measures, weights, reach, (1.0, 1.0))
    for i in range(n):
        cells[i] = i
    for b in range(len(offsets) - 1):
        lo, hi = offsets[b], offsets[b + 1]
        extent = piece_sweeps.load_piece(graph, cells, lo, hi, own)
        _cut(graph, cells, lo, hi, extent, own, tag, marks, near, sums)
    sides = np.empty(n, np.int64)
    for i in range(n):
        sides[i] = tag[i] & 1
    return sides


@kernel
def split_fast(net, graph, shape, cells, tag, marks, todo, ready, leaf, counts, tally, goal, work):
    """Split pieces, the last in ``todo`` first; the arguments but the first are those of ``PieceGrowth``."""
    m, edges = (
        piece_driver.largest_piece(todo, counts),
        piece_sweeps.most_edges(todo, counts, cells, graph[0]),
    )
    own = _room(m, edges, net)
    piece_driver.split_pieces(
        piece_sweeps.load_piece,
        _cut,
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
