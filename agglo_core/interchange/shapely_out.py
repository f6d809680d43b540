"""Convert cells to shapely: Polygons, or MultiPolygons for several outer loops."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, frozen_int
from agglo_core.errors import MeshError
from agglo_core.mesh import Loops, Mesh
from agglo_core.mesh.elements import gather

Geometries = NDArray[np.object_]


def mesh_to_shapely(mesh: Mesh) -> Geometries:
    """Return the cells as shapely polygons ``(n_cells,)`` with exactly the mesh coordinates.

    A cell with holes is a Polygon with holes. A cell with several outer loops (a disconnected agglomerate, or
    an interior cut at pinch vertices) is a MultiPolygon. Shells run counter-clockwise, holes clockwise. The
    polygons are valid wherever the mesh cells do not overlap.

    Raises
    ------
    MeshError
        For a 3-D mesh, or for a cell whose boundary loops cross.

    Examples
    --------
    >>> from agglo_core import samples
    >>> print(mesh_to_shapely(samples.squares(2))[0])
    POLYGON ((0 0, 0.5 0, 0.5 0.5, 0 0.5, 0 0))
    """
    import shapely

    if mesh.dim != 2:
        raise MeshError("shapely holds polygons: expected a 2-D mesh, given a 3-D one")
    loops = mesh.boundary_loops
    rings = _linear_rings(mesh, loops)
    cell = np.repeat(np.arange(mesh.n_cells), np.diff(loops.cell_offsets))
    hole = ~shapely.is_ccw(rings)
    shell = _shell_of(rings, hole, cell, mesh.n_cells)
    order = np.lexsort((hole, shell))  # each shell, followed by its holes
    number = np.cumsum(~hole) - 1
    parts = shapely.polygons(rings[order], indices=number[shell[order]])
    return _group_by_cell(parts, cell[~hole], mesh.n_cells)


def _linear_rings(mesh: Mesh, loops: Loops) -> Geometries:
    """Convert each boundary loop to a closed shapely ring."""
    import shapely

    offsets, vertices = loops.loop_offsets, loops.vertices
    closed_loops = np.insert(vertices, offsets[1:], vertices[offsets[:-1]])
    ring = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets) + 1)
    rings: Geometries = shapely.linearrings(mesh.points[closed_loops], indices=ring)
    return rings


def _shell_of(rings: Geometries, hole: NDArray[np.bool_], cell: Int, n_cells: int) -> Int:
    """Return for each loop the outer loop around it: itself, or for holes the smallest that encloses it."""
    import shapely

    shells, holes = np.flatnonzero(~hole), np.flatnonzero(hole)
    starts = frozen_int(np.searchsorted(cell[shells], np.arange(n_cells + 1)))
    shell = np.arange(len(rings))
    choices, places = gather(starts, frozen_int(cell[holes]))
    candidate, row = shells[places], np.repeat(holes, np.diff(choices))
    around = shapely.polygons(rings[candidate])
    inside = np.repeat(np.diff(choices) == 1, np.diff(choices))  # the only outer loop
    unsure = np.flatnonzero(~inside)
    inside[unsure] = shapely.covers(around[unsure], rings[row[unsure]])
    order = np.lexsort((shapely.area(around), row))[::-1]  # the smallest is written last
    order = order[inside[order]]
    shell[holes] = -1
    shell[row[order]] = candidate[order]
    if (shell < 0).any():
        raise MeshError(f"cell {cell[np.argmin(shell)]}: its boundary loops cross each other")
    return frozen_int(shell)


def _group_by_cell(parts: Geometries, cell: Int, n_cells: int) -> Geometries:
    """Return one geometry per cell: its polygon, or a MultiPolygon if it has several."""
    import shapely

    count = np.bincount(cell, minlength=n_cells)
    lone = count[cell] == 1
    result: Any = np.empty(n_cells, dtype=object)
    result[cell[lone]] = parts[lone]
    several = np.flatnonzero(count > 1)
    if len(several):
        rows = np.searchsorted(several, cell[~lone])
        result[several] = shapely.multipolygons(parts[~lone], indices=rows)
    return np.asarray(result, dtype=np.object_)
