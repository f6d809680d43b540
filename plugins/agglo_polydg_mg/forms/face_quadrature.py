"""Gauss points on faces: on edges, or on the triangles of 3-D faces."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agglo_core.authoring import Field, Float, Int, Mask, Mesh, frozen_float, frozen_int
from agglo_core.fields.gauss_points import gauss, simplex_rule
from agglo_core.fields.simplices import triangles_of_faces
from agglo_core.fields.tensors import Tensor
from agglo_core.fields.values import per_cell, sample

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

    def part(self, pieces: Int | Mask) -> FaceRule:
        """Return the rule on some of the pieces."""
        faces, *rest = (each[pieces] for each in self)
        return FaceRule(frozen_int(faces), *(frozen_float(each) for each in rest))


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


class OnFaces(NamedTuple):
    """Coefficient on both sides of faces.

    Attributes
    ----------
    kappa : (f, 2, 1) or (t, 2, q) float
        n·κn, with rows as from :func:`face_coefficients`.
    directions : (rows, 2, 1 or q, d) float
        κn / (n·κn) for a tensor, with n outward from the owner on both sides. Without rows for a scalar,
        where it is n.
    """

    kappa: Float
    directions: Float


def on_both_sides(mesh: Mesh, kappa: Field | Tensor, faces: Int, n: int) -> OnFaces:
    """Return the coefficient on both sides of some faces, repeating the inner value at the boundary.

    A tensor has one row per piece of :func:`face_rule`, because normals may differ between triangles.
    """
    if not isinstance(kappa, Tensor):
        none = frozen_float(np.zeros((0, 2, 1, mesh.dim)))
        return OnFaces(face_coefficients(mesh, kappa, faces, n), none)
    # 1. Values on the pieces
    rule = face_rule(mesh, faces, 1 if kappa.by_cell else n)
    sides = _cells_of_faces(mesh, rule.faces)
    points, count = (None, 1) if kappa.by_cell else (_shifted(mesh, rule, sides), rule.points.shape[1])
    flat = None if points is None else points.reshape(-1, mesh.dim)
    values = kappa.at(flat, np.repeat(sides.ravel(), count))
    values = values.reshape(len(sides), 2, count, mesh.dim, mesh.dim)
    # 2. Co-normal vectors, and their parts along the normals
    conormals = np.einsum("tsqij,tj->tsqi", values, rule.normals)
    normal_parts = np.einsum("tsqi,ti->tsq", conormals, rule.normals)
    normal_parts[normal_parts == 0.0] = 1.0  # triangles without area
    return OnFaces(frozen_float(normal_parts), frozen_float(conormals / normal_parts[..., None]))


def _shifted(mesh: Mesh, rule: FaceRule, sides: Int) -> Float:
    """Return points ``(t, 2, q, d)`` of a face rule in user coordinates, moved into either cell."""
    size = mesh.face_measures[rule.faces, None]
    size = size if mesh.dim == 2 else np.sqrt(size)
    away = _INTO * (rule.normals * size)[:, None, None]
    outward = np.where(sides[:, :1] == sides, -1.0, 1.0)[:, :, None, None]
    return np.asarray(rule.points[:, None] + outward * away + mesh.origin)


def face_coefficients(mesh: Mesh, kappa: Field | Tensor, faces: Int, n: int) -> Float:
    """Return κ, or n·κn for a tensor, on both sides of faces, repeating the inner value at the boundary.

    Cell values are used directly, one row per face ``(f, 2, 1)``. A callable is sampled at the points of
    :func:`face_rule`, one row per piece ``(t, 2, q)``, shifted into either cell by 1e-7 of the face size.
    """
    if isinstance(kappa, Tensor):
        return on_both_sides(mesh, kappa, faces, n).kappa
    if not callable(kappa):
        return frozen_float(per_cell(kappa, mesh.n_cells, "kappa")[_cells_of_faces(mesh, faces)][:, :, None])
    rule = face_rule(mesh, faces, n)
    sides = _cells_of_faces(mesh, rule.faces)
    values = sample(kappa, _shifted(mesh, rule, sides).reshape(-1, mesh.dim), "kappa")
    return frozen_float(values.reshape(len(sides), 2, rule.points.shape[1]))


def on_pieces(coefficients: Float, faces: Int, rule: FaceRule) -> Float:
    """Repeat the rows of :func:`face_coefficients` for each piece of a face rule: triangles in 3-D."""
    if len(coefficients) == len(rule.faces):
        return coefficients
    return frozen_float(coefficients[np.searchsorted(faces, rule.faces)])


def _cells_of_faces(mesh: Mesh, faces: Int) -> Int:
    owner, other = mesh.face_cells[faces].T
    return frozen_int(np.stack((owner, np.where(other < 0, owner, other)), axis=1))
