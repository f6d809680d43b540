"""Narrowest boxes around 3-D agglomerates."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.shapes.planar_shapes import narrowest, one_hull

_TIE = 1e-9  # relative to a width: two widths this close count as equal, well above rounding
# Maximum number of equal-width directions considered, others are ignored (benchmarks/constants.py)
_TIES = 64
_PARALLEL = 1e-9  # sine of the angle between two edges below which they have no common normal


@helper
def _width(points, vertices, m, x, y, z):
    """Return the extent of the vertices along the unit vector (x, y, z)."""
    low, high = np.inf, -np.inf
    for i in range(m):
        v = vertices[i]
        height = x * points[v, 0] + y * points[v, 1] + z * points[v, 2]
        low, high = min(low, height), max(high, height)
    return high - low


@helper
def _note(points, vertices, m, x, y, z, width, ties, count):
    """Add a direction to the narrowest directions of a convex hull, unless the hull is wider along it.

    Returns the least width, and the number of directions in ``ties``.
    """
    # 1. A narrower direction, by more than rounding, restarts the list.
    extent = _width(points, vertices, m, x, y, z)
    if extent > width * (1.0 + _TIE):
        return width, count
    if extent < width * (1.0 - _TIE):
        count = 0
    # 2. Skip a direction already listed, or its opposite: several faces and edge pairs may produce it.
    width = min(width, extent)
    for k in range(count):
        if abs(x * ties[k, 0] + y * ties[k, 1] + z * ties[k, 2]) > 1.0 - 0.5 * _TIE:
            return width, count
    if count < _TIES:
        ties[count, 0], ties[count, 1], ties[count, 2] = x, y, z
        count += 1
    return width, count


@helper
def _edges(triangles, neighbours, start, stop, points, edges, normals):
    """Write the hull edges between faces that are not coplanar, and normals, and return the edge count.

    ``edges (e, 4)``: both ends, and the faces on both sides, counted from ``start``. ``normals``: the unit
    face normals and, below them, for each edge the cross product of the second and the first normal.
    """
    # 1. Unit normals of the faces.
    for t in range(start, stop):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
        vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        scale = 1.0 / max(np.sqrt(x * x + y * y + z * z), 1e-300)
        normals[t - start, 0], normals[t - start, 1], normals[t - start, 2] = x * scale, y * scale, z * scale
    # 2. List each edge once, from the face with the lower number. An edge between coplanar faces is
    #    overwritten by the next edge.
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
    """Return the inner product of row i of ``a`` and row j of ``b``."""
    return a[i, 0] * b[j, 0] + a[i, 1] * b[j, 1] + a[i, 2] * b[j, 2]


@helper
def _are_antipodal(normals, edges, faces, e, f):
    """Return True if parallel planes through edges e and f enclose the hull.

    This holds if the arc of normals from face to face of e, on the sphere, crosses the opposite arc of f.
    """
    # The ends of the opposite arc lie on different sides of the great circle of e, the ends of the arc of e
    # on different sides of the great circle of f, and the arcs themselves cross, not an arc and the far side
    # of the other.
    a, b, c, d = edges[e, 2], edges[e, 3], edges[f, 2], edges[f, 3]
    dot_c, dot_d = -_dot(normals, c, normals, faces + e), -_dot(normals, d, normals, faces + e)
    if dot_c * dot_d >= 0.0:
        return False
    dot_a, dot_b = _dot(normals, a, normals, faces + f), _dot(normals, b, normals, faces + f)
    return dot_a * dot_b < 0.0 and dot_c * dot_b > 0.0


@helper
def _narrowest(points, edges, count, faces, normals, vertices, m, ties):
    """Return the width of a convex hull, and the number of directions with this width.

    The directions are written to ``ties``. For the two closest parallel planes around the hull, either one
    plane lies on a face, or each lies on an edge (Houle and Toussaint 1988). ``faces`` and ``count`` are the
    numbers of faces and edges.
    """
    # 1. Directions of all face normals.
    width, n_ties = np.inf, 0
    for t in range(faces):
        x, y, z = normals[t, 0], normals[t, 1], normals[t, 2]
        width, n_ties = _note(points, vertices, m, x, y, z, width, ties, n_ties)
    # 2. Common normals of all edge pairs that support the hull on both sides. The hull is only measured along
    #    the normal if the distance between both edge lines does not exceed the least width.
    for e in range(count):
        a, b = edges[e, 0], edges[e, 1]
        ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
        for f in range(e):
            if not _are_antipodal(normals, edges, faces, e, f):
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
                width, n_ties = _note(points, vertices, m, x, y, z, width, ties, n_ties)
    return width, n_ties


@helper
def _project_vertices(points, vertices, m, x, y, z, flat, order):
    """Write the vertices projected to the plane perpendicular to a unit vector, in 2-D coordinates."""
    # Orthonormal basis u, v of the plane: u is perpendicular to the given vector and to the x or y axis,
    # whichever is farther from it.
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
    """Return the ratio of shortest to longest side of the narrowest box around each convex hull.

    The first pair of sides is as close as possible, the second encloses the projection along the first, again
    as close as possible. Among equally narrow boxes the shortest counts. The value is 0 without a hull.
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
        # 1. Distinct vertices of the hull; ``stamp`` stores the last cell that visited a point.
        m, faces = 0, offsets[c + 1] - offsets[c]
        for t in range(offsets[c], offsets[c + 1]):
            for k in range(3):
                v = triangles[t, k]
                if stamp[v] != c:
                    stamp[v], vertices[m] = c, v
                    m += 1
        # 2. Width of the hull, and all directions with this width.
        count = _edges(triangles, neighbours, offsets[c], offsets[c + 1], points, edges, normals)
        width, n_ties = _narrowest(points, edges, count, faces, normals, vertices, m, ties)
        # 3. For each direction, the narrowest rectangle around the projection: ``narrow`` by narrow / value.
        #    The width is the shortest side of the box, narrow / value the longest.
        for k in range(n_ties):
            _project_vertices(points, vertices, m, ties[k, 0], ties[k, 1], ties[k, 2], flat, order)
            corners = one_hull(flat, order, 0, m, hull, 0)
            narrow, value = narrowest(flat, hull, 0, corners)
            ratio[c] = max(ratio[c], width * value / narrow)
    return ratio
