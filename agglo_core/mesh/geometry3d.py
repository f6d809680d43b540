"""Geometry of polyhedra from their faces: areas, volumes, centroids, vertices (vectorised numpy)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from agglo_core.arrays import Float, Index, Int, frozen_float, frozen_index, frozen_int

if TYPE_CHECKING:
    from agglo_core.mesh import Mesh

__all__ = ["face_moments", "polyhedron_moments", "polyhedron_vertices", "pyramid_moments", "sum_by"]


def face_moments(points: Float, offsets: Int, vertices: Int) -> tuple[Float, Float]:
    """Area vectors and centroids of polygonal faces ``(F, 3)``, by fans of triangles."""
    sizes = np.diff(offsets)
    face = np.repeat(np.arange(len(sizes)), np.maximum(sizes - 2, 0))
    rank = np.arange(len(face)) - np.repeat(np.cumsum(sizes - 2) - (sizes - 2), sizes - 2)
    a = points[vertices[offsets[face]]]
    b = points[vertices[offsets[face] + rank + 1]]
    c = points[vertices[offsets[face] + rank + 2]]
    vector = 0.5 * np.cross(b - a, c - a)
    total = sum_by(face, vector, len(sizes))
    length = np.linalg.norm(total, axis=1)
    unit = total / np.where(length > 0, length, 1.0)[:, None]
    share = (vector * unit[face]).sum(axis=1)
    centre = sum_by(face, share[:, None] * (a + b + c) / 3.0, len(sizes))
    safe = np.where(length > 0, length, 1.0)[:, None]
    centre = np.where(length[:, None] > 0, centre / safe, points[vertices[offsets[:-1]]])
    return frozen_float(total), frozen_float(centre)


def sum_by(groups: Int, values: Float, n: int) -> Float:
    """Sums ``(n, d)`` of the rows ``values (m, d)`` of each group."""
    columns = [np.bincount(groups, weights=column, minlength=n) for column in values.T]
    return np.stack(columns, axis=1)


def polyhedron_moments(mesh: Mesh) -> tuple[Float, Float]:
    """Volumes and centroids by the divergence theorem: pyramids over the faces."""
    vector, centre = face_moments(mesh.local_points, mesh.face_offsets, mesh.face_vertices)
    offsets, faces = mesh.cell_faces
    cells = np.repeat(np.arange(mesh.n_cells), np.diff(offsets))
    sign = np.where(mesh.face_cells[faces, 0] == cells, 1.0, -1.0)
    return pyramid_moments(cells, vector[faces] * sign[:, None], centre[faces], mesh.n_cells)


def pyramid_moments(cells: Int, vector: Float, centre: Float, n: int) -> tuple[Float, Float]:
    """Volumes and centroids of n cells from outward area vectors and centroids of their half-faces."""
    count = np.bincount(cells, minlength=n)[:, None]
    apex = sum_by(cells, centre, n) / count
    arm = centre - apex[cells]
    thrice = (arm * vector).sum(axis=1)
    total = np.bincount(cells, weights=thrice, minlength=n) / 3.0
    moment = sum_by(cells, 0.25 * thrice[:, None] * arm, n)
    safe = np.where(total != 0, total, 1.0)[:, None]
    return frozen_float(total), frozen_float(apex + moment / safe)


def polyhedron_vertices(mesh: Mesh) -> tuple[Int, Index]:
    """Distinct vertices of each cell as CSR."""
    offsets, faces = mesh.cell_faces
    sizes = np.diff(mesh.face_offsets)[faces]
    start = np.cumsum(sizes) - sizes
    take = np.arange(sizes.sum()) + np.repeat(mesh.face_offsets[faces] - start, sizes)
    cells = np.repeat(np.repeat(np.arange(mesh.n_cells), np.diff(offsets)), sizes)
    keys = np.unique(cells * mesh.n_points + mesh.face_vertices[take])
    counts = np.bincount(keys // mesh.n_points, minlength=mesh.n_cells)
    return frozen_int(np.concatenate(([0], np.cumsum(counts)))), frozen_index(keys % mesh.n_points)
