"""Sides of polyhedra: what two cells share is one side, however many faces it is made of.

An agglomerate drags thousands of small faces along, and has some fifteen neighbours. Integrals over faces are
added up per side before anything is made of them, and a side has one penalty.
"""

from __future__ import annotations

from typing import NamedTuple

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
