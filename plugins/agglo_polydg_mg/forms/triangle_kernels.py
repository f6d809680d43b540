"""Kernel for the largest triangles inside a cell with one of its faces as base."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel

# Depth, in barycentric coordinates, that an edge must reach into a triangle to count. Edges that end in a
# corner of the triangle, like the neighbours of its base and its apex, must not count by rounding;
# shallower cuts are missed.
_SHRUNK = 1e-8


@helper
def _reaches(sx, sy, tx, ty, ax, ay, bx, by, vx, vy):
    """Return True if the segment st passes through the interior of the slightly shrunk triangle abv."""
    double_area = (bx - ax) * (vy - ay) - (by - ay) * (vx - ax)
    low, high = 0.0, 1.0
    px, py, ex, ey = ax, ay, bx - ax, by - ay
    # Clip the segment by the three sides, with s at 0 and t at 1: low..high remains.
    for side in range(3):
        if side == 1:
            px, py, ex, ey = bx, by, vx - bx, vy - by
        elif side == 2:
            px, py, ex, ey = vx, vy, ax - vx, ay - vy
        # Barycentric coordinates of s and t opposite this side, positive inside and linear along the
        # segment.
        at_s = (ex * (sy - py) - ey * (sx - px)) / double_area - _SHRUNK
        at_t = (ex * (ty - py) - ey * (tx - px)) / double_area - _SHRUNK
        if at_s <= 0.0 and at_t <= 0.0:
            return False
        if at_s <= 0.0:
            low = max(low, at_s / (at_s - at_t))
        elif at_t <= 0.0:
            high = min(high, at_s / (at_s - at_t))
    return low < high


@helper
def _is_convex(start, end, m):
    """Return True if a polygon is convex: each of its m edges has every vertex on its left.

    Rounding errors are tolerated.
    """
    for k in range(m):
        ax, ay = start[k, 0], start[k, 1]
        ex, ey = end[k, 0] - ax, end[k, 1] - ay
        lowest, highest = 0.0, 0.0
        for v in range(m):
            height = ex * (start[v, 1] - ay) - ey * (start[v, 0] - ax)
            lowest, highest = min(lowest, height), max(highest, height)
        # Relative to the cell height over the edge, otherwise rounding would turn straight angles into
        # dents.
        if lowest < -1e-10 * highest:
            return False
    return True


@helper
def _visible_height(start, end, m, k, convex, queue):
    """Return the height of the largest triangle inside the cell from edge k to a cell vertex.

    ``queue (m,)`` is the order of edge tests: an edge that hides a vertex moves to the front, as it is
    likely to hide more. Returns 0 if no vertex is visible.
    """
    ax, ay, bx, by = start[k, 0], start[k, 1], end[k, 0], end[k, 1]
    length = np.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
    best = 0.0
    for v in range(m):
        # Vertices no higher than the best one, or not to the left of the edge, need no test: most vertices
        # cost no search.
        vx, vy = start[v, 0], start[v, 1]
        height = ((bx - ax) * (vy - ay) - (by - ay) * (vx - ax)) / length
        if height <= best * (1.0 + 1e-12) or height <= 1e-12 * length:
            continue
        # The triangle lies in the cell if no edge enters it, which a convex cell guarantees.
        is_hidden = False
        if not convex:
            for i in range(m):
                g = queue[i]
                if _reaches(start[g, 0], start[g, 1], end[g, 0], end[g, 1], ax, ay, bx, by, vx, vy):
                    for back in range(i, 0, -1):
                        queue[back] = queue[back - 1]
                    is_hidden, queue[0] = True, g
                    break
        if not is_hidden:
            best = height
    return best


@kernel
def largest_triangles(points, offsets, faces, face_vertices, face_cells, first_cell, heights):
    """Compute the height of the largest triangle on each face inside the cells from ``first_cell`` on.

    Its base is the face, its apex a cell vertex, and it lies in the cell. ``heights (F, 2)`` are for owner
    and neighbour, 0 if no vertex is visible; heights of faces with length 0 are left unchanged.
    """
    most = 0
    for c in range(len(offsets) - 1):
        most = max(most, offsets[c + 1] - offsets[c])
    start, end, queue = np.empty((most, 2)), np.empty((most, 2)), np.empty(most, np.int64)
    for c in range(len(offsets) - 1):
        # Cell edges, anticlockwise: the vertices of a face are in this order for its owner.
        m = offsets[c + 1] - offsets[c]
        for k in range(m):
            f = faces[offsets[c] + k]
            flip = 0 if face_cells[f, 0] == first_cell + c else 1
            queue[k] = k
            for x in range(2):
                start[k, x] = points[face_vertices[f, flip], x]
                end[k, x] = points[face_vertices[f, 1 - flip], x]
        # Search on each edge with positive length; in a convex cell only heights are compared.
        convex = _is_convex(start, end, m)
        for k in range(m):
            f = faces[offsets[c] + k]
            if start[k, 0] != end[k, 0] or start[k, 1] != end[k, 1]:
                side = 0 if face_cells[f, 0] == first_cell + c else 1
                heights[f, side] = _visible_height(start, end, m, k, convex, queue)
