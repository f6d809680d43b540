"""Compute moments of polygonal faces in 3-D, compare half-faces, and detect loops that repeat a point."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.mesh.kernels.solid_cells import add_surface


@helper(inline=True)
def _half_cross(points, a, b, c):
    """Return the area vector of a triangle, half the cross product of two sides."""
    ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    return 0.5 * (uy * vz - uz * vy), 0.5 * (uz * vx - ux * vz), 0.5 * (ux * vy - uy * vx)


@helper(inline=True)
def _area_vector(points, vertices, start, stop):
    """Return the area vector of the loop ``vertices[start:stop]``, the sum over its triangle fan."""
    a, x, y, z = vertices[start], 0.0, 0.0, 0.0
    for h in range(start + 1, stop - 1):
        px, py, pz = _half_cross(points, a, vertices[h], vertices[h + 1])
        x, y, z = x + px, y + py, z + pz
    return x, y, z


@helper
def _write_moments(points, vertices, start, stop, total, centre, f):
    """Write area vector and centroid of the loop ``vertices[start:stop]`` to rows f of two arrays."""
    a = vertices[start]
    x, y, z = _area_vector(points, vertices, start, stop)
    total[f, 0], total[f, 1], total[f, 2] = x, y, z
    size = np.sqrt(x * x + y * y + z * z)
    if not size > 0.0:
        centre[f, 0], centre[f, 1], centre[f, 2] = points[a, 0], points[a, 1], points[a, 2]
        return
    # The centroid is the mean of the triangle centroids, weighted by the areas projected along the normal, so
    # that the reversed triangles of loops with notches count negatively.
    ux, uy, uz, mx, my, mz = x / size, y / size, z / size, 0.0, 0.0, 0.0
    for h in range(start + 1, stop - 1):
        b, c = vertices[h], vertices[h + 1]
        px, py, pz = _half_cross(points, a, b, c)
        share = px * ux + py * uy + pz * uz
        mx += share * (points[a, 0] + points[b, 0] + points[c, 0]) / 3.0
        my += share * (points[a, 1] + points[b, 1] + points[c, 1]) / 3.0
        mz += share * (points[a, 2] + points[b, 2] + points[c, 2]) / 3.0
    centre[f, 0], centre[f, 1], centre[f, 2] = mx / size, my / size, mz / size


@kernel
def loop_moments(points, offsets, vertices, total, centre):
    """Write area vectors and centroids of loops ``(n, 3)``, by triangle fans from their first points.

    Loop f has ``vertices[offsets[f]:offsets[f + 1]]``. The area vector is the area times the normal. The
    centroid of a loop without area is its first point. The caller allocates the arrays, see
    :mod:`agglo_core.mesh.kernels.plane_cells`.
    """
    for f in range(len(offsets) - 1):
        _write_moments(points, vertices, offsets[f], offsets[f + 1], total, centre, f)


@kernel
def cell_surfaces(points, cell_offsets, loop_offsets, vertices, sums):
    """Write the first five ``sums (n, 5)`` of :func:`solid_cells.surfaces`, from the loops of the cells.

    Cell c has the loops ``cell_offsets[c]:cell_offsets[c + 1]``. Their moments are not stored.
    """
    n, most = len(cell_offsets) - 1, 0
    for c in range(n):
        most = max(most, cell_offsets[c + 1] - cell_offsets[c])
    vector, centre = np.empty((most, 3)), np.empty((most, 3))
    for c in range(n):
        first = cell_offsets[c]
        count = cell_offsets[c + 1] - first
        for i in range(count):
            start, stop = loop_offsets[first + i], loop_offsets[first + i + 1]
            if stop - start > 3:
                _write_moments(points, vertices, start, stop, vector, centre, i)
                continue
            a, b, d = vertices[start], vertices[start + 1], vertices[start + 2]
            vector[i, 0], vector[i, 1], vector[i, 2] = _half_cross(points, a, b, d)
            for k in range(3):
                centre[i, k] = (points[a, k] + points[b, k] + points[d, k]) / 3.0
        add_surface(np.int64(0), count, vector, centre, sums, c)


@helper(inline=True)
def _are_opposite(vertices, offsets, i, j, sign):
    """Return True if two loops of the same three vertices have opposite directions, with ``sign`` 1.

    With ``sign`` −1, return True for equal directions. Longer loops return False.
    """
    a, b, stop = offsets[i], offsets[j], offsets[j + 1]
    if stop - b != 3:
        return False
    while vertices[b] != vertices[a]:
        b += 1
    following = vertices[b + 1 if b + 1 < stop else b - 2]
    return (following != vertices[a + 1]) == (sign > 0.0)


@kernel
def first_overlap(owner, partner, points, offsets, vertices, sign):
    """Return the first face whose two half-faces have outward area vectors on the same side, or −1.

    Face f has the half-faces ``owner[f]`` and ``partner[f]``, −1 if it has one. The outward area vector of
    half-face h is ``sign[h]`` times the area vector of its loop.
    """
    for f in range(len(owner)):
        i, j = owner[f], partner[f]
        if j >= 0 and not _are_opposite(vertices, offsets, i, j, sign[i] * sign[j]):
            ux, uy, uz = _area_vector(points, vertices, offsets[i], offsets[i + 1])
            vx, vy, vz = _area_vector(points, vertices, offsets[j], offsets[j + 1])
            if sign[i] * sign[j] * (ux * vx + uy * vy + uz * vz) > 0.0:
                return f
    return -1


@kernel
def take_loops(offsets, vertices, loops, forward, new_offsets, new_vertices):
    """Write the vertices of selected loops, each as listed or in reverse order."""
    for k in range(len(loops)):
        start, stop = offsets[loops[k]], offsets[loops[k] + 1]
        for i in range(stop - start):
            new_vertices[new_offsets[k] + i] = vertices[start + i if forward[k] else stop - 1 - i]


@kernel
def loops_with_repeats(offsets, vertices, n_points):
    """Return the mask of vertex loops that visit a vertex twice."""
    latest = np.full(n_points, -1, np.int64)  # last loop with this point
    repeated = np.zeros(len(offsets) - 1, np.bool_)
    for f in range(len(repeated)):
        for h in range(offsets[f], offsets[f + 1]):
            repeated[f] |= latest[vertices[h]] == f
            latest[vertices[h]] = f
    return repeated
