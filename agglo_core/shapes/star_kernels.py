"""Kernels of agglomerates in space: the points that see the whole of them."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.shapes.solid_triangles import most_triangles, surface

_TINY = 1e-12  # of the extent: corners that are no further outside a plane are on it
_FIRST = 24  # edges of a box, each once for either side
# Corners of the faces of a box, counter-clockwise from outside: 4, 2, 1 are added for the high x, y, z.
_BOX = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


@helper
def _plane(points, corners, t, origin, plane):
    """Write the outward unit normal n of a triangle and n · a, a one of its corners relative to the origin.

    Returns False if it has no area.
    """
    a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
    ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    size = np.sqrt(x * x + y * y + z * z)
    if not size > 0.0:
        return False
    plane[0], plane[1], plane[2], plane[3] = x / size, y / size, z / size, 0.0
    for k in range(3):
        plane[3] += plane[k] * (points[a, k] - points[origin, k])
    return True


@helper(allocates=True)
def _box_around(points, corners, m, origin, sides, ends):
    """Write the box around a surface as six faces, and return its largest coordinate in modulus.

    Faces are laid out as for :func:`_cut`. All coordinates are relative to the point ``origin``.
    """
    # 1. Bounds of the corners of the triangles.
    low, high, extent = np.empty(3), np.empty(3), 0.0
    for k in range(3):
        low[k], high[k] = np.inf, -np.inf
        for t in range(m):
            for corner in range(3):
                x = points[corners[t, corner], k] - points[origin, k]
                low[k], high[k] = min(low[k], x), max(high[k], x)
        extent = max(extent, max(high[k], -low[k]))
    # 2. Four sides for each face, from corner to corner.
    for f in range(6):
        ends[f] = 4 * f
        for i in range(4):
            for end in range(2):
                corner = _BOX[f][(i + end) % 4]
                sides[4 * f + i, 3 * end] = high[0] if corner & 4 else low[0]
                sides[4 * f + i, 3 * end + 1] = high[1] if corner & 2 else low[1]
                sides[4 * f + i, 3 * end + 2] = high[2] if corner & 1 else low[2]
    ends[6] = _FIRST
    return extent


@helper
def _above(sides, s, end, plane):
    """Signed distance of an end of a side from a plane."""
    i = 3 * end
    return plane[0] * sides[s, i] + plane[1] * sides[s, i + 1] + plane[2] * sides[s, i + 2] - plane[3]


@helper
def _cut(sides, ends, faces, plane, target, stops):
    """Write the part of a convex polyhedron below a plane and return its number of faces.

    Face f has the sides from ``ends[f]``, in any order, each from one end ``[:3]`` to the other ``[3:]``,
    counter-clockwise from outside. A face that is cut gets a side along the plane, the new face its reverse.
    """
    top, made, lid = 0, 0, len(target)  # sides of the new face gather at the end of the table
    stops[0] = 0
    for f in range(faces):
        # 1. Copy the sides of a face that are not above the plane, cut off where they cross it: at most one
        #    leaves the half-space, at most one enters it again.
        leaves, enters, begin = -1, -1, top
        for s in range(ends[f], ends[f + 1]):
            a, b = _above(sides, s, 0, plane), _above(sides, s, 1, plane)
            if a > 0.0 and b > 0.0:
                continue
            for k in range(6):
                target[top, k] = sides[s, k]
            if b > 0.0:
                for k in range(3):
                    target[top, 3 + k] = sides[s, k] + a / (a - b) * (sides[s, 3 + k] - sides[s, k])
                leaves = top
            elif a > 0.0:
                for k in range(3):
                    target[top, k] = sides[s, 3 + k] + b / (b - a) * (sides[s, k] - sides[s, 3 + k])
                enters = top
            top += 1
        # 2. Close the gap by a side along the plane. The new face has the same side the other way.
        if leaves >= 0 and enters >= 0:
            lid -= 1
            for k in range(3):
                target[top, k], target[top, 3 + k] = target[leaves, 3 + k], target[enters, k]
                target[lid, k], target[lid, 3 + k] = target[enters, k], target[leaves, 3 + k]
            top += 1
        if top > begin:
            made += 1
            stops[made] = top
    # 3. The new face, in the plane, comes last.
    for s in range(len(target) - 1, lid - 1, -1):
        for k in range(6):
            target[top, k] = target[s, k]
        top += 1
    stops[made + 1] = top
    return made + 1


@helper
def _volume(sides, ends, faces):
    """Volume of a polyhedron: the signed sum of tetrahedra with corners at the origin.

    Each has one side of a face opposite to the first corner ``o`` of that face.
    """
    total = 0.0
    for f in range(faces):
        o = ends[f]
        for s in range(o, ends[f + 1]):
            cross = sides[s, 1] * sides[s, 5] - sides[s, 2] * sides[s, 4]
            total += sides[o, 0] * cross / 6.0
            cross = sides[s, 2] * sides[s, 3] - sides[s, 0] * sides[s, 5]
            total += sides[o, 1] * cross / 6.0
            cross = sides[s, 0] * sides[s, 4] - sides[s, 1] * sides[s, 3]
            total += sides[o, 2] * cross / 6.0
    return total


@kernel
def solid_kernel_volumes(points, first, offsets, faces, face_cells, starts, triangles):
    """Volume of the kernel of each cell from ``first`` on: what is below the planes of all its triangles.

    A point strictly below all of them sees each from inside, so that the solid angles of all have one sign.
    Their sum is 4π where the point is inside and 0 elsewhere: the point is inside, and every ray from it
    leaves the cell once. So holes, cavities and loose parts need no special case.
    """
    n, most = len(offsets) - 1, most_triangles(offsets, faces, starts)
    room = 8 * most + 2 * _FIRST  # a convex polyhedron of F faces has at most 3F - 6 edges, each twice here
    sides, target = np.empty((room, 6)), np.empty((room, 6))
    ends, stops = np.empty(most + 8, np.int64), np.empty(most + 8, np.int64)
    corners, plane, volume = np.empty((most, 3), np.int64), np.empty(4), np.zeros(n)
    for c in range(n):
        # 1. Begin with the box around the cell, in coordinates relative to one of its vertices.
        m = surface(first + c, offsets[c], offsets[c + 1], faces, face_cells, starts, triangles, corners)
        origin = corners[0, 0]
        tiny, count = _TINY * _box_around(points, corners, m, origin, sides, ends), 6
        for t in range(m):
            if not _plane(points, corners, t, origin, plane):
                continue
            # 2. Heights of the corners of what is left over the plane of a triangle. All on it or above:
            #    nothing is below all planes. All on it or below: nothing to cut.
            low, high = np.inf, -np.inf
            for s in range(ends[count]):
                above = _above(sides, s, 0, plane)
                low, high = min(low, above), max(high, above)
            if low >= -tiny:
                count = 0
                break
            if high > tiny:
                count = _cut(sides, ends, count, plane, target, stops)
                sides, target, ends, stops = target, sides, stops, ends
        volume[c] = _volume(sides, ends, count)
    return volume
