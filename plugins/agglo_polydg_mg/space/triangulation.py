"""Polygons cut into triangles inside them, whatever their shape."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Float, Int, Mesh, MeshError, frozen_float, frozen_int


def triangulate(mesh: Mesh) -> tuple[Int, Float]:
    """Triangles inside each cell: offsets ``(n + 1,)`` and corners ``(t, 3, 2)`` relative to the origin.

    Raises
    ------
    MeshError
        Naming cells whose triangles do not add up to their area.
    """
    cells, corners, fanned = _fans(mesh)
    rest = np.flatnonzero(~fanned)
    if len(rest):
        more, others = _delaunay(mesh, rest)
        cells, corners = np.concatenate((cells, more)), np.concatenate((corners, others))
        order = np.argsort(cells, kind="stable")
        cells, corners = cells[order], corners[order]
    areas = np.bincount(cells, _areas(corners), mesh.n_cells)
    wrong = np.flatnonzero(np.abs(areas - mesh.cell_measures) > 1e-8 * mesh.cell_measures)
    if len(wrong):
        raise MeshError(f"cells {wrong[:5].tolist()} cannot be cut into triangles: they overlap themselves")
    return frozen_int(np.searchsorted(cells, np.arange(mesh.n_cells + 1))), frozen_float(corners)


def _fans(mesh: Mesh) -> tuple[Int, Float, np.ndarray]:
    """Fans from the first vertex of each cell: cells, corners, and which cells they fit ``(n,)``."""
    cell_loops, loop_offsets, vertices = mesh.boundary_loops
    simple = np.diff(cell_loops) == 1
    loop = cell_loops[:-1][simple]
    start, count = loop_offsets[loop], np.diff(loop_offsets)[loop] - 2
    cells = np.repeat(np.flatnonzero(simple), count)
    base = np.repeat(start, count)
    step = np.arange(len(cells)) - np.repeat(np.cumsum(count) - count, count) + base
    corners = mesh.local_points[vertices[np.stack((base, step + 1, step + 2), axis=1)]]
    areas = _areas(corners)
    fits = simple.copy()
    fits[cells[areas < -1e-14 * mesh.cell_measures[cells]]] = False
    kept = fits[cells]
    return cells[kept], corners[kept], fits


def _areas(corners: Float) -> Float:
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def _delaunay(mesh: Mesh, cells: Int) -> tuple[Int, Float]:
    """Constrained Delaunay triangles of some cells, holes and pinches included, counter-clockwise."""
    import shapely

    triangles, owners = shapely.get_parts(
        shapely.constrained_delaunay_triangles(mesh.to_shapely()[cells]), return_index=True
    )
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3] - mesh.origin
    clockwise = _areas(corners) < 0
    corners[clockwise] = corners[clockwise][:, ::-1]
    return cells[owners], corners
