"""Gauss points on faces: on edges, or on the triangles of 3-D faces."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agglo_core.authoring import Field, Float, Int, Mesh, frozen_float, frozen_int
from agglo_polydg_mg.space.gauss_points import gauss, simplex_rule
from agglo_polydg_mg.space.quadrature import per_cell, sample
from agglo_polydg_mg.space.solid_geometry import triangles_of_faces

_INTO = 1e-7  # shift into a cell, relative to the face size: more than rounding, less than any detail of κ


class FaceRule(NamedTuple):
    """Gauss points on face pieces: in 2-D the faces themselves, in 3-D their triangles.

    Attributes
    ----------
    faces : (t,) int
        Face of each piece.
    points : (t, q, d) float
        Relative to the mesh origin; in 2-D from the first face vertex to the second.
    weights : (t, q) float
        They sum to the face measures.
    normals : (t, d) float
        Unit normals, outward from the owner.
    """

    faces: Int
    points: Float
    weights: Float
    normals: Float


def face_rule(mesh: Mesh, faces: Int, n: int) -> FaceRule:
    """Return a Gauss rule on some faces, exact up to degree 2n − 1."""
    # 2-D: points along each edge
    if mesh.dim == 2:
        start, end = (mesh.local_points[mesh.face_pairs[faces, k]][:, None] for k in range(2))
        along = 0.5 * (1 + gauss(n)[0])[:, None]
        weights = mesh.face_measures[faces][:, None] * gauss(n)[1] / 2
        points = frozen_float(start + along * (end - start))
        return FaceRule(faces, points, frozen_float(weights), frozen_float(mesh.face_normals[faces]))
    # 3-D: points on the triangles, with signed areas where a face is not convex
    triangle_faces, corners = triangles_of_faces(mesh, faces)
    reference, weights = simplex_rule(2, n)
    u, v = (corners[:, None, k] - corners[:, None, 0] for k in (1, 2))
    points = corners[:, None, 0] + reference[:, :1] * u + reference[:, 1:] * v
    across = np.cross(u[:, 0], v[:, 0])
    size = np.linalg.norm(across, axis=1)
    size = np.where((across * mesh.face_normals[triangle_faces]).sum(axis=1) < 0.0, -size, size)
    normals = across / np.where(size == 0.0, 1.0, size)[:, None]
    return FaceRule(
        triangle_faces, frozen_float(points), frozen_float(size[:, None] * weights), frozen_float(normals)
    )


def all_faces(mesh: Mesh) -> Int:
    """Return all face indices ``(n_faces,)``."""
    return frozen_int(np.arange(mesh.n_faces))


def face_coefficients(mesh: Mesh, kappa: Field, faces: Int, n: int) -> Float:
    """Return κ on both sides of some faces, repeating the inner value at the boundary.

    Cell values are used directly, one row per face ``(f, 2, 1)``. A callable is sampled at the points of
    :func:`face_rule`, one row per piece ``(t, 2, q)``, shifted into either cell by 1e-7 of the face size.
    """
    if not callable(kappa):
        return frozen_float(per_cell(kappa, mesh.n_cells, "kappa")[_cells_of_faces(mesh, faces)][:, :, None])
    rule = face_rule(mesh, faces, n)
    sides, points = _cells_of_faces(mesh, rule.faces), rule.points[:, None]
    size = mesh.face_measures[rule.faces, None]
    size = size if mesh.dim == 2 else np.sqrt(size)
    away = _INTO * (rule.normals * size)[:, None, None]
    outward = np.where(sides[:, :1] == sides, -1.0, 1.0)[:, :, None, None]
    values = sample(kappa, (points + outward * away).reshape(-1, mesh.dim) + mesh.origin, "kappa")
    return frozen_float(values.reshape(len(sides), 2, -1))


def on_pieces(coefficients: Float, faces: Int, rule: FaceRule) -> Float:
    """Repeat the rows of :func:`face_coefficients` for each piece of a face rule: triangles in 3-D."""
    if len(coefficients) == len(rule.faces):
        return coefficients
    return frozen_float(coefficients[np.searchsorted(faces, rule.faces)])


def _cells_of_faces(mesh: Mesh, faces: Int) -> Int:
    owner, other = mesh.face_cells[faces].T
    return frozen_int(np.stack((owner, np.where(other < 0, owner, other)), axis=1))
