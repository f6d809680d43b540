"""Geometry of polyhedra: bounding boxes, triangles, tetrahedra, heights over faces."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Float, Int, Mesh, MeshError, frozen_float, frozen_int
from agglo_core.threads import COSTLY, over_ranges


def boxes_of_solids(mesh: Mesh) -> Float:
    """Return the bounding boxes of polyhedra ``(n_cells, 6)``: centre from the mesh origin, half sides."""
    offsets, vertices = mesh.cell_vertices
    corners = mesh.local_points.take(vertices, axis=0)
    low, high = (each.reduceat(corners, offsets[:-1]) for each in (np.minimum, np.maximum))
    return frozen_float(np.concatenate((0.5 * (low + high), 0.5 * (high - low)), axis=1))


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


def solid_heights(mesh: Mesh) -> tuple[Float, np.ndarray]:
    """Return the heights ``(n_faces, 2)`` of both cells over each face, and a mask of convex cells.

    It is the distance of the farthest vertex. In a convex cell this is the height of the largest
    tetrahedron, or pyramid, on the face inside the cell. It is infinite outside the domain and for faces
    with area 0. The mask has shape ``(n_cells,)``.
    """
    from agglo_polydg_mg.space.solid_kernels import farthest_vertices

    heights = np.full((mesh.n_faces, 2), np.inf)
    (offsets, faces), (starts, vertices) = mesh.cell_faces, mesh.cell_vertices
    middle = frozen_float(mesh.face_centroids - mesh.origin)
    of_faces = mesh.face_cells, mesh.face_normals, middle

    def write(start: int, stop: int) -> np.ndarray:
        own = offsets[start : stop + 1], faces, starts[start : stop + 1], vertices
        return np.asarray(farthest_vertices(mesh.local_points, *own, *of_faces, start, heights))

    return heights, np.concatenate(over_ranges(write, mesh.n_cells, few=COSTLY))


def require_convex(convex: np.ndarray, what: str) -> None:
    """Raise MeshError with the indices of the cells that are not ``convex (n_cells,)``, if any."""
    others = np.flatnonzero(~convex)
    if len(others):
        raise MeshError(
            f"{what} in 3-D requires convex cells, but cells {others[:5].tolist()} are not convex"
        )
