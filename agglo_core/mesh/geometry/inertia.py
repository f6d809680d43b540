"""Compute cell inertias from faces by the divergence theorem, exact for any shape."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float
from agglo_core.threads import mapped

_CELLS = 4096
"""Cells per chunk and call of a thread: temporary arrays stay in the cache (benchmarks/threads.py)."""


def plane_inertias(
    points: Float, face_pairs: Int, face_cells: Int, offsets: Int, faces: Int, centroids: Float
) -> Float:
    """Return ∫ |x − C|² ``(n,)`` of polygons, by triangles between their faces and the centroid C.

    Cell c has ``faces[offsets[c]:offsets[c + 1]]``; the triangle C, a, b has a × b (a² + a·b + b²) / 12.
    """
    starts = np.arange(0, len(centroids), _CELLS)

    def of_cells(first: int) -> Float:
        rows = offsets[first : first + _CELLS + 1]
        some = faces[rows[0] : rows[-1]]
        cells = np.repeat(np.arange(first, first + len(rows) - 1), np.diff(rows))
        pairs, around = face_pairs[some], centroids[cells]
        a, b = points[pairs[:, 0]] - around, points[pairs[:, 1]] - around
        cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        cross[face_cells[some, 0] != cells] *= -1.0
        squares = _dots(a, a) + _dots(a, b) + _dots(b, b)
        found: Float = np.add.reduceat(cross * squares, rows[:-1] - rows[0]) / 12.0
        return found

    return frozen_float(np.concatenate([np.empty(0), *mapped(of_cells, starts.tolist())]))


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
