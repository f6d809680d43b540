"""Compute geometry and neighbours of 2-D cells in one pass, to limit cache misses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Index, Int, frozen_float, frozen_index, frozen_int
from agglo_core.mesh.counting_sort import counting_sort
from agglo_core.threads import over_ranges


class Neighbours(NamedTuple):
    """Neighbours of each cell with interface measures, and its boundary measure.

    The neighbours of cell c are ``indices[indptr[c]:indptr[c + 1]]``, each once. ``interface`` is the total
    measure of the faces shared with that neighbour, ``boundary (n_cells,)`` that of outer faces.
    """

    indptr: Int
    indices: Index
    interface: Float
    boundary: Float


class PlaneCells(NamedTuple):
    """Areas, centroids, vertices (CSR) and neighbours of 2-D cells."""

    measures: Float
    centroids: Float
    vertex_offsets: Int
    vertices: Index
    neighbours: Neighbours


def plane_cells(points: Float, face_pairs: Int, face_cells: Int, n_cells: int) -> PlaneCells:
    """Compute geometry and neighbours of the cells of a 2-D mesh, given by its arrays."""
    from agglo_core.mesh.kernels import plane_cells as kernels

    # Allocate for all half-edges; each thread fills the ranges of its cells.
    offsets, edges = _half_edges(face_pairs, face_cells, n_cells)
    count = int(offsets[-1])
    area, centroid, boundary = np.empty(n_cells), np.empty((n_cells, 2)), np.empty(n_cells)
    vertices, indices, interface = np.empty(count, np.int32), np.empty(count, np.int32), np.empty(count)
    indptr = np.zeros(n_cells + 1, np.int64)

    def measure_range(start: int, stop: int) -> tuple[int, int]:
        cells, corners = slice(start, stop), slice(offsets[start], offsets[stop])
        of_cells = (array[cells] for array in (area, centroid, boundary, indptr[1:]))
        of_edges = (array[corners] for array in (vertices, indices, interface))
        n_neighbours = kernels.plane_cells(
            points, offsets[start : stop + 1], edges, n_cells, *of_cells, *of_edges
        )
        return int(offsets[start]), int(n_neighbours)

    # Compact the neighbours of the ranges.
    total = 0
    for start, n_neighbours in over_ranges(measure_range, n_cells, work=count):
        if total < start:  # outer faces of earlier ranges left a gap
            indices[total : total + n_neighbours] = indices[start : start + n_neighbours]
            interface[total : total + n_neighbours] = interface[start : start + n_neighbours]
        total += n_neighbours
    np.cumsum(indptr, out=indptr)
    if total < 0.75 * count:  # many faces between the same cells: release the rest
        indices, interface = indices[:total].copy(), interface[:total].copy()
    return PlaneCells(
        frozen_float(area),
        frozen_float(centroid),
        offsets,
        frozen_index(vertices),
        Neighbours(
            frozen_int(indptr),
            frozen_index(indices[:total]),
            frozen_float(interface[:total]),
            frozen_float(boundary),
        ),
    )


def _half_edges(face_pairs: Int, face_cells: Int, n_cells: int) -> tuple[Int, NDArray[np.int32]]:
    """Sort the half-edges (an edge as seen from one cell) by cell.

    Return the cell starts, and tail, head, opposite cell and ownership of each.
    """
    from agglo_core.mesh.kernels.plane_cells import half_edges

    edges = np.empty((2 * len(face_cells), 4), np.int32)

    def put(start: int, stop: int, places: Int, only_count: bool) -> None:
        own = slice(start, stop)
        half_edges(face_pairs[own], face_cells[own], places, edges[:0] if only_count else edges)

    return counting_sort(put, len(face_cells), n_cells, shares=1), edges
