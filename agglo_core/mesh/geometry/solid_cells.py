"""Compute polyhedron geometry from faces: areas, volumes, centroids, vertices."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Index, Int, frozen_float, frozen_index, frozen_int
from agglo_core.threads import over_ranges


def face_moments(points: Float, offsets: Int, vertices: Int) -> tuple[Float, Float]:
    """Return area vectors and centroids ``(F, 3)`` of polygonal faces, by triangle fans."""
    from agglo_core.mesh.kernels.face_loops import loop_moments

    n = len(offsets) - 1
    total, centre = np.empty((n, 3)), np.empty((n, 3))

    def measure_range(start: int, stop: int) -> None:
        span = slice(start, stop)
        loop_moments(points, offsets[start : stop + 1], vertices, total[span], centre[span])

    over_ranges(measure_range, n)
    return frozen_float(total), frozen_float(centre)


def sum_by(groups: Int, values: Float, n: int) -> Float:
    """Sum the rows ``values (m, d)`` over groups, ``(n, d)``."""
    columns = [np.bincount(groups, weights=column, minlength=n) for column in values.T]
    return np.stack(columns, axis=1)


def polyhedron_moments(
    vector: Float, centre: Float, face_cells: Int, offsets: Int, faces: Int
) -> tuple[Float, Float]:
    """Return volumes and centroids by the divergence theorem, from pyramids over each cell's faces."""
    from agglo_core.mesh.kernels.solid_cells import solid_moments

    n = len(offsets) - 1
    volume, centroid = np.empty(n), np.empty((n, 3))

    def measure_range(start: int, stop: int) -> None:
        arrays = volume[start:stop], centroid[start:stop]
        solid_moments(start, stop, vector, centre, face_cells, offsets, faces, *arrays)

    over_ranges(measure_range, n)
    return frozen_float(volume), frozen_float(centroid)


def polyhedron_vertices(
    face_offsets: Int, face_vertices: Int, offsets: Int, faces: Int, n_points: int
) -> tuple[Int, Index]:
    """Return the distinct vertices per cell as CSR.

    Cell c has ``faces[offsets[c]:offsets[c + 1]]``.
    """
    from agglo_core.mesh.kernels.solid_cells import vertices_of_solids

    ends, vertices = vertices_of_solids(face_offsets, face_vertices, offsets, faces, n_points)
    return frozen_int(ends), frozen_index(vertices)
