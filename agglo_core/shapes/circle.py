"""Largest circles inside agglomerates: even-odd rule over their edges, best-first branch and bound.

Holes, several loops and pinch vertices need no special case. Works in coordinates relative to the
agglomerate's centroid and along its principal axes, so that boxes around thin agglomerates are thin.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.shapes.box_heap import WIDTH, pop, push
from agglo_core.shapes.inscribed_2d import (
    HEIGHT,
    ROWS,
    apart,
    bounding_box,
    convex,
    gathered,
    is_inside,
    largest_in_box,
    linearised,
    majorised,
    nearest_edge,
    offset,
    shortened,
    signed_distance,
    simplified,
    slabs,
    tightest,
)

_MANY = 256  # edges from which on nearly straight chains of them become one
_SAG = 4e-5  # of half the shorter side of the box around the outline: how far these may be off
_CONVEX = 32  # edges up to which an outline is tested for being convex, edge by edge
_LISTED = 64  # edges up to which the best average of their distances is sought in a box
_SHORT = 32  # edges in a list that is not worth shortening
_LONG = 4.0  # ratio of the sides of the box around an outline from which on trapezoids are tried first
_FEW = 16  # trapezoids to look into
_THIN = 3.0  # ratio of the sides of a box from which on the axis along which it is halved matters


@helper
def _polished(edges, m, x, y, radius, trio, weight, inverse):
    """Centre and radius after a few Newton steps; edges that touch, their λ in ``trio``, ``weight``."""
    for _ in range(3):
        linearised(edges, np.int64(0), m, x, y)
        first = tightest(edges, np.int64(0), m, 0.0, 0.0)
        px, py, _ = largest_in_box(
            edges, np.int64(0), m, first, radius, radius, 0.0, 1e-15 * radius, trio, weight, inverse
        )
        better = signed_distance(edges, m, x + px, y + py)
        if better <= radius:
            break
        x, y, radius = x + px, y + py, better
    return x, y, radius


@helper
def _in_convex(edges, m, diameter, trio, weight, inverse):
    """Centre and radius of the largest circle in a convex outline of few edges; radius -1 if it is none."""
    if m > _CONVEX or not convex(edges, m, 1e-13 * diameter):
        return 0.0, 0.0, -1.0
    x, y, radius = largest_in_box(
        edges, np.int64(0), m, np.int64(0), diameter, diameter, 0.0, 1e-15 * diameter, trio, weight, inverse
    )
    found = signed_distance(edges, m, x, y)
    return x, y, found if radius - found <= 1e-12 * diameter else -1.0


@helper
def _average(edges, some, weight, x, y):
    """Weighted average of the distances from (x, y) to some edges."""
    average = 0.0
    for n in range(3):
        if weight[n] > 0.0:
            dx, dy = offset(edges, some[n], x, y)
            average += weight[n] * np.sqrt(dx * dx + dy * dy)
    return average


@helper
def _decided(edges, some, weight, x, y, sx, sy, enough):
    """Whether no average of the distances to some edges exceeds ``enough`` in a box: so does no circle.

    The average is convex, hence largest at a corner; the centre refutes it most often.
    """
    if _average(edges, some, weight, x, y) > enough:
        return False
    for corner in range(4):
        cx, cy = x + (sx if corner & 1 else -sx), y + (sy if corner & 2 else -sy)
        if _average(edges, some, weight, cx, cy) > enough:
            return False
    return True


@helper
def _steeper(edges, some, weight, x, y, sx, sy):
    """The axis along which the average of ``_decided`` rises more from the centre of a box to its sides."""
    one = max(_average(edges, some, weight, x - sx, y), _average(edges, some, weight, x + sx, y))
    two = max(_average(edges, some, weight, x, y - sy), _average(edges, some, weight, x, y + sy))
    return 0 if one > two else 1


@helper(allocates=True)
def _largest(edges, m, diameter, best, heap):
    """Centre and radius of the largest circle, at least ``best`` about (0, 0); edges and heap to reuse."""
    best_x, best_y, polished, above = 0.0, 0.0, 0.0, 0.0
    trio, weight = np.zeros(3, np.int64), np.zeros(3)
    pair, halves = np.zeros(3, np.int64), np.array((0.5, 0.5, 0.0))
    some, share, inverse = np.zeros(3, np.int64), np.zeros(3), np.zeros((3, 3))
    x, y, exact = _in_convex(edges, m, diameter, some, share, inverse)
    if exact >= 0.0:
        return (x, y, exact, edges, heap) if exact > best else (best_x, best_y, best, edges, heap)
    box = np.empty((1, WIDTH))
    x0, y0, sx, sy = bounding_box(edges, m)
    start, stop, top = np.int64(0), m, m  # edges of the open box; end of those in use
    axis, parts, size, opened, polish = np.int64(0), 1, np.int64(0), 0, 4
    accuracy, done = 1e-3, False
    if sx > _LONG * sy:
        best_x, best_y, best, heap, size, whole = slabs(edges, m, best, 0.01 * accuracy, heap, box)
        best_x, best_y, best = _polished(edges, m, best_x, best_y, best, trio, weight, inverse)
        polished = best
        promising = 0
        for i in range(size):
            promising += heap[i, 0] > best * (1.0 + 0.01 * accuracy)
        if whole and promising <= _FEW:
            accuracy, parts = 0.01 * accuracy, 0  # as few boxes are left, more exactly
        else:
            size = np.int64(0)
    while not done:
        slack = min(1e-4 * diameter, max(accuracy * best, 0.01 * accuracy * diameter))
        reach, thin = np.sqrt(sx * sx + sy * sy), max(sx, sy) > _THIN * min(sx, sy)
        for part in range(parts):
            x, y = x0, y0
            if parts == 2:
                x += (2 * part - 1) * (1 - axis) * sx
                y += (2 * part - 1) * axis * sy
            d = np.sqrt(edges[ROWS, nearest_edge(edges, start, stop, x, y)])
            inside = is_inside(edges, m, start, stop, axis, x0, y0, above, 1e-12 * diameter, x, y)
            signed = d if inside else -d
            if signed > best:
                best, best_x, best_y = signed, x, y
            if signed + reach <= best + slack:
                continue
            if thin and not inside and apart(edges, start, stop, x, y, sx, sy):
                continue
            if polished > 0.0 and _decided(edges, trio, weight, x, y, sx, sy, best + slack):
                continue
            first, last = start, stop
            if stop - start > _SHORT:
                limit = (d + 2.0 * reach) ** 2 * (1.0 + 1e-9)
                edges, first, last = shortened(edges, start, stop, limit, top)
            pair[0] = nearest_edge(edges, first, last, x, y)
            dx, dy = offset(edges, pair[0], x, y)
            pair[1] = nearest_edge(edges, first, last, x + dx, y + dy)
            if _decided(edges, pair, halves, x, y, sx, sy, best + slack):
                continue
            bound = signed + reach
            if last - first <= _LISTED:
                majorised(edges, first, last, x, y, sx, sy)
                px, py, most = largest_in_box(
                    edges, first, last, pair[0], sx, sy, best + slack, 0.1 * slack, some, share, inverse
                )
                if most <= best + slack:
                    continue
                bound = min(bound, most)
            else:  # the middle of both nearest points
                px, py = offset(edges, pair[1], x + dx, y + dy)
                px, py = -0.5 * px, -0.5 * py
            if inside and edges[ROWS, nearest_edge(edges, first, last, x + px, y + py)] > best**2:
                d = signed_distance(edges, m, x + px, y + py)
                if d > best:
                    best, best_x, best_y = d, x + px, y + py
            along = 0 if sx >= sy else 1
            if thin and min(sx, sy) > slack:
                along = _steeper(edges, pair, halves, x, y, sx, sy)
            box[0, 0], box[0, 1], box[0, 2], box[0, 3], box[0, 4] = bound, x, y, sx, sy
            box[0, 5], box[0, 6], box[0, 7], box[0, 8] = signed, first, last, along
            heap = push(heap, size, box)
            size += 1
            top = max(top, last)
        done = size == 0 or heap[0, 0] <= best + slack
        if (done or opened == polish) and best > polished:
            best_x, best_y, best = _polished(edges, m, best_x, best_y, best, trio, weight, inverse)
            polished = best
        if opened == polish:
            polish *= 2
        if not done:
            pop(heap, size, box)
            x0, y0, sx, sy, above = box[0, 1], box[0, 2], box[0, 3], box[0, 4], box[0, 5]
            start, stop, axis = np.int64(box[0, 6]), np.int64(box[0, 7]), np.int64(box[0, 8])
            sx, sy = (0.5 * sx, sy) if axis == 0 else (sx, 0.5 * sy)
            size -= 1
            opened += 1
            parts = 2
    return best_x, best_y, best, edges, heap


@helper(allocates=True)
def _radius(edges, m, diameter, anywhere, heap, links):
    """Radius of the largest circle anywhere, or of that about the origin; edges and heap to reuse."""
    best = max(signed_distance(edges, m, 0.0, 0.0), 0.0)
    if not anywhere:
        return best, edges, heap
    table, k, many = edges, m, m > _MANY
    if many:
        table, k = simplified(edges, m, links, _SAG * bounding_box(edges, m)[3])
    x, y, found, table, heap = _largest(table, k, diameter, best, heap)
    if not many:
        return found, table, heap
    some, share, inverse = np.zeros(3, np.int64), np.zeros(3), np.zeros((3, 3))
    found = signed_distance(edges, m, x, y)
    return max(best, _polished(edges, m, x, y, found, some, share, inverse)[2]), edges, heap


@kernel
def circles(points, offsets, faces, face_vertices, centroids, diameters, anywhere):
    """Radius of the largest circle inside each agglomerate: anywhere, or about the centroid (else 0).

    Anywhere: in a convex outline of few edges a linear program tells the radius. Otherwise boxes are halved,
    best bound first, until none exceeds the best radius by 1e-4 diameters (or by 1e-3 of the radius if that
    is less, down to 1e-5 diameters); a few Newton steps then make the radius exact where three edges touch
    the circle. Let c be the centre of a box, R half its diagonal and d the distance from c to the boundary.
    No radius in the box exceeds d + R, nor the largest Σ λ_i d_i there, d_i the distances to any edges,
    λ >= 0, Σ λ = 1. Three such choices are tried. The edges of a polished circle are exact at its centre and
    O(R²) above nearby, so that boxes around the largest circle are discarded early. The edge nearest to c and
    that nearest to the mirror image, in c, of the nearest point, half each, decide long strips. In what is
    left the best λ are sought if edges are few. Thin boxes are halved along the axis along which the second
    choice rises more, and discarded if they are outside and meet no edge.

    Long outlines are cut into trapezoids first. If at most 16 of these are promising, boxes around them are
    halved instead of one around all, until none exceeds the best radius by 1e-5 of it (or 1e-7 diameters).

    Chains of nearly straight edges in outlines of more than 256 edges become one edge; in the end the circle
    is that of the outline itself.

    Only edges within d + 2R of c can be nearest to a point of the box: they alone are handed down to its
    halves, so that many edges cost little more than few. Whether a centre is inside follows from that of
    the box it was halved from and the edges between the two.
    """
    radius, most = np.zeros(len(offsets) - 1), np.int64(0)
    for c in range(len(radius)):
        most = max(most, offsets[c + 1] - offsets[c])
    links = np.zeros((len(points) if anywhere and most > _MANY else 0, 2), np.int32)
    edges = np.empty((HEIGHT, 64))
    heap = np.empty((256, WIDTH))
    for c in range(len(radius)):
        x0, y0 = centroids[c, 0], centroids[c, 1]
        edges, m = gathered(points, offsets[c], offsets[c + 1], faces, face_vertices, x0, y0, edges)
        radius[c], edges, heap = _radius(edges, m, diameters[c], anywhere, heap, links)
    return radius
