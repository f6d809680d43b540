"""Checks that the arrays of a stored mesh form a mesh: another program may have written the file."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Int, Mask, frozen_int, splitmix
from agglo_core.errors import FileError
from agglo_core.io.plain_cells import half_faces
from agglo_core.mesh import Mesh
from agglo_core.mesh.checks import name_cells
from agglo_core.mesh.elements import take_cells
from agglo_core.mesh.geometry3d import face_moments, sum_by
from agglo_core.mesh.shells import TWO_SHELLS, outward_signs

__all__ = ["check_arrays", "check_directions"]

_CERTAIN = 1e-12  # far above rounding in a sum, over the sum of its absolute terms
_CLOSED = 1e-6  # a gap in the surface of a cell, over its area


def check_arrays(mesh: Mesh) -> None:
    """Raise FileError unless indices are within their range and the faces of every cell close."""
    _check_ranges(mesh)
    open_ = _unbalanced(mesh) if mesh.dim == 2 else _gaping(mesh)
    if len(open_):
        raise FileError(f"{name_cells(open_)}: the faces do not close")
    flat = np.flatnonzero(~_surely_positive(mesh))
    flat = flat[~(mesh.cell_measures[flat] > 0)] if len(flat) else flat
    if len(flat):
        raise FileError(f"{name_cells(flat)}: no positive measure; the faces are turned inside out")


def check_directions(mesh: Mesh) -> None:
    """Raise FileError for a solid cell with a shell whose faces look into the cell, such as that of a cavity.

    The arrays are checked already, so that only a cell with several shells can have one.
    """
    if mesh.dim == 2 or not (np.diff(mesh.cell_faces[0]) >= TWO_SHELLS).any():
        return
    cells = frozen_int(np.flatnonzero(np.diff(mesh.cell_faces[0]) >= TWO_SHELLS))
    solids = take_cells(half_faces(mesh), cells)
    moments = face_moments(mesh.local_points, solids.loop_offsets, solids.vertices)
    cell = frozen_int(np.repeat(np.arange(len(cells)), np.diff(solids.cell_offsets)))
    sign, unsure, _ = outward_signs(
        cell, solids.loop_offsets, solids.vertices, mesh.local_points, *moments, 0.0
    )
    turned = np.setdiff1d(cell[sign < 0], unsure)
    if len(turned):
        raise FileError(
            f"{name_cells(cells[turned])}: faces of a shell, such as that of a cavity, look into the cell"
        )


def _check_ranges(mesh: Mesh) -> None:
    offsets, cells = mesh.face_offsets, mesh.face_cells
    if not len(cells) or cells.shape[1] != 2 or offsets[0] != 0 or (np.diff(offsets) < mesh.dim).any():
        raise FileError("array 'face_offsets' or 'face_cells' is corrupt")
    if mesh.dim == 2 and (np.diff(offsets) != 2).any():
        raise FileError("array 'face_offsets': faces of a 2-D mesh have two vertices")
    if mesh.face_vertices.min() < 0 or mesh.face_vertices.max() >= mesh.n_points:
        raise FileError(f"array 'face_vertices' uses points outside 0..{mesh.n_points - 1}")
    if cells[:, 0].min() < 0 or cells[:, 1].min() < -1 or mesh.n_cells > cells.size:
        raise FileError("array 'face_cells' holds wrong cell numbers")
    if (cells[:, 0] == cells[:, 1]).any():
        raise FileError("array 'face_cells' holds a face with the same cell on both sides")
    if (np.bincount(cells[cells >= 0], minlength=mesh.n_cells) == 0).any():
        raise FileError("array 'face_cells' leaves out cells")
    if not np.isfinite(mesh.points).all():
        raise FileError("array 'points' holds coordinates that are not finite")


def _unbalanced(mesh: Mesh) -> Int:
    """Plane cells with a vertex that their edges do not enter as often as they leave it.

    Each vertex has a number of 64 bits that looks random. Summed along a closed boundary the differences of
    heads and tails give 0, modulo 2^64; others do so by chance, once in 2^64.
    """
    number = splitmix(np.arange(mesh.n_points, dtype=np.uint64))[mesh.face_vertices]
    step = number[1::2] - number[::2]
    owner, neighbour = mesh.face_cells.T
    total = np.zeros(mesh.n_cells + 1, np.uint64)  # the last is outside, -1
    np.add.at(total, owner, step)
    np.subtract.at(total, neighbour, step)
    return frozen_int(np.flatnonzero(total[:-1]))


def _surely_positive(mesh: Mesh) -> Mask:
    """Plane cells whose area is positive beyond rounding; it costs a third of the measures themselves."""
    if mesh.dim == 3:
        return np.zeros(mesh.n_cells, bool)
    ends = mesh.local_points.take(mesh.face_pairs, axis=0)
    cross = ends[:, 0, 0] * ends[:, 1, 1] - ends[:, 1, 0] * ends[:, 0, 1]
    owner, neighbour = mesh.face_cells[:, 0], mesh.face_cells[:, 1] + 1  # 0 is outside
    n = mesh.n_cells
    area = np.bincount(owner, cross, n) - np.bincount(neighbour, cross, n + 1)[1:]
    size = np.abs(cross)
    terms = np.bincount(owner, size, n) + np.bincount(neighbour, size, n + 1)[1:]
    return np.asarray(area > _CERTAIN * terms)


def _gaping(mesh: Mesh) -> Int:
    """Solid cells whose outward face vectors do not sum to zero."""
    owner, neighbour = mesh.face_cells.T
    inner = neighbour >= 0
    vector = mesh.face_normals * mesh.face_measures[:, None]
    cell = np.concatenate((owner, neighbour[inner]))
    gap = np.linalg.norm(sum_by(cell, np.concatenate((vector, -vector[inner])), mesh.n_cells), axis=1)
    size = np.bincount(cell, np.concatenate((mesh.face_measures, mesh.face_measures[inner])))
    return np.flatnonzero(~(gap <= _CLOSED * size))
