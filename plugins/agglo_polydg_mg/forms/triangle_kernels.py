"""Kernel of the largest triangles that lie in a cell and have one of its faces for a base."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel

# How far into a triangle, in barycentric coordinates, an edge must reach to count. Edges that end in a corner
# of the triangle, as those beside its base and its apex do, must not count by rounding; edges that cut off
# less are missed.
_SHRUNK = 1e-8


@helper
def _reaches(sx, sy, tx, ty, ax, ay, bx, by, vx, vy):
    """Return whether the segment st passes through the inside of the triangle abv, shrunk a little."""
    twice = (bx - ax) * (vy - ay) - (by - ay) * (vx - ax)
    low, high = 0.0, 1.0
    px, py, ex, ey = ax, ay, bx - ax, by - ay
    # The segment is clipped by the three sides, s being at 0 and t at 1: low..high is what is left.
    for side in range(3):
        if side == 1:
            px, py, ex, ey = bx, by, vx - bx, vy - by
        elif side == 2:
            px, py, ex, ey = vx, vy, ax - vx, ay - vy
        # Barycentric coordinates of s and t opposite this side, positive inside; linear along the segment.
        at_s = (ex * (sy - py) - ey * (sx - px)) / twice - _SHRUNK
        at_t = (ex * (ty - py) - ey * (tx - px)) / twice - _SHRUNK
        if at_s <= 0.0 and at_t <= 0.0:
            return False
        if at_s <= 0.0:
            low = max(low, at_s / (at_s - at_t))
        elif at_t <= 0.0:
            high = min(high, at_s / (at_s - at_t))
    return low < high


@helper
def _is_convex(start, end, m):
    """Return whether each of the m edges has every vertex on its left, up to rounding."""
    for k in range(m):
        ax, ay = start[k, 0], start[k, 1]
        ex, ey = end[k, 0] - ax, end[k, 1] - ay
        lowest, highest = 0.0, 0.0
        for v in range(m):
            height = ex * (start[v, 1] - ay) - ey * (start[v, 0] - ax)
            lowest, highest = min(lowest, height), max(highest, height)
        # Relative to the height of the cell over the edge, or rounding would make dents of straight angles.
        if lowest < -1e-10 * highest:
            return False
    return True


@helper
def _visible_height(start, end, m, k, convex, queue):
    """Height of the largest triangle on edge k whose apex is a vertex and which no edge enters.

    ``queue (m,)`` is the order in which edges are tested: one that hides a vertex moves to the front, as it
    is likely to hide more. 0 if no vertex is visible.
    """
    ax, ay, bx, by = start[k, 0], start[k, 1], end[k, 0], end[k, 1]
    length = np.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
    best = 0.0
    for v in range(m):
        # A vertex that is no higher than the best one, or not to the left of the edge, need not be tested: so
        # most vertices cost no search.
        vx, vy = start[v, 0], start[v, 1]
        height = ((bx - ax) * (vy - ay) - (by - ay) * (vx - ax)) / length
        if height <= best * (1.0 + 1e-12) or height <= 1e-12 * length:
            continue
        # The triangle lies in the cell if no edge enters it; in a convex cell none does.
        hidden = False
        if not convex:
            for i in range(m):
                g = queue[i]
                if _reaches(start[g, 0], start[g, 1], end[g, 0], end[g, 1], ax, ay, bx, by, vx, vy):
                    for back in range(i, 0, -1):
                        queue[back] = queue[back - 1]
                    hidden, queue[0] = True, g
                    break
        if not hidden:
            best = height
    return best


@kernel
def largest_triangles(points, offsets, faces, face_vertices, face_cells, first_cell, heights):
    """Write the height over each face of the largest triangle in cells ``first_cell``, ...

    Its base is the face, its apex a vertex of the cell, and it lies in the cell. ``heights (F, 2)`` are for
    owner and neighbour; those of faces of no length are left as they are. 0 if no vertex is visible.
    """
    most = 0
    for c in range(len(offsets) - 1):
        most = max(most, offsets[c + 1] - offsets[c])
    start, end, queue = np.empty((most, 2)), np.empty((most, 2)), np.empty(most, np.int64)
    for c in range(len(offsets) - 1):
        # The edges of the cell, anticlockwise: pairs of vertices of a face are so for its owner.
        m = offsets[c + 1] - offsets[c]
        for k in range(m):
            f = faces[offsets[c] + k]
            flip = 0 if face_cells[f, 0] == first_cell + c else 1
            queue[k] = k
            for x in range(2):
                start[k, x] = points[face_vertices[f, flip], x]
                end[k, x] = points[face_vertices[f, 1 - flip], x]
        # A search on each edge of some length; in a convex cell no edges are tested, only heights compared.
        convex = _is_convex(start, end, m)
        for k in range(m):
            f = faces[offsets[c] + k]
            if start[k, 0] != end[k, 0] or start[k, 1] != end[k, 1]:
                side = 0 if face_cells[f, 0] == first_cell + c else 1
                heights[f, side] = _visible_height(start, end, m, k, convex, queue)
