"""Compute cell inertias from faces by the divergence theorem, exact for any shape."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float
from agglo_core.threads import over_ranges


def plane_inertias(
    points: Float, face_pairs: Int, face_cells: Int, offsets: Int, faces: Int, centroids: Float
) -> Float:
    """Return ∫ |x − C|² ``(n,)`` of polygons about their centroids C.

    Cell c has ``faces[offsets[c]:offsets[c + 1]]``.
    """
    from agglo_core.mesh.kernels.plane_cells import inertias

    found = over_ranges(
        lambda start, stop: inertias(start, stop, points, face_pairs, face_cells, offsets, faces, centroids),
        len(centroids),
    )
    return frozen_float(np.concatenate(found))


def polyhedron_inertias(
    points: Float,
    face_offsets: Int,
    face_vertices: Int,
    vectors: Float,
    centres: Float,
    face_cells: Int,
    offsets: Int,
    faces: Int,
    centroids: Float,
) -> Float:
    """Return ∫ |x − C|² ``(n,)`` of polyhedra, by pyramids between their faces and the centroid C.

    ``vectors`` and ``centres`` are the face area vectors and centroids ``(n_faces, 3)``.
    """
    from agglo_core.mesh.kernels.solid_cells import face_inertias, solid_inertias

    moments = frozen_float(face_inertias(points, face_offsets, face_vertices, vectors, centres))
    of_faces = moments, vectors, centres, face_cells, offsets, faces, centroids
    found = over_ranges(lambda start, stop: solid_inertias(start, stop, *of_faces), len(centroids))
    return frozen_float(np.concatenate(found))
