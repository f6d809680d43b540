"""Geometry of plane cells and what they share, in one pass; what a pass over cells costs is cache misses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Index, Int, frozen_float, frozen_index, frozen_int

__all__ = ["Neighbours", "PlaneCells", "plane_cells"]


class Neighbours(NamedTuple):
    """Cells that share faces, both directions, and what is shared with nobody.

    The neighbours of cell c are ``indices[indptr[c]:indptr[c + 1]]``, each once, and ``interface`` is the
    measure of all faces shared with that neighbour; ``boundary (n_cells,)`` that of the outer faces.
    """

    indptr: Int
    indices: Index
    interface: Float
    boundary: Float


class PlaneCells(NamedTuple):
    """Areas, centroids, vertices (CSR) and neighbours of plane cells."""

    measures: Float
    centroids: Float
    vertex_offsets: Int
    vertices: Index
    neighbours: Neighbours


def plane_cells(points: Float, face_pairs: Int, face_cells: Int, n_cells: int) -> PlaneCells:
    """Geometry of the cells of a 2-D mesh, whose arrays these are."""
    from agglo_core.kernels import plane_cells as kernels

    edges = np.empty((2 * len(face_cells), 4), np.int32)
    offsets = frozen_int(kernels.half_edges(face_pairs, face_cells, n_cells, edges))
    count = int(offsets[-1])
    vertices, indices, interface = np.empty(count, np.int32), np.empty(count, np.int32), np.empty(count)
    area, centroid, indptr, boundary = kernels.plane_cells(
        points, offsets, edges, vertices, indices, interface
    )
    used = int(indptr[-1])
    if used < 0.75 * count:  # many faces between the same cells: do not hold on to the rest
        indices, interface = indices[:used].copy(), interface[:used].copy()
    return PlaneCells(
        frozen_float(area),
        frozen_float(centroid),
        offsets,
        frozen_index(vertices),
        Neighbours(
            frozen_int(indptr),
            frozen_index(indices[:used]),
            frozen_float(interface[:used]),
            frozen_float(boundary),
        ),
    )
