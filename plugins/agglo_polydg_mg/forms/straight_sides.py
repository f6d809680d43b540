"""Sides of cells as they are, however many edges of the mesh they are made of."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Mesh


def with_straight_sides(mesh: Mesh) -> Mesh:
    """The mesh, or if some of its edges continue one another between the same cells, that where they are one.

    What cells ask of the penalty of their sides then does not depend on how these are divided. Agglomerates
    have such edges, other meshes nearly never: that is found out from the edges at each vertex.
    """
    if mesh.dim != 2 or not _has_runs(mesh):
        return mesh
    simpler = mesh.simplified()
    return mesh if simpler.n_faces == mesh.n_faces else simpler


def _has_runs(mesh: Mesh) -> bool:
    """Whether two edges with the same cells beside them meet at a vertex that no other has."""
    degree = np.bincount(mesh.face_vertices, minlength=mesh.n_points)
    pairs = mesh.face_pairs
    lone = np.flatnonzero((degree[pairs] == 2).any(axis=1))
    if len(lone) == 0:
        return False
    vertices, cells = pairs[lone].ravel(), np.repeat(np.sort(mesh.face_cells[lone], axis=1), 2, axis=0)
    chosen = degree[vertices] == 2
    vertices, cells = vertices[chosen], cells[chosen]
    order = np.argsort(vertices, kind="stable")
    vertices, cells = vertices[order], cells[order]
    beside = (vertices[1:] == vertices[:-1]) & (cells[1:] == cells[:-1]).all(axis=1)
    return bool(beside.any())
