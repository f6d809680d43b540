"""A mesh, or some cells of it, as one piece of VTK's unstructured grids."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, frozen_float, frozen_int
from agglo_core.io.tags import BRIDGES
from agglo_core.io.to_mesh.listed_faces import face_fields
from agglo_core.io.to_mesh.plain_cells import used_points
from agglo_core.io.vtk.arrays import DERIVED
from agglo_core.io.vtk.cells import POLYHEDRON, Cells, cells_of, these_cells
from agglo_core.io.vtk.document import Piece
from agglo_core.mesh import Mesh

FaceArrays = Callable[[Cells, Int | None], dict[str, NDArray[Any]]]
"""Arrays by name with the faces of polyhedra, given the cells and the numbers of points in the file."""


class Share(NamedTuple):
    """Cells of a mesh that are a piece of a larger one.

    Attributes
    ----------
    cells : (n_own,) int
        Which cells of the mesh they are, in their order there.
    cell_ids : (n_own,) int
        Their numbers in the larger mesh.
    point_ids : (n_points,) int
        Those of all points.
    usual : mapping of str to int
        For each face tag the value of all faces that no piece lists.
    """

    cells: Int
    cell_ids: Int
    point_ids: Int
    usual: Mapping[str, int]


def piece_of(
    mesh: Mesh,
    faces_of: FaceArrays,
    tags: Mapping[str, Int],
    derived: Mapping[str, NDArray[Any]],
    share: Share | None = None,
) -> Piece:
    """The cells of a mesh with tags and derived data of its own, or those of a share with data of theirs."""
    cells = cells_of(mesh) if share is None else these_cells(cells_of(mesh), share.cells)
    data = dict(tags)
    if (cells.loops > 1).any():
        data[BRIDGES] = cells.loops
    if share is None:
        points, number = used_points(mesh)
        ids: tuple[Int | None, Int | None] = (None, None)
        fields = face_fields(mesh, number)
    else:
        kept, number = _points_of(cells, mesh.n_points)
        points, ids = frozen_float(mesh.points[kept]), (frozen_int(share.point_ids[kept]), share.cell_ids)
        fields = face_fields(mesh, number, share.cells, share.usual)
    faces = faces_of(cells, number) if (cells.types == POLYHEDRON).any() else {}
    corners = {"connectivity": numbered(cells.vertices, number), "offsets": cells.offsets[1:]}
    arrays: dict[str, NDArray[Any]] = {**corners, "types": cells.types, **faces}
    piece = Piece(points, arrays, {}, data, derived, DERIVED, fields)
    return piece._replace(point_ids=ids[0], cell_ids=ids[1])


def _points_of(cells: Cells, n_points: int) -> tuple[Int, Int]:
    """The points of cells, and the number of each point of the mesh among them."""
    used = np.zeros(n_points, bool)
    used[cells.vertices] = used[cells.solids.vertices] = True
    return frozen_int(np.flatnonzero(used)), frozen_int(np.cumsum(used) - 1)


def numbered(vertices: Int, number: Int | None) -> Int:
    """Points by their numbers in the file."""
    return vertices if number is None else frozen_int(number[vertices])
