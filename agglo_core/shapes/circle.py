"""Largest inscribed circles of 2-D agglomerates, by best-first branch and bound over boxes.

Holes, several loops and pinch vertices need no special case. Coordinates are relative to the agglomerate's
centroid and along its principal axes, so that boxes around thin agglomerates are thin.
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
    gather_edges,
    is_inside,
    largest_in_box,
    linearise_distances,
    list_near_edges,
    majorise_distances,
    nearest_edge,
    offset,
    signed_distance,
    simplify_outline,
    slabs,
    tightest,
)

# Straightening chains reduces the time to a third for a crescent with many edges, trapezoids reduce it to a
# sixth for cells stretched a thousandfold (all: benchmarks/pathologies.py, rows of quality).
_MANY = 256  # number of edges above which nearly straight chains are replaced by single edges
_SAG = 4e-5  # relative to half the shorter bounding-box side: largest deviation of a chain from its edge
_CONVEX = 32  # number of edges up to which convexity is tested, in quadratic time
# Number of edges up to which the best average of distances is searched in a box (benchmarks/constants.py)
_LISTED = 64
_SHORT = 32  # number of edges up to which lists are not copied (benchmarks/constants.py)
_LONG = 4.0  # bounding-box side ratio above which trapezoids are tried first (benchmarks/constants.py)
# Number of promising trapezoids up to which they replace the box around the whole outline
# (benchmarks/constants.py)
_FEW = 16
_THIN = 3.0  # box side ratio above which the choice of the halved axis matters (benchmarks/constants.py)


@helper
def _polish_circle(edges, m, x, y, radius, trio, weight, inverse):
    """Move an inscribed circle to a nearby local maximum of the radius, by up to three Newton steps.

    The edges that touch the circle and their λ are written to ``trio`` and ``weight``, ``(3,)`` each.
    """
    for _ in range(3):
        # Linearise the distances at the centre, and maximise r with r ≤ each tangent in a square of half side
        # r. Where three edges touch the circle the optimum is a vertex, and steps converge quadratically.
        linearise_distances(edges, np.int64(0), m, x, y)
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
    """Return centre and radius of the largest circle in a convex outline with few edges.

    The radius is -1 for any other outline.
    """
    if m > _CONVEX or not convex(edges, m, 1e-13 * diameter):
        return 0.0, 0.0, -1.0
    # Maximise the distance to the lines of all edges, over a box that contains the outline. The result is
    # checked against the edges themselves, because several loops may pass the convexity test.
    x, y, radius = largest_in_box(
        edges, np.int64(0), m, np.int64(0), diameter, diameter, 0.0, 1e-15 * diameter, trio, weight, inverse
    )
    found = signed_distance(edges, m, x, y)
    return x, y, found if radius - found <= 1e-12 * diameter else -1.0


@helper
def _average(edges, some, weight, x, y):
    """Return the weighted average of the distances from (x, y) to up to three edges."""
    average = 0.0
    for n in range(3):
        if weight[n] > 0.0:
            dx, dy = offset(edges, some[n], x, y)
            average += weight[n] * np.sqrt(dx * dx + dy * dy)
    return average


@helper
def _excludes_box(edges, some, weight, x, y, sx, sy, enough):
    """Return True if a weighted average of distances is at most ``enough`` everywhere in a box.

    No circle with its centre in the box is then larger. The average is convex, hence maximal at a corner. The
    centre fails most often, so it is tested first.
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
    """Return the axis along which a weighted average of distances increases more from centre to sides."""
    one = max(_average(edges, some, weight, x - sx, y), _average(edges, some, weight, x + sx, y))
    two = max(_average(edges, some, weight, x, y - sy), _average(edges, some, weight, x, y + sy))
    return 0 if one > two else 1


