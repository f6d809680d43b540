"""Star-shapedness kernels of 3-D agglomerates: the points from which the whole agglomerate is visible."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.shapes.solid_triangles import most_triangles, surface

_TINY = 1e-12  # relative to the extent: corners within this distance outside a plane count as on it
_FIRST = 24  # edges of a box, counted once per adjacent face
# Corners of the box faces, counter-clockwise from outside: 4, 2, 1 are added for high x, y, z.
_BOX = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


@helper
def _plane(points, corners, t, origin, plane):
    """Write the outward unit normal n of a triangle, and n · a for one corner a.

    Corners are relative to the origin. Returns False for a degenerate triangle.
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
    """Write the bounding box of a surface as six faces, and return its largest absolute coordinate.

    The layout of faces follows :func:`_cut`. All coordinates are relative to the point ``origin``.
    """
    # 1. Bounds of the triangle corners.
    low, high, extent = np.empty(3), np.empty(3), 0.0
    for k in range(3):
        low[k], high[k] = np.inf, -np.inf
        for t in range(m):
            for corner in range(3):
                x = points[corners[t, corner], k] - points[origin, k]
                low[k], high[k] = min(low[k], x), max(high[k], x)
        extent = max(extent, max(high[k], -low[k]))
    # 2. Four sides per face, from corner to corner.
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
    """Return the signed distance from a plane to one end of a polyhedron's side."""
    i = 3 * end
    return plane[0] * sides[s, i] + plane[1] * sides[s, i + 1] + plane[2] * sides[s, i + 2] - plane[3]


@helper
def _cut(sides, ends, faces, plane, target, stops):
    """Write the part of a convex polyhedron below a plane, and return its face count.

    Face f has the sides from ``ends[f]``, in any order, each from one end ``[:3]`` to the other ``[3:]``,
    counter-clockwise from outside. A face that is cut gets a side along the plane, the new face its reverse.
    """
    top, n_faces, lid = 0, 0, len(target)  # the sides of the new face are collected at the end of the table
    stops[0] = 0
    for f in range(faces):
        # 1. Copy the sides of a face not above the plane, clipped at the plane: at most one side leaves the
        #    half-space, and at most one enters it.
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
        # 2. Close the gap with a side along the plane. The new face gets its reverse.
        if leaves >= 0 and enters >= 0:
            lid -= 1
            for k in range(3):
                target[top, k], target[top, 3 + k] = target[leaves, 3 + k], target[enters, k]
                target[lid, k], target[lid, 3 + k] = target[enters, k], target[leaves, 3 + k]
            top += 1
        if top > begin:
            n_faces += 1
            stops[n_faces] = top
    # 3. Append the new face, in the plane.
    for s in range(len(target) - 1, lid - 1, -1):
        for k in range(6):
            target[top, k] = target[s, k]
        top += 1
    stops[n_faces + 1] = top
    return n_faces + 1


@helper
def _volume(sides, ends, faces):
    """Return the volume of a polyhedron as a signed sum of tetrahedra with a corner at the origin.

    Each tetrahedron contains a side of a face and the first corner ``o`` of that face.
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
    """Return the kernel volume per cell: the part of space below all its triangle planes.

    A point strictly below all planes sees each triangle from inside, so all solid angles have one sign. Their
    sum is 4π for an inside point and 0 elsewhere: the point is inside, and every ray from it leaves the cell
    once. Holes, cavities and loose parts therefore need no special case.
    """
    n, most = len(offsets) - 1, most_triangles(offsets, faces, starts)
    room = 8 * most + 2 * _FIRST  # a convex polyhedron with F faces has at most 3F - 6 edges, stored twice
    sides, target = np.empty((room, 6)), np.empty((room, 6))
    ends, stops = np.empty(most + 8, np.int64), np.empty(most + 8, np.int64)
    corners, plane, volume = np.empty((most, 3), np.int64), np.empty(4), np.zeros(n)
    for c in range(n):
        # 1. Start with the box around the cell, relative to one of its vertices.
        m = surface(first + c, offsets[c], offsets[c + 1], faces, face_cells, starts, triangles, corners)
        origin = corners[0, 0]
        tiny, count = _TINY * _box_around(points, corners, m, origin, sides, ends), 6
        for t in range(m):
            if not _plane(points, corners, t, origin, plane):
                continue
            # 2. Heights of the remaining corners over a triangle plane. All on or above: the kernel is empty.
            #    All on or below: no cut.
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
