"""Largest inscribed balls of 3-D agglomerates: depth-first branch and bound over boxes.

Cavities, loose parts and pinched edges need no special case. Coordinates are relative to the agglomerate's
centroid and along its principal axes, so that boxes around flat agglomerates are flat.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, Mask
from agglo_core.compiled.compiling import helper, kernel
from agglo_core.shapes.inscribed_3d import (
    BLOCK,
    LANES,
    VALUES,
    add_at_corners,
    ball_in_box,
    convex_solid,
    gather_triangles,
    inside_triangles,
    linearise_triangles,
    lower_planes,
    lowest_plane,
    nearest_triangle,
    on_inner_side,
    shorter_list,
)
from agglo_core.shapes.solid_triangles import most_triangles, surface

# Relative to the radius: boxes with less possible gain are dropped. Smaller is more exact, and slower
# (benchmarks/solid_metrics.py, CR).
_ACCURACY = 1e-3
_PATIENCE = 20_000  # number of boxes after which this tolerance doubles; bounds the time for thin plates
_FINEST = 1e-9  # relative to the diameter: smallest gain searched for, and radius that counts as zero
# Bounds by planes save boxes, but cost time: they only pay in small or thin boxes, and the test for convexity
# only for few triangles (all: benchmarks/solid_metrics.py, CR).
_CONVEX = 64  # number of triangles up to which convexity is tested, in quadratic time
_LARGE = 0.4  # half diagonal of a box over the best radius, above which planes are tried only if thin
_THIN = 2.2  # ratio of the longest to the shortest box side, above which planes are tried at any size
_LISTED = 4  # number of triangle blocks up to which lists are not copied (benchmarks/constants.py)

# Boxes halve at most 31 times along each axis until they are _FINEST, and each halving adds one to the stack.
_ROWS = 256


class Boxes(NamedTuple):
    """Stack of the boxes still to open, one per row.

    Attributes
    ----------
    bounds : (_ROWS,) float
        Upper bound of the radii of balls with their centre in the box.
    centres, sides : (_ROWS, 3) float
        Centre and half sides.
    inside : (_ROWS,) bool
        True if the whole box is known to lie inside the solid.
    lists : (_ROWS, 3) int
        Begin and end of the box's list of triangles, in blocks, and the end of all lists up to here.
    """

    bounds: Float
    centres: Float
    sides: Float
    inside: Mask
    lists: Int


class Scratch(NamedTuple):
    """Workspace of the linear program over tangent planes, and of bounds by averages.

    Attributes
    ----------
    centre : (3,) float
        Maximiser, relative to the centre of the box.
    cube : (3,) float
        Half sides of the cube in which a ball is polished.
    some, weight : (4,) int and float
        Triangles whose constraints are active, and their multipliers λ.
    inverse, row, sums : (4, 4), (4,) and (8,) float
        Workspace alone.
    """

    centre: Float
    cube: Float
    some: Int
    weight: Float
    inverse: Float
    row: Float
    sums: Float


@helper
def _radius_at(solid, x, y, z):
    """Return the distance from a point to the surface of the solid, negative outside."""
    corners, table, m, blocks = solid
    distance = np.sqrt(table[nearest_triangle(table, np.int64(0), blocks, x, y, z) + VALUES])
    return distance if inside_triangles(corners, table, m, x, y, z) else -distance


@helper
def _polish_ball(solid, at, radius, contacts, share, scratch):
    """Move the centre of an inscribed ball to a nearby local maximum of the radius, by Newton steps.

    ``at (3,)`` is the initial centre of the ball with this ``radius``, and receives the new centre. The
    triangles that touch the ball and their λ are written to ``contacts`` and ``share``, ``(4,)`` each.
    """
    _, table, _, blocks = solid
    centre, cube, inverse, row = scratch.centre, scratch.cube, scratch.inverse, scratch.row
    trust, none = radius, np.int64(0)
    for _ in range(12):
        # 1. Linearise all distances at the centre (without a box: tangents), and maximise r with r ≤ each
        #    tangent over a cube with half side ``trust``.
        linearise_triangles(table, none, blocks, at[0], at[1], at[2], 0.0, 0.0, 0.0)
        first = lowest_plane(table, none, blocks, 0.0, 0.0, 0.0)
        cube[0], cube[1], cube[2] = trust, trust, trust
        most = ball_in_box(
            table, none, blocks, first, cube, 0.0, 1e-13 * radius, centre, contacts, share, inverse, row
        )
        # 2. Stop when the tangents promise no gain.
        if most <= radius * (1.0 + 1e-10):
            break
        # 3. Distances to triangles are convex, hence nowhere below their tangents: the step achieves the
        #    promised gain unless it leaves the solid. Then repeat in a smaller cube.
        better = _radius_at(solid, at[0] + centre[0], at[1] + centre[1], at[2] + centre[2])
        if better > radius:
            for k in range(3):
                at[k] += centre[k]
            radius = better
        else:
            trust *= 0.25
    return radius


@helper
def _highest_average(table, some, weight, x, y, z, sides, sums):
    """Return the maximum of a weighted average Σ λ_i d_i of distances over a box: a bound on ball radii.

    The average of the distances from up to four triangles is convex, hence maximal at a corner. ``sums (8,)``
    is workspace.
    """
    for k in range(8):
        sums[k] = 0.0
    for n in range(4):
        if weight[n] > 0.0:
            add_at_corners(table, some[n], weight[n], x, y, z, sides, sums)
    most = 0.0
    for k in range(8):
        most = max(most, sums[k])
    return most


@helper
def _box_around_all(corners, m, low, sides):
    """Write centre and half side lengths of the bounding box of the triangles."""
    for k in range(3):
        least, most = np.inf, -np.inf
        for i in range(m):
            least = min(least, min(corners[i, k], min(corners[i, k + 3], corners[i, k + 6])))
            most = max(most, max(corners[i, k], max(corners[i, k + 3], corners[i, k + 6])))
        low[k], sides[k] = 0.5 * (least + most), 0.5 * (most - least)


@helper
def _bound_by_averages(table, first, last, x, y, z, sides, d, reach, enough, scratch):
    """Return a bound of the radii in a box, by a linear program over planes above all distances.

    ``scratch.centre`` receives the maximiser. ``d`` is the distance of the box centre to the surface, and
    ``reach`` half the diagonal. A bound of at most ``enough`` need not be sharp.
    """
    linearise_triangles(table, first, last, x, y, z, sides[0], sides[1], sides[2])
    # 1. If the bound does not decide, planes of triangles in large flat faces can be lowered, and the program
    #    is solved again.
    for _ in range(4):
        most = ball_in_box(
            table, first, last, lowest_plane(table, first, last, 0.0, 0.0, 0.0), sides, enough,
            1e-3 * enough, scratch.centre, scratch.some, scratch.weight, scratch.inverse, scratch.row,
        )  # fmt: skip
        if most <= enough or not lower_planes(
            table, first, last, d + reach, scratch.some, scratch.weight, x, y, z, sides
        ):
            break
    if most <= enough:
        return most
    # 2. The plane bound may be loose where the average of the true distances is tight.
    average = _highest_average(table, scratch.some, scratch.weight, x, y, z, sides, scratch.sums)
    return min(most, average)


@helper
def _push(boxes, size, bound, x, y, z, sides, inside, first, last, top):
    """Put a box on the stack of ``size`` boxes."""
    boxes.bounds[size], boxes.inside[size] = bound, inside
    boxes.centres[size, 0], boxes.centres[size, 1], boxes.centres[size, 2] = x, y, z
    for k in range(3):
        boxes.sides[size, k] = sides[k]
    boxes.lists[size, 0], boxes.lists[size, 1], boxes.lists[size, 2] = first, last, top


@helper
def _swap_last(boxes, size):
    """Swap the last two boxes of the stack, except for the end of all lists."""
    i, j = size - 1, size - 2
    boxes.bounds[i], boxes.bounds[j] = boxes.bounds[j], boxes.bounds[i]
    boxes.inside[i], boxes.inside[j] = boxes.inside[j], boxes.inside[i]
    for k in range(3):
        boxes.centres[i, k], boxes.centres[j, k] = boxes.centres[j, k], boxes.centres[i, k]
        boxes.sides[i, k], boxes.sides[j, k] = boxes.sides[j, k], boxes.sides[i, k]
    for k in range(2):
        boxes.lists[i, k], boxes.lists[j, k] = boxes.lists[j, k], boxes.lists[i, k]
    boxes.lists[j, 2] = boxes.lists[i, 2]


@helper(allocates=True)
def _largest_ball(corners, table, m, blocks, diameter, best, boxes, scratch):
    """Return the radius of the largest inscribed ball with any centre, by depth-first branch and bound.

    Also returns the table for reuse. ``best`` is the radius about the origin, 0 if the origin is outside. See
    :func:`balls` for the bounds. ``boxes`` and ``scratch`` are workspace.
    """
    centre, sums, none, sides, at = scratch.centre, scratch.sums, np.int64(0), np.zeros(3), np.zeros(3)
    contacts, share = np.zeros(4, np.int64), np.zeros(4)
    nearest, only = np.zeros(4, np.int64), np.array([1.0, 0.0, 0.0, 0.0])
    # 1. Convex solid: distances are distances to planes, and one linear program finds the maximum. Its box
    #    extends a diameter from the centroid in all directions, so it never binds.
    if m <= _CONVEX and convex_solid(corners, table, m, blocks, 1e-12 * diameter):
        sides[0], sides[1], sides[2] = diameter, diameter, diameter
        best = ball_in_box(
            table, none, blocks, none, sides, 0.0, 1e-15 * diameter, centre, contacts, share,
            scratch.inverse, scratch.row,
        )  # fmt: skip
        return best, table
    # 2. Initial ball: the ball about the origin, moved to a nearby maximum. The triangles that touch it and
    #    their λ, in ``contacts`` and ``share``, give a bound below. ``polished`` is their radius.
    polished = 0.0
    if best > 0.0:
        best = _polish_ball((corners, table, m, blocks), at, best, contacts, share, scratch)
        polished = best
    # 3. Root: the centres of larger balls are at least ``best`` inside the box around all triangles. Its list
    #    has all blocks.
    _box_around_all(corners, m, centre, sides)
    for k in range(3):
        sides[k] = max(sides[k] - best, 0.0)
    _push(boxes, none, np.inf, centre[0], centre[1], centre[2], sides, False, none, blocks, blocks)
    size, parts, opened, accuracy, tiny = np.int64(1), 1, 0, _ACCURACY, _FINEST * diameter
    while True:
        # 4. Open the last box that can contain a larger ball, or stop.
        while size > 0 and boxes.bounds[size - 1] <= best * (1.0 + accuracy) + tiny:
            size -= 1
        if size == 0:
            break
        size -= 1
        x0, y0, z0 = boxes.centres[size, 0], boxes.centres[size, 1], boxes.centres[size, 2]
        for k in range(3):
            sides[k] = boxes.sides[size, k]
        start, stop, top = boxes.lists[size, 0], boxes.lists[size, 1], boxes.lists[size, 2]
        sure, pushed = boxes.inside[size], 0
        # 5. Halve it across its longest side; the root is processed as a whole. R, half the diagonal, is
        #    ``reach``.
        axis = 0 if sides[0] >= max(sides[1], sides[2]) else (1 if sides[1] >= sides[2] else 2)
        if parts == 2:
            sides[axis] *= 0.5
        reach = np.sqrt(sides[0] * sides[0] + sides[1] * sides[1] + sides[2] * sides[2])
        for part in range(parts):
            shift = (2 * part - 1) * sides[axis] * (parts - 1)
            x, y, z = x0 + (axis == 0) * shift, y0 + (axis == 1) * shift, z0 + (axis == 2) * shift
            opened += 1
            if opened % _PATIENCE == 0:
                # After many boxes reduce the accuracy. If no ball was found, as in a solid without volume, a
                # relative accuracy is meaningless: then only search for clearly larger balls.
                accuracy *= 2.0
                tiny *= 10.0 if best <= tiny else 1.0
            enough = best * (1.0 + accuracy) + tiny
            # 6. The bounds d + R, and by the triangle nearest to the centre: drop the box before more
            #    expensive tests.
            nearest[0] = nearest_triangle(table, start, stop, x, y, z)
            d = np.sqrt(table[nearest[0] + VALUES])
            if d + reach <= enough or _highest_average(table, nearest, only, x, y, z, sides, sums) <= enough:
                continue
            # 7. Keep only triangles within d + 2R of the centre; no other triangle is nearest anywhere in the
            #    box. The copy lies above all lists in use, and is overwritten unless the box is pushed.
            first, last = start, stop
            if stop - start > _LISTED:
                limit = (d + 2.0 * reach) ** 2 * (1.0 + 1e-9)
                table, first, last = shorter_list(table, start, stop, limit, top)
            # 8. A larger radius needs a certain test. The bound R - d is for an outside centre. If a box lies
            #    completely inside, as d > R, its halves need no test.
            inside = sure or on_inner_side(table, nearest[0], x, y, z)
            if not inside or d > best:
                inside = inside_triangles(corners, table, m, x, y, z)
            if inside and d > best:
                best, at[0], at[1], at[2] = d, x, y, z
            if not inside and reach - d <= enough:
                continue
            bound = d + reach if inside else reach - d
            # 9. Bounds by averages Σ λ_i d_i, first with the triangles that touch the best ball so far. They
            #    only pay in boxes that are small relative to the ball, or thin.
            longest = max(sides[0], max(sides[1], sides[2]))
            if reach <= _LARGE * best or longest > _THIN * min(sides[0], min(sides[1], sides[2])):
                if polished > 0.0 and (
                    _highest_average(table, contacts, share, x, y, z, sides, sums) <= enough
                ):
                    continue
                average = _bound_by_averages(table, first, last, x, y, z, sides, d, reach, enough, scratch)
                bound = min(bound, average)
                if bound <= enough:
                    continue
                # 10. The maximiser of the program is a promising centre: compare with the list, then with all
                #     triangles.
                x1, y1, z1 = x + centre[0], y + centre[1], z + centre[2]
                if table[nearest_triangle(table, first, last, x1, y1, z1) + VALUES] > best * best:
                    better = _radius_at((corners, table, m, blocks), x1, y1, z1)
                    if better > best:
                        best, at[0], at[1], at[2] = better, x1, y1, z1
            # 11. Polish a clearly larger ball, so that step 9 uses the triangles that touch it.
            if best > polished * (1.0 + _ACCURACY):
                best = _polish_ball((corners, table, m, blocks), at, best, contacts, share, scratch)
                polished = best
            # 12. Push the box. The half with the larger bound is opened first.
            top = max(top, last)
            _push(boxes, size, bound, x, y, z, sides, inside and d > reach, first, last, top)
            size += 1
            pushed += 1
        if pushed == 2 and boxes.bounds[size - 1] < boxes.bounds[size - 2]:
            _swap_last(boxes, size)
        parts = 2
    if best > polished:
        best = _polish_ball((corners, table, m, blocks), at, best, contacts, share, scratch)
    return best, table


@kernel
def balls(points, first, offsets, faces, face_cells, starts, triangles, centroids, diameters, anywhere):
    """Return the radius of the largest ball inside each agglomerate, with any centre or about the centroid.

    Agglomerate ``first + c`` has the faces ``faces[offsets[c]:offsets[c + 1]]``, and face f the ``triangles``
    numbered ``starts[f]:starts[f + 1]``. About a centroid outside the agglomerate the radius is 0.

    Anywhere: in a convex solid with few triangles a linear program gives the radius. Otherwise boxes are
    halved until no bound exceeds the best radius by a fraction of 1e-3. Newton steps make
    each radius exact where four triangles touch the ball. If 20,000 boxes do not suffice, as in plates fifty
    times as wide as thick, the fraction is doubled, and again after as many more. If no ball with radius 1e-9
    diameters was found by then, the least gain, initially as small, also increases tenfold, so that the
    search ends in a solid without volume. Its radius is 0 or at rounding level.

    Let c be the centre of a box, R half its diagonal and d the distance from c to the surface. No radius in
    the box exceeds d + R, nor the maximum of Σ λ_i d_i in the box, with distances d_i to any triangles, λ >=
    0, Σ λ = 1. Three choices are tried: the triangle nearest to c, the triangles that touch the best ball so
    far, which discard boxes around it early, and the best λ for planes above the distances. Outside, no
    radius exceeds R - d. If d > R, the whole box is on the side of its centre. Only triangles within d + 2R
    of c can be nearest to a point in the box, and only these are passed to its halves. The search begins with
    the box around the agglomerate, less the best radius on each side.
    """
    n, most = len(offsets) - 1, most_triangles(offsets, faces, starts)
    triples, moments, axes = np.empty((most, 3), np.int64), np.empty((3, 3)), np.empty((3, 3))
    corners, table = np.empty((most, 9)), np.empty((2 * most // LANES + 2) * BLOCK)
    rows, lists = (np.empty(_ROWS), np.empty((_ROWS, 3))), np.empty((_ROWS, 3), np.int64)
    boxes = Boxes(rows[0], rows[1], np.empty((_ROWS, 3)), np.empty(_ROWS, np.bool_), lists)
    vectors = np.empty(3), np.empty(3), np.zeros(4, np.int64), np.zeros(4)
    scratch = Scratch(*vectors, np.zeros((4, 4)), np.zeros(4), np.zeros(8))
    centre, radius = np.empty(3), np.zeros(n)
    for c in range(n):
        # 1. Table of the triangles in principal axes.
        m = surface(first + c, offsets[c], offsets[c + 1], faces, face_cells, starts, triangles, triples)
        for k in range(3):
            centre[k] = centroids[first + c, k]
        table, m, blocks = gather_triangles(points, triples, m, centre, moments, axes, corners, table)
        # 2. Radius about the centroid, then anywhere.
        radius[c] = max(_radius_at((corners, table, m, blocks), 0.0, 0.0, 0.0), 0.0)
        if anywhere:
            known, width = radius[c], diameters[first + c]
            radius[c], table = _largest_ball(corners, table, m, blocks, width, known, boxes, scratch)
    return radius
