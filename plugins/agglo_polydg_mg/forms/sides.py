"""Sides of cells: what two cells share is one side, however many faces it is made of.

An agglomerate has thousands of small faces, and some fifteen neighbours. In 3-D integrals over faces are
added up per side before anything is made of them, and a side has one penalty. In 2-D edges that continue one
another between two cells become one edge."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agglo_core.authoring import Int, Mesh, frozen_int


class Sides(NamedTuple):
    """Sides of the cells of a mesh in 3-D, by cells.

    Attributes
    ----------
    offsets : (n_sides + 1,) int
        Side s has the faces ``faces[offsets[s]:offsets[s + 1]]``.
    faces : (n_faces,) int
    cells : (n_sides, 2) int
        Both cells, the lower number first; −1 outside the domain.
    cell_offsets : (n_cells + 1,) int
        Cell c has the sides ``cell_sides[cell_offsets[c]:cell_offsets[c + 1]]``.
    cell_sides : (m,) int
    of_faces : (n_faces,) int
        Side of each face.
    """

    offsets: Int
    faces: Int
    cells: Int
    cell_offsets: Int
    cell_sides: Int
    of_faces: Int


def sides_of(mesh: Mesh) -> Sides:
    """The sides of a mesh in 3-D; at the boundary a cell has one for each direction its faces look to most.

    Examples
    --------
    >>> from agglo_core import samples
    >>> from agglo_polydg_mg.forms.sides import sides_of
    >>> halves = samples.boxes(2).coarsen([0, 0, 0, 0, 1, 1, 1, 1])
    >>> halves.n_faces, sides_of(halves).cells.tolist()
    (28, [[0, -1], [0, -1], [0, -1], [0, 1], [0, -1], [0, -1], [1, -1], [1, -1], [1, -1], [1, -1], [1, -1]])
    """
    from agglo_polydg_mg.forms.side_kernels import sides_of_cells

    found = sides_of_cells(*mesh.cell_faces, mesh.face_cells, mesh.face_normals)
    return Sides(*(frozen_int(each) for each in found))


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
