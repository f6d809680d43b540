"""Recursive bisection at weighted medians, across principal axes or the longest box sides."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.compiled.sums import chosen_sum
from agglo_core.split.ordered_frames import centre_in_order, frame_in_order, new_framed_points
from agglo_core.split.piece_driver import largest_piece, split_pieces, split_pieces_by
from agglo_core.split.piece_shares import new_order, split_in_order, tag_upper

_TIE = 1e-7  # relative to the longest side: tolerance for equal sides, as in ``graph.blocks``
_ROUNDING = 1e-12  # relative to the extent: bound on the rounding error of heights, with a margin


class AxisWork(NamedTuple):
    """Workspace for cuts across the principal axis: points in their principal frame, and their order."""

    points: Any
    order: Any


class BoxWork(NamedTuple):
    """Workspace for cuts across a box: points ``(3, m)``, weights ``(m,)``, extents ``(3,)``, and order."""

    local: Any
    weight: Any
    extents: Any
    order: Any


@helper
def _load_positions(graph, pieces, lo, hi, local, weight, extents):
    """Copy centroids and weights of a piece, write its extents, and return the largest extent."""
    cells, centroids, weights = pieces.cells, graph.centroids, graph.weights
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
def _load_frame(graph, pieces, lo, hi, work):
    points = work.points
    return _load_positions(graph, pieces, lo, hi, points.local, points.shares, points.values)


@helper(allocates=True)
def _cut_across_axis(graph, pieces, lo, hi, extent, work, candidates, sides):
    """Cut the loaded piece across its principal axis into halves of equal weight."""
    points, upper, n, d = work.points, work.order.upper, hi - lo, graph.centroids.shape[1]
    centre_in_order(n, d, points.local, points.shares)
    frame_in_order(n, d, points)
    bar, slack = split_in_order(n, d, points.along, 0, points.shares, 0.5, work.order)
    # Cells that count as equal to the cut may lie on either side, so they are candidates too.
    slack += _ROUNDING * extent
    return tag_upper(graph, pieces, lo, hi, upper, points.along[0], bar, slack, candidates, sides)


@kernel
def split_across_axes(graph, shape, pieces, lists, limits, budget):
    """Bisect mesh pieces recursively across their principal axes: see ``piece_driver.split_pieces_by``."""
    m = largest_piece(lists)
    work = AxisWork(new_framed_points(m), new_order(m))
    split_pieces(_load_frame, _cut_across_axis, work, graph, shape, pieces, lists, limits, budget)


# --- across the longest side of the box -------------------------------------------------------------------


@helper
def _load_box(graph, pieces, lo, hi, work):
    return _load_positions(graph, pieces, lo, hi, work.local, work.weight, work.extents)


@helper(allocates=True)
def _cut_box_at(graph, pieces, lo, hi, extent, share, work, candidates, sides):
    """Cut the loaded piece across the longest side of its bounding box, at a share of ``work.weight``.

    Of equally long sides the first counts. The weights are normalised to sum 1. Arguments and result follow
    ``cut`` in ``split_pieces_by``.
    """
    local, weight, upper = work.local, work.weight, work.order.upper
    n, d, axis, total = hi - lo, graph.centroids.shape[1], 0, 0.0
    # 1. Choose the first side that counts as longest, so that rounding does not decide between equal sides.
    while work.extents[axis] < (1.0 - _TIE) * extent:
        axis += 1
    # 2. Normalise the weights; without weight use cell counts.
    for k in range(n):
        total += weight[k]
    for k in range(n):
        weight[k] = weight[k] / total if total > 0.0 else 1.0 / n
    # 3. Compute the quantile. Cells that count as equal may lie on either side, so they are candidates too.
    bar, slack = split_in_order(n, d, local, axis, weight, share, work.order)
    slack += _ROUNDING * extent
    return tag_upper(graph, pieces, lo, hi, upper, local[axis], bar, slack, candidates, sides)


@helper(allocates=True)
def _cut_box(graph, pieces, lo, hi, extent, work, candidates, sides):
    return _cut_box_at(graph, pieces, lo, hi, extent, 0.5, work, candidates, sides)


@helper(allocates=True)
def _cut_box_by_mass(graph, pieces, lo, hi, extent, share, edge, work, candidates, sides):
    """Cut the loaded piece across the longest side of its box, at a mass share."""
    for k in range(hi - lo):
        work.weight[k] = graph.measures[pieces.cells[lo + k]]
    return _cut_box_at(graph, pieces, lo, hi, extent, share, work, candidates, sides)


@helper
def _quota_by_slices(quota, sides, graph, pieces, lo, middle, hi):
    """Return the left side's part count, bitwise as ``goals.split_quotas``, by sums in the same order."""
    if quota == 0:
        return 0
    left_measure = chosen_sum(graph.measures, pieces.cells, lo, middle)
    right_measure = chosen_sum(graph.measures, pieces.cells, middle, hi)
    if not left_measure + right_measure > 0.0:
        left_measure, right_measure = float(middle - lo), float(hi - middle)
    least, most = max(1.0, quota - (hi - middle)), min(quota - 1.0, float(middle - lo))
    return np.int64(min(max(np.rint(quota * (left_measure / (left_measure + right_measure))), least), most))


@kernel
def split_across_boxes(graph, shape, pieces, lists, limits, budget):
    """Bisect mesh pieces recursively across their longest box sides: see ``piece_driver.split_pieces_by``."""
    m = largest_piece(lists)
    work = BoxWork(np.empty((3, m)), np.empty(m), np.empty(3), new_order(m))
    helpers = _load_box, _cut_box, _cut_box_by_mass, _quota_by_slices
    split_pieces_by(*helpers, work, graph, shape, pieces, lists, limits, budget)
