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

    A face with area S, centroid m and moment ∫ |x − m|² = M, at distance h from C, contributes h (S |m − C|²
    + M) / 5. ``vectors`` and ``centres`` are the face area vectors and centroids ``(n_faces, 3)``.
    """
    areas = np.linalg.norm(vectors, axis=1)
    moments = _face_inertias(points, face_offsets, face_vertices, vectors, centres)
    moments /= np.where(areas > 0.0, areas, 1.0)
    cells = np.repeat(np.arange(len(centroids)), np.diff(offsets))
    arm = centres[faces] - centroids[cells]
    height = _dots(arm, vectors[faces])  # multiplied by the area
    height[face_cells[faces, 0] != cells] *= -1.0
    pyramids = height * (_dots(arm, arm) + moments[faces])
    return frozen_float(np.add.reduceat(pyramids, offsets[:-1]) / 5.0)


def _face_inertias(points: Float, offsets: Int, vertices: Int, vectors: Float, centres: Float) -> Float:
    """Return ∫ |x − m|² ``(n_faces,)`` of plane faces about their centroids m, by triangles from m."""
    sizes = np.diff(offsets)
    following = np.arange(1, len(vertices) + 1)
    following[offsets[1:] - 1] = offsets[:-1]
    a = points[vertices] - np.repeat(centres, sizes, axis=0)
    b = a[following]
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    normals = np.repeat(vectors / np.where(lengths > 0.0, lengths, 1.0), sizes, axis=0)
    square = _dots(a, a)
    squares = square + _dots(a, b) + square[following]
    found: Float = np.add.reduceat(_dots(np.cross(a, b), normals) * squares, offsets[:-1]) / 12.0
    return found


def _dots(a: Float, b: Float) -> Float:
    """Return the inner products of corresponding rows ``(n,)``, faster than sums over a short axis."""
    found: Float = np.einsum("ij,ij->i", a, b)
    return found
