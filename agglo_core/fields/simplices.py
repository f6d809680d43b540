"""Triangles and tetrahedra that make up the cells and faces of a mesh."""

from __future__ import annotations

from typing import Final

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import MeshError
from agglo_core.mesh import Mesh

_TRIANGLES: Final = "_triangles"


def triangulate(mesh: Mesh) -> tuple[Int, Float]:
    """Triangulate each cell: offsets ``(n + 1,)`` and corners ``(t, 3, 2)`` relative to the origin.

    Raises
    ------
    MeshError
        For cells whose triangle areas do not sum to the cell area.
    """
    # Triangles of agglomerates are kept with the mesh: their triangulation is slow
    kept: dict[str, tuple[Int, Float]] = vars(mesh)
    if _TRIANGLES in kept:
        return kept[_TRIANGLES]
    # 1. Fans where they fit, constrained Delaunay triangles elsewhere
    cells, corners, fanned = _fans(mesh)
    rest = np.flatnonzero(~fanned)
    if len(rest):
        more, others = _delaunay(mesh, rest)
        cells, corners = np.concatenate((cells, more)), np.concatenate((corners, others))
        order = np.argsort(cells, kind="stable")
        cells, corners = cells[order], corners[order]
    # 2. Check the areas
    areas = np.bincount(cells, _areas(corners), mesh.n_cells)
    wrong = np.flatnonzero(np.abs(areas - mesh.cell_measures) > 1e-8 * mesh.cell_measures)
    if len(wrong):
        raise MeshError(f"cells {wrong[:5].tolist()} cannot be cut into triangles: they overlap themselves")
    triangles = frozen_int(np.searchsorted(cells, np.arange(mesh.n_cells + 1))), frozen_float(corners)
    if len(rest):
        kept[_TRIANGLES] = triangles
    return triangles


def _fans(mesh: Mesh) -> tuple[Int, Float, np.ndarray]:
    """Cut cells into fans of triangles from a vertex, if possible: cells, corners, and a mask ``(n,)``.

    The mask is True for cells that are cut.
    """
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
    """Return constrained Delaunay triangles of some cells, with holes and pinches, counter-clockwise."""
    import shapely

    triangles = shapely.constrained_delaunay_triangles(mesh.to_shapely()[cells])
    points, owners = shapely.get_coordinates(triangles, return_index=True)
    corners, owners = points.reshape(-1, 4, 2)[:, :3] - mesh.origin, owners[::4]  # closed rings
    clockwise = _areas(corners) < 0
    corners[clockwise] = corners[clockwise][:, ::-1]
    return cells[owners], corners


def triangles_of_faces(mesh: Mesh, faces: Int) -> tuple[Int, Float]:
    """Cut faces into fans of triangles from the first vertex: faces ``(t,)``, corners ``(t, 3, 3)``.

    Triangles keep the face orientation. In a nonconvex face they overlap, and must be summed with signed
    areas. A nonplanar face is defined by its triangles.
    """
    start, count = mesh.face_offsets[faces], np.diff(mesh.face_offsets)[faces] - 2
    face_of, first = np.repeat(faces, count), np.repeat(start, count)
    step = np.arange(len(face_of)) - np.repeat(np.cumsum(count) - count, count) + first
    vertices = mesh.face_vertices[np.stack((first, step + 1, step + 2), axis=1)]
    return frozen_int(face_of), frozen_float(mesh.local_points[vertices])


def tetrahedra_of_solids(mesh: Mesh) -> tuple[Int, Float]:
    """Cut polyhedra into tetrahedra around their centroids: offsets ``(n + 1,)``, corners ``(t, 4, 3)``.

    Corners are relative to the mesh origin. In a cell that is not star-shaped they overlap, and must be
    summed with signed volumes.
    """
    # 1. Triangles of each cell's faces, turned outward
    offsets, faces = mesh.cell_faces
    cells = np.repeat(np.arange(mesh.n_cells), np.diff(offsets))
    of_faces, corners = triangles_of_faces(mesh, frozen_int(np.arange(mesh.n_faces)))
    starts = np.searchsorted(of_faces, np.arange(mesh.n_faces + 1))
    count = np.diff(starts)[faces]
    step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    chosen = np.repeat(starts[faces], count) + step
    owned = np.repeat(mesh.face_cells[faces, 0] == cells, count)
    base = corners[chosen]
    base[~owned] = base[~owned][:, ::-1]
    # 2. Centroids as apexes
    own = np.repeat(cells, count)
    apex = mesh.local_centroids[own][:, None]
    ends = np.searchsorted(own, np.arange(mesh.n_cells + 1))
    return frozen_int(ends), frozen_float(np.concatenate((apex, base), axis=1))
