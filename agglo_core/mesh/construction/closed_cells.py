"""Check that the faces of each cell are closed and enclose a positive measure."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Int, frozen_float, frozen_int
from agglo_core.errors import MeshError
from agglo_core.mesh.checks import check_extent, name_cells
from agglo_core.mesh.derived import Derived
from agglo_core.mesh.geometry.solid_cells import sum_by

#: Area relative to the sum of its absolute terms, far above the rounding bound of 2e-16 per face
_CERTAIN = 1e-11
_CLOSED = 1e-6  # largest gap in the surface of a cell, relative to its area


def check_cells(mesh: Derived) -> None:
    """Raise MeshError unless the faces of every cell are closed and enclose a positive measure.

    Shapes and ranges of the arrays must be valid.
    """
    open_cells, flat = _plane(mesh) if mesh.dim == 2 else _solid(mesh)
    if len(flat):
        count = np.bincount(mesh.face_cells.ravel() + 1, minlength=mesh.n_cells + 1)[1:]
        empty = flat[count[flat] == 0]
        if len(empty):
            raise MeshError(f"face_cells: {name_cells(empty)} of {mesh.n_cells} have no faces")
    if len(open_cells):
        raise MeshError(f"{name_cells(open_cells)}: the faces do not close")
    flat = flat[~(mesh.cell_measures[flat] > 0)] if len(flat) else flat
    if len(flat):
        raise MeshError(f"{name_cells(flat)}: no positive measure, or faces that are turned inside out")


def check_volumes(mesh: Derived, numbers: Int) -> None:
    """Raise MeshError unless all volumes are positive.

    A warped face is a fan of triangles that depends on its first vertex, and two cells share one fan. So a
    cell that was oriented by its own loops may still be inside out. ``numbers`` are the cells in messages.
    """
    inverted = np.flatnonzero(~(mesh.cell_measures > 0))
    if len(inverted):
        named = name_cells(numbers[inverted])
        raise MeshError(f"{named}: the faces are too warped to enclose a positive volume")


def _plane(mesh: Derived) -> tuple[Int, Int]:
    """Return the 2-D cells that are not closed, and those whose area is not positive beyond rounding.

    The closedness test uses hashes: an open cell passes with probability 2^−64.
    """
    from agglo_core.mesh.kernels.face_sums import add_faces

    gap, area = np.zeros(mesh.n_cells, np.uint64), np.zeros((mesh.n_cells, 2))
    box = add_faces(mesh.points, mesh.face_vertices, mesh.face_cells, gap, area)
    check_extent(frozen_float(box).reshape(2, 2))
    return frozen_int(np.flatnonzero(gap)), frozen_int(np.flatnonzero(~(area[:, 0] > _CERTAIN * area[:, 1])))


def _solid(mesh: Derived) -> tuple[Int, Int]:
    """Return the 3-D cells that are not closed, and all cells as candidates for zero volume.

    The caller tests the volumes, which are not yet computed.
    """
    used = np.zeros(mesh.n_points, bool)
    used[mesh.face_vertices] = True
    check_extent(mesh.points if used.all() else mesh.points[used])
    return _find_open_cells(mesh), frozen_int(np.arange(mesh.n_cells))


def _find_open_cells(mesh: Derived) -> Int:
    """Return the 3-D cells whose outward area vectors do not sum to zero."""
    owner, neighbour = mesh.face_cells.T
    inner = neighbour >= 0
    vector = mesh.face_normals * mesh.face_measures[:, None]
    cell = np.concatenate((owner, neighbour[inner]))
    gap = np.linalg.norm(sum_by(cell, np.concatenate((vector, -vector[inner])), mesh.n_cells), axis=1)
    size = np.bincount(cell, np.concatenate((mesh.face_measures, mesh.face_measures[inner])))
    return np.flatnonzero(~(gap <= _CLOSED * size))
