"""Record of a mesh simplification, and the assembly of the simplified faces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.mesh.derived import Derived

_ROUNDING = 8  # rounding of points, in units in the last place of the largest coordinate


@dataclass(frozen=True, eq=False)
class Simplification:
    """Record of the changes that :meth:`~agglo_core.mesh.Mesh.simplified` made to a mesh.

    Attributes
    ----------
    tolerance : float
        Largest distance of a removed vertex from the new edge, relative to the smaller of the two cells.
    exact : bool
        True if the cells are unchanged; otherwise the mesh is not a coarsening of the old mesh.
    vertices_saved, faces_saved : int
        Number of removed face vertices and faces.
    points : (n_points,) int
        Old number per point.
    faces : (n_faces before,) int
        New face that contains or replaces each old face.
    measure_change : (n_cells,) float
        New minus old measure of each cell; rounding errors if ``exact``.
    held_back : int
        Interfaces that kept more vertices than necessary for the tolerance, to keep cells valid.

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
    """Arrays of a simplified mesh, with a map from old to new faces."""

    points: Int  # old numbers of the kept points
    face_offsets: Int
    face_vertices: Int
    leads: Int  # (n_faces,) first old face of each new face
    faces: Int  # (n_faces before,)
    held_back: int = 0


def rounding_of(mesh: Derived) -> float:
    """Return a bound of the rounding errors in the coordinates of a mesh."""
    return _ROUNDING * float(np.spacing(np.abs(mesh.points[mesh.face_vertices]).max()))


def assemble_faces(sizes: Int, vertices: Int, faces: Int, held_back: int = 0) -> Fewer:
    """Assemble face arrays with ``sizes`` vertices each, sorted by their first old face.

    Parameters
    ----------
    sizes : (k,) int
    vertices : (v,) int
    faces : (n_faces before,) int
        New face (of k) per old face.
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


def record_simplification(mesh: Derived, after: Derived, fewer: Fewer, tolerance: float) -> Simplification:
    """Record the changes between a mesh and its simplification ``after``."""
    n_used = len(np.unique(mesh.face_vertices))
    return Simplification(
        tolerance,
        tolerance == 0,
        n_used - len(fewer.points),
        mesh.n_faces - after.n_faces,
        fewer.points,
        fewer.faces,
        frozen_float(after.cell_measures - mesh.cell_measures),
        fewer.held_back,
    )
