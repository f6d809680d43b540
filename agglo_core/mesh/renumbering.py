"""Renumber the cells, faces and points of a mesh."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, frozen_float, frozen_index, frozen_int, plain_array
from agglo_core.errors import MeshError
from agglo_core.mesh.derived import Derived


class Renumbered(NamedTuple):
    """Mesh arrays after renumbering, with old cell and face indices."""

    points: Float
    face_offsets: Int
    face_vertices: Int
    face_cells: Int
    old_cells: Int
    old_faces: Int


def renumber_arrays(mesh: Derived, cells: ArrayLike) -> Renumbered:
    """Reorder the cells of a mesh, and number faces and points by first use.

    Raises
    ------
    MeshError
        If ``cells (n_cells,)`` is not a permutation.
    """
    from agglo_core.compiled.graphs import number_as_met, take_rows

    order, number = _numbers(cells, mesh.n_cells)
    offsets, own = mesh.cell_faces
    faces = frozen_int(number_as_met(take_rows(offsets, frozen_index(own), order)[1], mesh.n_faces)[1])
    face_offsets, vertices = take_rows(mesh.face_offsets, frozen_index(mesh.face_vertices), faces)
    vertices, points = number_as_met(vertices, mesh.n_points)
    return Renumbered(
        frozen_float(mesh.points.take(points, axis=0)),
        frozen_int(face_offsets),
        frozen_int(vertices),
        frozen_int(number.take(mesh.face_cells.take(faces, axis=0))),
        order,
        faces,
    )


def _numbers(cells: ArrayLike, n: int) -> tuple[Int, Int]:
    """Return the checked cell order, and the new index per cell.

    The last entry is the outside (−1).
    """
    order = plain_array(cells, "cells")
    number = np.full(n + 1, -1)
    if order.shape == (n,) and order.dtype.kind in "iu" and order.min() >= 0 and order.max() < n:
        number[order] = np.arange(n)
    if n and number[:n].min() < 0:
        raise MeshError(f"an order of the cells must contain each of 0..{n - 1} once")
    return frozen_int(order), frozen_int(number)
