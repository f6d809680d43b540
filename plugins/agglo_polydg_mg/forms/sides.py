"""Cell sides: the common boundary of two cells is one side, however many faces it has.

An agglomerate has thousands of small faces, and some fifteen neighbours. In 3-D face integrals are summed
per side before further processing, and a side has one penalty. In 2-D collinear edges between two cells are
merged into one edge.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from agglo_core.authoring import Int, Mesh, frozen_int

_STRAIGHT: Final = "_with_straight_sides"


class Sides(NamedTuple):
    """Sides of the cells in a 3-D mesh, each the faces shared with one neighbour.

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
    """Group the faces of a 3-D mesh into sides, one per pair of neighbours.

    At the boundary a cell has one side per main direction of its face normals.

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
    """Return the mesh with collinear edges between the same two cells merged.

    The penalty required for the sides then does not depend on their subdivision. Agglomerates have such
    edges, other meshes almost never: a test of the edges at each vertex decides.
    """
    if mesh.dim != 2:
        return mesh
    kept: dict[str, Mesh] = vars(mesh)  # like the derived arrays of a mesh
    if _STRAIGHT not in kept:
        simpler = mesh.simplified() if _has_runs(mesh) else mesh
        kept[_STRAIGHT] = mesh if simpler.n_faces == mesh.n_faces else simpler
    return kept[_STRAIGHT]


def _has_runs(mesh: Mesh) -> bool:
    """Return True if two edges between the same cells meet at a vertex without other edges."""
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
