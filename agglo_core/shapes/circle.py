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

# Straightened chains take a third of the time for a crescent of many edges, trapezoids a sixth for cells that
# are stretched a thousandfold.
_MANY = 256  # edges: in longer outlines nearly straight chains become one edge
_SAG = 4e-5  # of half the shorter side of the box around an outline: how far chains may be off that edge
_CONVEX = 32  # edges up to which convexity is tested; the test takes time proportional to their square
_LISTED = 64  # edges up to which the best average of their distances is sought in a box
_SHORT = 32  # edges: shorter lists are not worth a copy
_LONG = 4.0  # ratio of the sides of the box around an outline from which on trapezoids are tried first
_FEW = 16  # promising trapezoids up to which these are searched, else boxes from one around all
_THIN = 3.0  # ratio of the sides of a box from which on the axis along which it is halved matters


@helper
def _polished(edges, m, x, y, radius, trio, weight, inverse):
    """Centre and radius of the largest circle near by, after up to three Newton steps.

    The edges that touch it and their λ are left in ``trio`` and ``weight``, ``(3,)`` each.
    """
    for _ in range(3):
        # Linearise the distances at the centre and maximise r with r ≤ each tangent in a square of half side
        # r. Where three edges touch the circle the optimum is a vertex, and steps converge quadratically.
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
    """Centre and radius of the largest circle in a convex outline of few edges.

    The radius is -1 for any other outline.
    """
    if m > _CONVEX or not convex(edges, m, 1e-13 * diameter):
        return 0.0, 0.0, -1.0
    # Distances from the lines of all edges, over a box that contains the outline. The result is checked
    # against the edges themselves: several loops may pass the test of their lines.
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
    """Return True if an average of distances is nowhere above ``enough`` in a box.

    Then no circle with its centre there is larger. The average is convex, hence largest at a corner; the
    centre refutes it most often, so it comes first.
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
    """Axis along which the average of ``_decided`` rises more from the centre of a box to its sides."""
    one = max(_average(edges, some, weight, x - sx, y), _average(edges, some, weight, x + sx, y))
    two = max(_average(edges, some, weight, x, y - sy), _average(edges, some, weight, x, y + sy))
    return 0 if one > two else 1


@helper(allocates=True)
def _largest(edges, m, diameter, best, heap):
    """Centre and radius of the largest circle, by best-first branch and bound.

    Returns edges and heap, too, for reuse. ``best`` is the radius about the origin, 0 if that is outside. See
    :func:`circles` for the bounds. Columns of boxes are those of :mod:`agglo_core.shapes.box_heap`; their
    lists are ranges of columns of ``edges``.
    """
    best_x, best_y, polished, above = 0.0, 0.0, 0.0, 0.0
    trio, weight = np.zeros(3, np.int64), np.zeros(3)
    pair, halves = np.zeros(3, np.int64), np.array((0.5, 0.5, 0.0))
    some, share, inverse = np.zeros(3, np.int64), np.zeros(3), np.zeros((3, 3))
    # 1. A convex outline: one linear program.
    x, y, exact = _in_convex(edges, m, diameter, some, share, inverse)
    if exact >= 0.0:
        return (x, y, exact, edges, heap) if exact > best else (best_x, best_y, best, edges, heap)
    # 2. The root: the box around all edges. Its signed distance is not known (``above`` is 0).
    box = np.empty((1, WIDTH))
    x0, y0, sx, sy = bounding_box(edges, m)
    start, stop, top = np.int64(0), m, m  # edges of the open box; end of those in use
    axis, parts, size, opened, polish = np.int64(0), 1, np.int64(0), 0, 4
    accuracy, done = 1e-3, False
    # 3. Long outlines (the first axis is the longest): boxes around trapezoids take the place of the root if
    #    all fit and few promise a larger circle than the best on their sides, once polished. Otherwise back
    #    to 2.
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
        # 4. Look at both halves of the open box (the root as a whole; nothing right after step 3 has pushed
        #    trapezoids). What gains less than ``slack`` is dropped. R, half the diagonal, is ``reach``.
        slack = min(1e-4 * diameter, max(accuracy * best, 0.01 * accuracy * diameter))
        reach, thin = np.sqrt(sx * sx + sy * sy), max(sx, sy) > _THIN * min(sx, sy)
        for part in range(parts):
            x, y = x0, y0
            if parts == 2:
                x += (2 * part - 1) * (1 - axis) * sx
                y += (2 * part - 1) * axis * sy
            # 5. Signed distance of the centre: a candidate, and the bound d + R (outside: R - d).
            d = np.sqrt(edges[ROWS, nearest_edge(edges, start, stop, x, y)])
            inside = is_inside(edges, m, start, stop, axis, x0, y0, above, 1e-12 * diameter, x, y)
            signed = d if inside else -d
            if signed > best:
                best, best_x, best_y = signed, x, y
            if signed + reach <= best + slack:
                continue
            # 6. A thin box outside, for which R says little, may meet no edge and so be outside as a whole.
            if thin and not inside and apart(edges, start, stop, x, y, sx, sy):
                continue
            # 7. The bound by the edges that touch the best circle so far.
            if polished > 0.0 and _decided(edges, trio, weight, x, y, sx, sy, best + slack):
                continue
            # 8. Keep only the edges within d + 2R of the centre; others are nearest nowhere in the box. The
            #    copy lies right of all lists in use, and is overwritten unless the box is pushed.
            first, last = start, stop
            if stop - start > _SHORT:
                limit = (d + 2.0 * reach) ** 2 * (1.0 + 1e-9)
                edges, first, last = shortened(edges, start, stop, limit, top)
            # 9. The bound by the edges on both sides of a strip: that nearest to the centre c, and that
            #    nearest to the mirror image, in c, of the nearest point.
            pair[0] = nearest_edge(edges, first, last, x, y)
            dx, dy = offset(edges, pair[0], x, y)
            pair[1] = nearest_edge(edges, first, last, x + dx, y + dy)
            if _decided(edges, pair, halves, x, y, sx, sy, best + slack):
                continue
            # 10. Few edges: the best λ for planes above the distances, by a linear program whose maximum is
            #     the next candidate.
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
            # 11. The box stays open. Thin ones are halved along the axis along which the bound of 9 rises
            #     more, if that is not so short that halving it gains nothing.
            along = 0 if sx >= sy else 1
            if thin and min(sx, sy) > slack:
                along = _steeper(edges, pair, halves, x, y, sx, sy)
            box[0, 0], box[0, 1], box[0, 2], box[0, 3], box[0, 4] = bound, x, y, sx, sy
            box[0, 5], box[0, 6], box[0, 7], box[0, 8] = signed, first, last, along
            heap = push(heap, size, box)
            size += 1
            top = max(top, last)
        # 12. Done once no open box promises more. Polish then, and after 4, 8, 16, ... boxes, so that the
        #     bound of 7 keeps up at little cost.
        done = size == 0 or heap[0, 0] <= best + slack
        if (done or opened == polish) and best > polished:
            best_x, best_y, best = _polished(edges, m, best_x, best_y, best, trio, weight, inverse)
            polished = best
        if opened == polish:
            polish *= 2
        # 13. Open the box with the largest bound.
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
    """Radius of the largest circle anywhere, or of that about the origin.

    Returns edges and heap, too, for reuse. ``links`` is the work array of
    :func:`~agglo_core.shapes.inscribed_2d.simplified`.
    """
    best = max(signed_distance(edges, m, 0.0, 0.0), 0.0)
    if not anywhere:
        return best, edges, heap
    # Outlines of many edges are searched with chains straightened.
    table, k, many = edges, m, m > _MANY
    if many:
        table, k = simplified(edges, m, links, _SAG * bounding_box(edges, m)[3])
    x, y, found, table, heap = _largest(table, k, diameter, best, heap)
    if not many:
        return found, table, heap
    # The circle found there is moved to touch the outline itself.
    some, share, inverse = np.zeros(3, np.int64), np.zeros(3), np.zeros((3, 3))
    found = signed_distance(edges, m, x, y)
    return max(best, _polished(edges, m, x, y, found, some, share, inverse)[2]), edges, heap


@kernel
def circles(points, offsets, faces, face_vertices, centroids, diameters, anywhere):
    """Radius of the largest circle inside each agglomerate: anywhere, or about the centroid.

    Agglomerate c has the edges ``faces[offsets[c]:offsets[c + 1]]``. About a centroid that is outside the
    radius is 0.

    Anywhere: in a convex outline of few edges a linear program gives the radius. Otherwise boxes are halved,
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
