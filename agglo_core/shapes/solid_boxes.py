"""Narrowest boxes around agglomerates in space."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.shapes.planar_shapes import narrowest, one_hull

_TIE = 1e-9  # relative difference below which two widths count as equal
_TIES = 64  # directions of equal width that are looked at; further ones are ignored
_PARALLEL = 1e-9  # sine of the angle of two edges below which they have no common normal


@helper
def _width(points, vertices, m, x, y, z):
    """Extent of the vertices along a unit vector."""
    low, high = np.inf, -np.inf
    for i in range(m):
        v = vertices[i]
        height = x * points[v, 0] + y * points[v, 1] + z * points[v, 2]
        low, high = min(low, height), max(high, height)
    return high - low


@helper
def _note(points, vertices, m, x, y, z, width, ties, count):
    """Keep a direction if the hull is as narrow along it as along any so far.

    Returns the least width, and how many directions are kept in ``ties``.
    """
    # A narrower one, by more than rounding, makes the list anew; one that is as narrow joins it.
    found = _width(points, vertices, m, x, y, z)
    if found > width * (1.0 + _TIE):
        return width, count
    if found < width * (1.0 - _TIE):
        count = 0
    # The same direction, or its opposite, may come from several faces and pairs of edges.
    width = min(width, found)
    for k in range(count):
        if abs(x * ties[k, 0] + y * ties[k, 1] + z * ties[k, 2]) > 1.0 - 0.5 * _TIE:
            return width, count
    if count < _TIES:
        ties[count, 0], ties[count, 1], ties[count, 2] = x, y, z
        count += 1
    return width, count


@helper
def _edges(triangles, neighbours, start, stop, points, edges, normals):
    """Write the edges of a hull at which it bends, and normals, and return the number of these edges.

    ``edges (e, 4)``: both ends, and the faces on both sides, counted from ``start``. ``normals``: the unit
    normals of the faces and, below them, for each edge the cross product of the second and the first normal.
    """
    # 1. Unit normals of the faces.
    for t in range(start, stop):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
        vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        scale = 1.0 / max(np.sqrt(x * x + y * y + z * z), 1e-300)
        normals[t - start, 0], normals[t - start, 1], normals[t - start, 2] = x * scale, y * scale, z * scale
    # 2. Each edge once, from the face of the lower number. It is overwritten by the next one if its faces are
    #    in one plane.
    count, crosses = 0, stop - start
    for t in range(start, stop):
        for side in range(3):
            g = neighbours[t, side]
            if g < t:
                continue
            a, b = t - start, g - start
            edges[count, 0], edges[count, 1] = triangles[t, side], triangles[t, (side + 1) % 3]
            edges[count, 2], edges[count, 3] = a, b
            x = normals[b, 1] * normals[a, 2] - normals[b, 2] * normals[a, 1]
            y = normals[b, 2] * normals[a, 0] - normals[b, 0] * normals[a, 2]
            z = normals[b, 0] * normals[a, 1] - normals[b, 1] * normals[a, 0]
            row = crosses + count
            normals[row, 0], normals[row, 1], normals[row, 2] = x, y, z
            count += x * x + y * y + z * z > _PARALLEL * _PARALLEL
    return count


@helper
def _dot(a, i, b, j):
    """Inner product of two rows."""
    return a[i, 0] * b[j, 0] + a[i, 1] * b[j, 1] + a[i, 2] * b[j, 2]


@helper
def _facing(normals, edges, faces, e, f):
    """Return True if two parallel planes, one on edge e and one on edge f, have the hull between them.

    They do if the arc of normals from face to face of e, on the sphere, crosses the opposite of that of f.
    """
    # The ends of the opposite arc are on different sides of the great circle of e, those of the arc of e on
    # different sides of the great circle of f, and the arcs cross, not one of them and the far side of the
    # other.
    a, b, c, d = edges[e, 2], edges[e, 3], edges[f, 2], edges[f, 3]
    one, two = -_dot(normals, c, normals, faces + e), -_dot(normals, d, normals, faces + e)
    if one * two >= 0.0:
        return False
    three, four = _dot(normals, a, normals, faces + f), _dot(normals, b, normals, faces + f)
    return three * four < 0.0 and one * four > 0.0


@helper
def _narrowest(points, edges, count, faces, normals, vertices, m, ties):
    """Width of the hull, and the number of directions in which it is that narrow.

    These are left in ``ties``. Of two parallel planes with the hull between them as close as can be, one lies
    on a face, or each on an edge (Houle and Toussaint 1988). ``faces`` is the number of faces, ``count`` that
    of the edges.
    """
    # 1. Directions of the normals of all faces.
    width, found = np.inf, 0
    for t in range(faces):
        x, y, z = normals[t, 0], normals[t, 1], normals[t, 2]
        width, found = _note(points, vertices, m, x, y, z, width, ties, found)
    # 2. Common normals of all pairs of edges that support the hull on both sides. Only where the lines of
    #    both edges are no farther apart than the least width is the hull measured along their normal.
    for e in range(count):
        a, b = edges[e, 0], edges[e, 1]
        ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
        for f in range(e):
            if not _facing(normals, edges, faces, e, f):
                continue
            c, d = edges[f, 0], edges[f, 1]
            vx, vy, vz = points[d, 0] - points[c, 0], points[d, 1] - points[c, 1], points[d, 2] - points[c, 2]
            x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            size = np.sqrt(x * x + y * y + z * z)
            if size * size <= _PARALLEL**2 * (ux * ux + uy * uy + uz * uz) * (vx * vx + vy * vy + vz * vz):
                continue
            x, y, z = x / size, y / size, z / size
            wx, wy, wz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
            if abs(x * wx + y * wy + z * wz) <= width * (1.0 + _TIE):
                width, found = _note(points, vertices, m, x, y, z, width, ties, found)
    return width, found


@helper
def _flattened(points, vertices, m, x, y, z, flat, order):
    """Write the vertices as seen along a unit vector, in coordinates relative to the first of them."""
    # An orthonormal basis u, v of the plane: u is across the given vector and the x or y axis, whichever is
    # farther from it.
    if abs(x) < abs(y):
        ux, uy, uz = 0.0, z, -y
    else:
        ux, uy, uz = -z, 0.0, x
    size = 1.0 / np.sqrt(ux * ux + uy * uy + uz * uz)
    ux, uy, uz = ux * size, uy * size, uz * size
    vx, vy, vz = y * uz - z * uy, z * ux - x * uz, x * uy - y * ux
    for i in range(m):
        v, o = vertices[i], vertices[0]
        dx, dy, dz = points[v, 0] - points[o, 0], points[v, 1] - points[o, 1], points[v, 2] - points[o, 2]
        flat[i, 0], flat[i, 1] = dx * ux + dy * uy + dz * uz, dx * vx + dy * vy + dz * vz
        order[i] = i


@kernel
def solid_box_ratios(points, offsets, triangles, neighbours):
    """Shortest side over longest side of the narrowest box around each hull, as ``solid_hulls`` makes them.

    One pair of sides is as close as can be, the next is around what is seen along those, again as close as
    can be. Among equally narrow boxes the shortest counts. 0 where there is no hull.
    """
    n, most = len(offsets) - 1, np.int64(0)
    for c in range(n):
        most = max(most, offsets[c + 1] - offsets[c])
    stamp = np.full(len(points), -1, np.int64)
    edges, normals = np.empty((3 * most // 2 + 1, 4), np.int64), np.empty((5 * most // 2 + 1, 3))
    vertices, order, hull = (
        np.empty(most + 2, np.int64),
        np.empty(most + 2, np.int64),
        np.empty(most + 3, np.int64),
    )
    flat, ties, ratio = np.empty((most + 2, 2)), np.empty((_TIES, 3)), np.zeros(n)
    for c in range(n):
        # 1. The distinct vertices of the hull; ``stamp`` holds the last cell that met a point.
        m, faces = 0, offsets[c + 1] - offsets[c]
        for t in range(offsets[c], offsets[c + 1]):
            for k in range(3):
                v = triangles[t, k]
                if stamp[v] != c:
                    stamp[v], vertices[m] = c, v
                    m += 1
        # 2. The width of the hull and all directions in which it is that narrow.
        count = _edges(triangles, neighbours, offsets[c], offsets[c + 1], points, edges, normals)
        width, found = _narrowest(points, edges, count, faces, normals, vertices, m, ties)
        # 3. For each of them, the narrowest rectangle around what is seen along it: ``narrow`` by narrow /
        #    value. The width is the shortest side of the box, narrow / value the longest.
        for k in range(found):
            _flattened(points, vertices, m, ties[k, 0], ties[k, 1], ties[k, 2], flat, order)
            corners = one_hull(flat, order, 0, m, hull, 0)
            narrow, value = narrowest(flat, hull, 0, corners)
            ratio[c] = max(ratio[c], width * value / narrow)
    return ratio
