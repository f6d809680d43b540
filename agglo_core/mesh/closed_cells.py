"""Checks that faces given one by one enclose cells of positive measure."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int, splitmix
from agglo_core.errors import MeshError
from agglo_core.mesh.checks import check_extent, name_cells
from agglo_core.mesh.derived import Derived
from agglo_core.mesh.geometry3d import sum_by

__all__ = ["check_cells"]

_CERTAIN = 1e-12  # far above rounding in a sum, over a bound of the sum of its absolute terms
_SHIFT = np.uint64(24)
_CLOSED = 1e-6  # a gap in the surface of a cell, over its area


def check_cells(mesh: Derived) -> None:
    """Raise MeshError unless the faces of every cell close and enclose a positive measure.

    Shapes and ranges of the arrays must have been checked before.
    """
    used = np.zeros(mesh.n_points, bool)
    used[mesh.face_vertices] = True
    check_extent(mesh.points if used.all() else mesh.points[used])
    count = np.bincount(mesh.face_cells.ravel() + 1, minlength=mesh.n_cells + 1)[1:]
    bare = np.flatnonzero(count == 0)
    if len(bare):
        raise MeshError(f"face_cells: {name_cells(bare)} of {mesh.n_cells} have no faces")
    open_, flat = _plane(mesh, count) if mesh.dim == 2 else (_gaping(mesh), np.arange(mesh.n_cells))
    if len(open_):
        raise MeshError(f"{name_cells(open_)}: the faces do not close")
    flat = flat[~(mesh.cell_measures[flat] > 0)] if len(flat) else flat
    if len(flat):
        raise MeshError(f"{name_cells(flat)}: no positive measure, or faces that are turned inside out")


def _plane(mesh: Derived, count: Int) -> tuple[Int, Int]:
    """Plane cells that are not closed, and those whose area is not positive beyond rounding.

    Cells have ``count (n_cells,)`` faces. Each vertex has a number of 40 bits that looks random. Summed along
    a closed boundary, where 64-bit floats are exact, the differences of heads and tails give 0; others do so
    by chance, once in 2^40.
    """
    number = (splitmix(np.arange(mesh.n_points, dtype=np.uint64)) >> _SHIFT).astype(np.float64)
    tail, head = number.take(mesh.face_vertices).reshape(-1, 2).T
    x, y = (np.ascontiguousarray(column).take(mesh.face_vertices) for column in mesh.local_points.T)
    cross = x[::2] * y[1::2] - x[1::2] * y[::2]
    owner, beyond = np.ascontiguousarray(mesh.face_cells[:, 0]), mesh.face_cells[:, 1] + 1  # 0 is outside
    n = mesh.n_cells

    def net(values: Float) -> Float:
        return frozen_float(np.bincount(owner, values, n) - np.bincount(beyond, values, n + 1)[1:])

    open_ = frozen_int(np.flatnonzero(net(head - tail)))
    return open_, np.flatnonzero(net(cross) <= _CERTAIN * count.max() * np.abs(cross).max())


def _gaping(mesh: Derived) -> Int:
    """Solid cells whose outward face vectors do not sum to zero."""
    owner, neighbour = mesh.face_cells.T
    inner = neighbour >= 0
    vector = mesh.face_normals * mesh.face_measures[:, None]
    cell = np.concatenate((owner, neighbour[inner]))
    gap = np.linalg.norm(sum_by(cell, np.concatenate((vector, -vector[inner])), mesh.n_cells), axis=1)
    size = np.bincount(cell, np.concatenate((mesh.face_measures, mesh.face_measures[inner])))
    return np.flatnonzero(~(gap <= _CLOSED * size))