@helper(allocates=True)
def _largest(edges, m, diameter, best, heap):
    """Return centre and radius of the largest inscribed circle, by best-first branch and bound.

    Also returns edges and heap for reuse. ``best`` is the radius about the origin, 0 if the origin is
    outside. See :func:`circles` for the bounds. The columns of boxes follow
    :mod:`agglo_core.shapes.box_heap`, and their lists are column ranges in ``edges``.
    """
    best_x, best_y, polished, distance0 = 0.0, 0.0, 0.0, 0.0
    trio, weight = np.zeros(3, np.int64), np.zeros(3)
    pair, halves = np.zeros(3, np.int64), np.array((0.5, 0.5, 0.0))
    some, share, inverse = np.zeros(3, np.int64), np.zeros(3), np.zeros((3, 3))
    # 1. Convex outline: one linear program.
    x, y, exact = _in_convex(edges, m, diameter, some, share, inverse)
    if exact >= 0.0:
        return (x, y, exact, edges, heap) if exact > best else (best_x, best_y, best, edges, heap)
    # 2. Root: the box around all edges. Its signed distance is unknown (``distance0`` is 0).
    box = np.empty((1, WIDTH))
    x0, y0, sx, sy = bounding_box(edges, m)
    start, stop, top = np.int64(0), m, m  # edges of the open box; end of those in use
    axis, parts, size, opened, polish = np.int64(0), 1, np.int64(0), 0, 4
    accuracy, is_done = 1e-3, False
    # 3. Long outlines (the first axis is the longest): boxes around trapezoids replace the root if all fit,
    #    and if few of them can contain a circle larger than the best circle on their sides, once polished.
    #    Otherwise use the root of step 2.
    if sx > _LONG * sy:
        best_x, best_y, best, heap, size, whole = slabs(edges, m, best, 0.01 * accuracy, heap, box)
        best_x, best_y, best = _polish_circle(edges, m, best_x, best_y, best, trio, weight, inverse)
        polished = best
        promising = 0
        for i in range(size):
            promising += heap[i, 0] > best * (1.0 + 0.01 * accuracy)
        if whole and promising <= _FEW:
            accuracy, parts = 0.01 * accuracy, 0  # few boxes remain, so increase the accuracy
        else:
            size = np.int64(0)
    while not is_done:
        # 4. Process both halves of the open box (the whole root, or nothing right after step 3 has pushed
        #    trapezoids). Boxes that gain less than ``slack`` are dropped. R, half the diagonal, is ``reach``.
        slack = min(1e-4 * diameter, max(accuracy * best, 0.01 * accuracy * diameter))
        reach, thin = np.sqrt(sx * sx + sy * sy), max(sx, sy) > _THIN * min(sx, sy)
        for part in range(parts):
            x, y = x0, y0
            if parts == 2:
                x += (2 * part - 1) * (1 - axis) * sx
                y += (2 * part - 1) * axis * sy
            # 5. Signed distance of the centre: a candidate, and the bound d + R (outside: R - d).
            d = np.sqrt(edges[ROWS, nearest_edge(edges, start, stop, x, y)])
            inside = is_inside(edges, m, start, stop, axis, x0, y0, distance0, 1e-12 * diameter, x, y)
            signed = d if inside else -d
            if signed > best:
                best, best_x, best_y = signed, x, y
            if signed + reach <= best + slack:
                continue
            # 6. A thin outside box, where R is a poor bound, may meet no edge, and is then completely
            #    outside.
            if thin and not inside and apart(edges, start, stop, x, y, sx, sy):
                continue
            # 7. Bound by the edges that touch the best circle so far.
            if polished > 0.0 and _excludes_box(edges, trio, weight, x, y, sx, sy, best + slack):
                continue
            # 8. Keep only edges within d + 2R of the centre; no other edge is nearest anywhere in the box.
            #    The copy lies right of all lists in use, and is overwritten unless the box is pushed.
            first, last = start, stop
            if stop - start > _SHORT:
                limit = (d + 2.0 * reach) ** 2 * (1.0 + 1e-9)
                edges, first, last = list_near_edges(edges, start, stop, limit, top)
            # 9. Bound by the edges on both sides of a strip: the edge nearest to the centre c, and the edge
            #    nearest to the mirror image, in c, of the nearest point.
            pair[0] = nearest_edge(edges, first, last, x, y)
            dx, dy = offset(edges, pair[0], x, y)
            pair[1] = nearest_edge(edges, first, last, x + dx, y + dy)
            if _excludes_box(edges, pair, halves, x, y, sx, sy, best + slack):
                continue
            # 10. Few edges: find the best λ for planes above the distances by a linear program, whose
            #     maximiser is the next candidate.
            bound = signed + reach
            if last - first <= _LISTED:
                majorise_distances(edges, first, last, x, y, sx, sy)
                px, py, most = largest_in_box(
                    edges, first, last, pair[0], sx, sy, best + slack, 0.1 * slack, some, share, inverse
                )
                if most <= best + slack:
                    continue
                bound = min(bound, most)
            else:  # candidate: the midpoint of both nearest points
                px, py = offset(edges, pair[1], x + dx, y + dy)
                px, py = -0.5 * px, -0.5 * py
            if inside and edges[ROWS, nearest_edge(edges, first, last, x + px, y + py)] > best**2:
                d = signed_distance(edges, m, x + px, y + py)
                if d > best:
                    best, best_x, best_y = d, x + px, y + py
            # 11. Push the box. Thin boxes are halved along the axis with the larger increase of the bound in
            #     step 9, unless this axis is too short to gain anything.
            next_axis = 0 if sx >= sy else 1
            if thin and min(sx, sy) > slack:
                next_axis = _steeper(edges, pair, halves, x, y, sx, sy)
            box[0, 0], box[0, 1], box[0, 2], box[0, 3], box[0, 4] = bound, x, y, sx, sy
            box[0, 5], box[0, 6], box[0, 7], box[0, 8] = signed, first, last, next_axis
            heap = push(heap, size, box)
            size += 1
            top = max(top, last)
        # 12. Stop when no open box promises more. Polish then, and after 4, 8, 16, ... boxes, so that the
        #     bound of step 7 remains sharp at low cost.
        is_done = size == 0 or heap[0, 0] <= best + slack
        if (is_done or opened == polish) and best > polished:
            best_x, best_y, best = _polish_circle(edges, m, best_x, best_y, best, trio, weight, inverse)
            polished = best
        if opened == polish:
            polish *= 2
        # 13. Open the box with the largest bound.
        if not is_done:
            pop(heap, size, box)
            x0, y0, sx, sy, distance0 = box[0, 1], box[0, 2], box[0, 3], box[0, 4], box[0, 5]
            start, stop, axis = np.int64(box[0, 6]), np.int64(box[0, 7]), np.int64(box[0, 8])
            sx, sy = (0.5 * sx, sy) if axis == 0 else (sx, 0.5 * sy)
            size -= 1
            opened += 1
            parts = 2
    return best_x, best_y, best, edges, heap


