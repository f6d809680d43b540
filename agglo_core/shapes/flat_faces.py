"""Flat faces of 3-D agglomerates, merged from coplanar cell faces."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.compiled.graphs import find_root
from agglo_core.shapes.solid_triangles import most_triangles, surface

_STRAIGHT = 1e-8  # radians; rounding of coordinates tilts coplanar triangles by less


@helper
def _normals(points, corners, m, normals):
    """Write the unit normals of triangles and, in the last column, their areas.

    Degenerate triangles have a zero normal.
    """
    for t in range(m):
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
        vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        size = np.sqrt(x * x + y * y + z * z)
        scale = 1.0 / size if size > 0.0 else 0.0
        normals[t, 0], normals[t, 1], normals[t, 2], normals[t, 3] = (
            x * scale,
            y * scale,
            z * scale,
            0.5 * size,
        )


@helper
def _in_line(normals, s, t):
    """Return True if two triangles with a common edge are coplanar, with the solid on the same side."""
    # The cross product of unit normals has the sine of their angle as its length.
    ax, ay, az = normals[s, 0], normals[s, 1], normals[s, 2]
    bx, by, bz = normals[t, 0], normals[t, 1], normals[t, 2]
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return x * x + y * y + z * z <= _STRAIGHT * _STRAIGHT and ax * bx + ay * by + az * bz > 0.0


@kernel
def face_ratios(points, first, offsets, faces, face_cells, starts, triangles):
    """Return the area ratio of the smallest to the largest flat face of each cell.

    Coplanar triangles with a common edge form one face. Cell ``first + c`` has the faces
    ``faces[offsets[c]:offsets[c + 1]]``, and face f the ``triangles`` numbered ``starts[f]:starts[f + 1]``.
    """
    n, most = len(offsets) - 1, most_triangles(offsets, faces, starts)
    corners, normals = np.empty((most, 3), np.int64), np.empty((most, 4))
    parent, area, following = np.empty(most, np.int64), np.empty(most), np.empty(3 * most, np.int64)
    latest = np.full(
        len(points), -1, np.int64
    )  # latest half-edge of the current cell with this point as lower end
    ratio = np.empty(n)
    for c in range(n):
        # 1. Triangles around the cell. Initially each triangle is a face, and the half-edge lists are empty.
        m = surface(first + c, offsets[c], offsets[c + 1], faces, face_cells, starts, triangles, corners)
        _normals(points, corners, m, normals)
        for t in range(m):
            parent[t], area[t] = t, 0.0
            for k in range(3):
                latest[corners[t, k]] = -1
        # 2. Half-edges by their lower end, in lists that begin with ``latest`` and continue with
        #    ``following``. Half-edge h is side h % 3 of triangle h // 3. Join coplanar triangles that share
        #    both ends of a side.
        for t in range(m):
            for side in range(3):
                a, b = corners[t, side], corners[t, (side + 1) % 3]
                low, high, h = min(a, b), max(a, b), 3 * t + side
                edge = latest[low]
                while edge >= 0:
                    s = edge // 3
                    i, j = corners[s, edge % 3], corners[s, (edge + 1) % 3 if edge % 3 < 2 else 0]
                    other_high = max(i, j)
                    if other_high == high and _in_line(normals, s, t):
                        parent[find_root(parent, s)] = find_root(parent, t)
                    edge = following[edge]
                following[h], latest[low] = latest[low], h
        # 3. Sum the face areas at the representative triangles. Entries of other triangles, and of degenerate
        #    faces, are 0 and do not count.
        for t in range(m):
            area[find_root(parent, t)] += normals[t, 3]
        least, largest = np.inf, 0.0
        for t in range(m):
            largest = max(largest, area[t])
            if area[t] > 0.0:
                least = min(least, area[t])
        ratio[c] = least / largest
    return ratio
