"""Triangulation of 3-D faces, and the oriented surface triangles of each cell.

Algorithms on 3-D surfaces use triangles only. A flat face is the union of its triangles, and a non-flat face
is defined as this union, so that 3-D surfaces are always closed.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel

_FLAT = 1e-9  # relative to the face area: smaller triangles are degenerate, for example with collinear points


@helper
def _area(points, a, b, c, nx, ny, nz):
    """Return the scalar product of a vector with the triangle's area vector, times two.

    The value is negative for the opposite orientation.
    """
    ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    return nx * (uy * vz - uz * vy) + ny * (uz * vx - ux * vz) + nz * (ux * vy - uy * vx)


@helper
def _square(points, a, b):
    """Return the squared distance between points a and b."""
    x, y, z = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    return x * x + y * y + z * z


@helper
def _ear(points, ring, m, i, nx, ny, nz, tiny):
    """Return the shape quality of the triangle at corner i of a polygon, or −1 if it is no ear.

    The shape is the area over the squared longest side, so that collinear points come last. An ear is a
    non-degenerate triangle with the face's orientation that contains no other corner. The result is -1 if the
    triangle is no ear.
    """
    a, b, c = ring[(i + m - 1) % m], ring[i], ring[(i + 1) % m]
    area = _area(points, a, b, c, nx, ny, nz)
    if not area > tiny:
        return -1.0
    for j in range(2, m - 1):
        p = ring[(i + j) % m]
        least = min(_area(points, a, b, p, nx, ny, nz), _area(points, b, c, p, nx, ny, nz))
        if min(least, _area(points, c, a, p, nx, ny, nz)) >= -tiny and p not in (a, b, c):
            return -1.0
    return area / max(_square(points, a, b), max(_square(points, b, c), _square(points, c, a)))


@helper
def _cut_ears(points, ring, m, nx, ny, nz, tiny, triangles, top):
    """Triangulate a non-convex polygon, or one with collinear corners, by ear clipping.

    ``ring[:m]`` are its vertices, and is changed. Writes triangles from row ``top`` on, and returns their
    end.
    """
    while m > 3:
        # Clip the ear of the best shape, or the first corner if rounding leaves no ear. The ring loses one
        # corner.
        best, ear = -np.inf, 0
        for i in range(m):
            value = _ear(points, ring, m, i, nx, ny, nz, tiny)
            if value > best:
                best, ear = value, i
        for k in range(3):
            triangles[top, k] = ring[(ear + m - 1 + k) % m]
        top += 1
        for i in range(ear, m - 1):
            ring[i] = ring[i + 1]
        m -= 1
    for k in range(3):
        triangles[top, k] = ring[k]
    return top + 1


@kernel
def face_triangles(points, offsets, vertices, vectors):
    """Triangulate all faces, with the orientation of the faces.

    ``vectors (n, 3)`` are the face area vectors. A face is divided into a fan if no fan triangle is
    degenerate, otherwise by ear clipping, best shape first. Returns the triangle offsets ``(n + 1,)`` of the
    faces, and the triangle vertices ``(t, 3)``.
    """
    n = len(offsets) - 1
    starts, triangles = np.zeros(n + 1, np.int64), np.empty((len(vertices) - 2 * n, 3), np.int32)
    longest = np.int64(3)
    for f in range(n):
        longest = max(longest, offsets[f + 1] - offsets[f])
    ring, top = np.empty(longest, np.int64), np.int64(0)
    for f in range(n):
        # 1. Check that all fan triangles from the first vertex are non-degenerate and have the face's
        #    orientation.
        first, m = offsets[f], offsets[f + 1] - offsets[f]
        nx, ny, nz = vectors[f, 0], vectors[f, 1], vectors[f, 2]
        tiny = _FLAT * (nx * nx + ny * ny + nz * nz)
        fan = True
        for h in range(first + 1, first + m - 1):
            fan &= m == 3 or _area(points, vertices[first], vertices[h], vertices[h + 1], nx, ny, nz) > tiny
        # 2. Write the fan, or clip ears. A face with m vertices has m - 2 triangles in both cases.
        if fan:
            for h in range(first + 1, first + m - 1):
                triangles[top, 0] = vertices[first]
                triangles[top, 1], triangles[top, 2] = vertices[h], vertices[h + 1]
                top += 1
        else:
            for i in range(m):
                ring[i] = vertices[first + i]
            top = _cut_ears(points, ring, m, nx, ny, nz, tiny, triangles, top)
        starts[f + 1] = top
    return starts, triangles


@helper
def surface(cell, start, stop, faces, face_cells, starts, triangles, corners):
    """Write the surface triangles of a cell, counter-clockwise from outside, and return their number.

    The cell has the faces ``faces[start:stop]``. Triangles are counter-clockwise from outside the owner of
    their face, and are reversed for the other cell.
    """
    m = 0
    for h in range(start, stop):
        f = faces[h]
        turned = face_cells[f, 0] != cell
        for t in range(starts[f], starts[f + 1]):
            corners[m, 0] = triangles[t, 0]
            corners[m, 1] = triangles[t, 2] if turned else triangles[t, 1]
            corners[m, 2] = triangles[t, 1] if turned else triangles[t, 2]
            m += 1
    return m


@helper
def most_triangles(offsets, faces, starts):
    """Return the largest number of surface triangles of a cell."""
    most = np.int64(0)
    for c in range(len(offsets) - 1):
        count = np.int64(0)
        for h in range(offsets[c], offsets[c + 1]):
            count += starts[faces[h] + 1] - starts[faces[h]]
        most = max(most, count)
    return most
