"""Meshes with fewer vertices: straight runs of faces made one, and interfaces replaced by simpler ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.mesh.derived import Derived

_ROUNDING = 8  # units in the last place of the largest coordinate


@dataclass(frozen=True, eq=False)
class Simplification:
    """Record of the changes by :meth:`~agglo_core.mesh.Mesh.simplified`.

    Attributes
    ----------
    tolerance : float
        How far from its place a vertex that was left out may lie, relative to the smaller of the two cells.
    exact : bool
        Whether the cells are those of the mesh before; otherwise the mesh is none of its coarsenings.
    vertices_saved, faces_saved : int
        Vertices of faces, and faces, that there were more before.
    points : (n_points,) int
        Number of each point in the mesh before.
    faces : (n_faces before,) int
        Face that each face of the mesh before is part of, or has been replaced by.
    measure_change : (n_cells,) float
        Measure of each cell now, less that before: rounding where ``exact``.
    held_back : int
        Interfaces that kept more vertices than the tolerance asks for, as cells would have become invalid.

    Examples
    --------
    >>> from agglo_core import samples
    >>> change = samples.squares(4).coarsen([0] * 8 + [1] * 8).simplified().simplification
    >>> change.exact, change.faces_saved
    (True, 13)
    """

    tolerance: float
    exact: bool
    vertices_saved: int
    faces_saved: int
    points: Int
    faces: Int
    measure_change: Float
    held_back: int = 0


class Fewer(NamedTuple):
    """A mesh with fewer faces, as :class:`~agglo_core.mesh.Mesh` holds it, and which faces became which."""

    points: Int  # those kept, by their numbers in the mesh before
    face_offsets: Int
    face_vertices: Int
    leads: Int  # (n_faces,) the first of the faces before that each one was
    faces: Int  # (n_faces before,)
    held_back: int = 0


def rounding_of(mesh: Derived) -> float:
    """Distance by which rounding may have moved the points of a mesh."""
    return _ROUNDING * float(np.spacing(np.abs(mesh.points[mesh.face_vertices]).max()))


def packed(sizes: Int, vertices: Int, faces: Int, held_back: int = 0) -> Fewer:
    """Faces of so many of the ``vertices`` each, in the order of the first face that each one was.

    Parameters
    ----------
    sizes : (k,) int
    vertices : (v,) int
    faces : (n_faces before,) int
        Which of the k faces each face before is part of.
    """
    leads = np.full(len(sizes), len(faces))
    np.minimum.at(leads, faces, np.arange(len(faces)))
    order = np.argsort(leads)
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    starts = (np.cumsum(sizes) - sizes)[order]
    offsets = np.concatenate(([0], np.cumsum(sizes[order])))
    taken = vertices[np.arange(offsets[-1]) + np.repeat(starts - offsets[:-1], sizes[order])]
    points, renumbered = np.unique(taken, return_inverse=True)
    arrays = (points, offsets, renumbered, leads[order], number[faces])
    points, offsets, renumbered, leads, faces = map(frozen_int, arrays)
    return Fewer(points, offsets, renumbered, leads, faces, held_back)


def recorded(mesh: Derived, after: Derived, fewer: Fewer, tolerance: float) -> Simplification:
    """The record of a mesh ``after`` it was simplified."""
    used = len(np.unique(mesh.face_vertices))
    return Simplification(
        tolerance,
        tolerance == 0,
        used - len(fewer.points),
        mesh.n_faces - after.n_faces,
        fewer.points,
        fewer.faces,
        frozen_float(after.cell_measures - mesh.cell_measures),
        fewer.held_back,
    )