@helper(allocates=True)
def _radius(edges, m, diameter, anywhere, heap, links):
    """Return the radius of the largest circle inside an outline, with any centre or about the origin.

    Also returns edges and heap for reuse. ``links`` is the workspace of
    :func:`~agglo_core.shapes.inscribed_2d.simplify_outline`.
    """
    best = max(signed_distance(edges, m, 0.0, 0.0), 0.0)
    if not anywhere:
        return best, edges, heap
    # 1. Straighten chains in outlines with many edges, and search.
    table, k, is_large = edges, m, m > _MANY
    if is_large:
        table, k = simplify_outline(edges, m, links, _SAG * bounding_box(edges, m)[3])
    x, y, radius, table, heap = _largest(table, k, diameter, best, heap)
    if not is_large:
        return radius, table, heap
    # 2. Polish the circle so that it touches the original outline.
    some, share, inverse = np.zeros(3, np.int64), np.zeros(3), np.zeros((3, 3))
    radius = signed_distance(edges, m, x, y)
    return max(best, _polish_circle(edges, m, x, y, radius, some, share, inverse)[2]), edges, heap


@kernel
def circles(points, offsets, faces, face_vertices, centroids, diameters, anywhere):
    """Return the radius of the largest circle inside each agglomerate, with any centre or about the centroid.

    Agglomerate c has the edges ``faces[offsets[c]:offsets[c + 1]]``. About a centroid outside the agglomerate
    the radius is 0.

    Anywhere: in a convex outline with few edges a linear program gives the radius. Otherwise boxes are
    halved, best bound first, until no bound exceeds the best radius by 1e-4 diameters (or by 1e-3 of the
    radius if that is less, down to 1e-5 diameters). A few Newton steps then make the radius exact where three
    edges touch the circle. Let c be the centre of a box, R half its diagonal and d the distance from c to the
    boundary. No radius in the box exceeds d + R, nor the maximum of Σ λ_i d_i in the box, with distances d_i
    to any edges, λ >= 0, Σ λ = 1. Three choices are tried. The edges of a polished circle are exact at its
    centre and O(R²) above nearby, so that boxes around the largest circle are discarded early. The edge
    nearest to c and the edge nearest to the mirror image, in c, of the nearest point, half each, decide long
    strips. In the remaining boxes the best λ are computed if there are few edges. Thin boxes are halved along
    the axis with the larger increase of the second choice, and discarded if they are outside and meet no
    edge.

    Long outlines are cut into trapezoids first. If at most 16 trapezoids are promising, boxes around them are
    halved instead of a box around the outline, until no bound exceeds the best radius by 1e-5 of the radius
    (or 1e-7 diameters).

    Chains of nearly straight edges in outlines with more than 256 edges are replaced by single edges. The
    final circle refers to the original outline.

    Only edges within d + 2R of c can be nearest to a point in the box, and only these are passed to its
    halves, so that many edges cost little more than few. Whether a centre is inside follows from the parent's
    centre and the edges between the two.
    """
    radius, most = np.zeros(len(offsets) - 1), np.int64(0)
    for c in range(len(radius)):
        most = max(most, offsets[c + 1] - offsets[c])
    links = np.zeros((len(points) if anywhere and most > _MANY else 0, 2), np.int32)
    edges = np.empty((HEIGHT, 64))
    heap = np.empty((256, WIDTH))
    for c in range(len(radius)):
        x0, y0 = centroids[c, 0], centroids[c, 1]
        # Table of the edges in principal axes, then the search.
        edges, m = gather_edges(points, offsets[c], offsets[c + 1], faces, face_vertices, x0, y0, edges)
        radius[c], edges, heap = _radius(edges, m, diameters[c], anywhere, heap, links)
    return radius
