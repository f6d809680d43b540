"""Tags of outer edges that a file lists by their end points."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.mesh import Mesh


def tagged_outside(mesh: Mesh, points: Float, pairs: Int, values: Int) -> Int:
    """Tag ``(n_faces,)`` of the outer edges of a plane mesh, −1 on all others.

    Parameters
    ----------
    mesh : Mesh
    points : (n, 2) float
        The points of the file: those of the mesh may have other numbers.
    pairs : (k, 2) int
        End points of edges, in either order; those that are no outer edges are passed over.
    values : (k,) int
        Their tags.
    """
    tag = np.full(mesh.n_faces, -1)
    outer = np.flatnonzero(mesh.face_cells[:, 1] < 0)
    own = _ordered(mesh.points[mesh.face_pairs[outer]])
    given = _ordered(points[pairs])
    order = np.lexsort(own.T)
    rows = np.concatenate((own[order], given))
    number = np.unique(rows, axis=0, return_inverse=True)[1].ravel()
    face = np.full(number.max(initial=-1) + 1, -1)
    face[number[: len(outer)]] = outer[order]
    found = face[number[len(outer) :]]
    tag[found[found >= 0]] = values[found >= 0]
    return frozen_int(tag)


def _ordered(ends: Float) -> Float:
    """Coordinates of both ends of edges ``(k, 4)``, the lower left one first."""
    first, second = ends[:, 0] + 0.0, ends[:, 1] + 0.0
    swap = (first[:, 0] > second[:, 0]) | ((first[:, 0] == second[:, 0]) & (first[:, 1] > second[:, 1]))
    return frozen_float(
        np.where(swap[:, None], np.hstack((second, first)), np.hstack((first, second))).reshape(-1, 4)
    )
