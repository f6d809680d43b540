"""Compute moments of polygonal faces in 3-D, and detect loops that repeat a point."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@helper
def _half_cross(points, a, b, c, vector):
    """Compute the area vector of a triangle, half the cross product of two sides."""
    ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    vector[0], vector[1], vector[2] = (
        0.5 * (uy * vz - uz * vy),
        0.5 * (uz * vx - ux * vz),
        0.5 * (ux * vy - uy * vx),
    )


@kernel
def loop_moments(points, offsets, vertices, total, centre):
    """Write area vectors and centroids of loops ``(n, 3)``, by triangle fans from their first points.

    Loop f has ``vertices[offsets[f]:offsets[f + 1]]``. The area vector is the area times the normal. The
    centroid of a loop without area is its first point. The caller allocates the arrays, see
    :mod:`agglo_core.mesh.kernels.plane_cells`.
    """
    part, unit = np.empty(3), np.empty(3)
    for f in range(len(offsets) - 1):
        # 1. The area vector is the sum of the triangle area vectors.
        a, is_triangle = vertices[offsets[f]], offsets[f + 1] - offsets[f] == 3
        total[f, 0], total[f, 1], total[f, 2] = 0.0, 0.0, 0.0
        for h in range(offsets[f] + 1, offsets[f + 1] - 1):
            _half_cross(points, a, vertices[h], vertices[h + 1], part)
            for k in range(3):
                total[f, k] += part[k]
        size = np.sqrt(total[f, 0] * total[f, 0] + total[f, 1] * total[f, 1] + total[f, 2] * total[f, 2])
        for k in range(3):
            centre[f, k] = 0.0 if size > 0.0 else points[a, k]
        if not size > 0.0:
            continue
        # 2. The centroid is the mean of the triangle centroids, weighted by the areas projected along the
        #    normal, so that the reversed triangles of loops with notches count negatively.
        for k in range(3):
            unit[k] = total[f, k] / size
        for h in range(offsets[f] + 1, offsets[f + 1] - 1):
            b, c = vertices[h], vertices[h + 1]
            if not is_triangle:  # else known from step 1
                _half_cross(points, a, b, c, part)
            share = part[0] * unit[0] + part[1] * unit[1] + part[2] * unit[2]
            for k in range(3):
                centre[f, k] += share * (points[a, k] + points[b, k] + points[c, k]) / 3.0
        for k in range(3):
            centre[f, k] /= size


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
