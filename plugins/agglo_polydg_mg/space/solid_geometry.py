"""Shapes of polyhedra: their boxes, what they are made of, how high they rise over their faces."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Float, Int, Mesh, MeshError, frozen_float, frozen_int, over_ranges

_FEW = 10_000  # cells one thread looks at in some milliseconds


def boxes_of_solids(mesh: Mesh) -> Float:
    """Bounding boxes ``(n_cells, 6)`` of the cells: centre from the mesh's origin, half sides."""
    offsets, vertices = mesh.cell_vertices
    corners = mesh.local_points.take(vertices, axis=0)
    low, high = (each.reduceat(corners, offsets[:-1]) for each in (np.minimum, np.maximum))
    return frozen_float(np.concatenate((0.5 * (low + high), 0.5 * (high - low)), axis=1))


def triangles_of_faces(mesh: Mesh, faces: Int) -> tuple[Int, Float]:
    """Triangles of some faces, in fans from their first vertices: faces ``(t,)``, corners ``(t, 3, 3)``.

    They are turned as the faces are. Those of a face that is not convex overlap, and are to be added with
    the signs of their areas. A face that is not plane is what its triangles are.
    """
    start, count = mesh.face_offsets[faces], np.diff(mesh.face_offsets)[faces] - 2
    own, first = np.repeat(faces, count), np.repeat(start, count)
    step = np.arange(len(own)) - np.repeat(np.cumsum(count) - count, count) + first
    vertices = mesh.face_vertices[np.stack((first, step + 1, step + 2), axis=1)]
    return frozen_int(own), frozen_float(mesh.local_points[vertices])


def tetrahedra_of_solids(mesh: Mesh) -> tuple[Int, Float]:
    """Tetrahedra of the cells, from centroids: offsets ``(n + 1,)``, corners ``(t, 4, 3)`` from the origin.

    Those of a cell that is not star-shaped overlap, and are to be added with the signs of their volumes.
    """
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
    own = np.repeat(cells, count)
    apex = mesh.local_centroids[own][:, None]
    ends = np.searchsorted(own, np.arange(mesh.n_cells + 1))
    return frozen_int(ends), frozen_float(np.concatenate((apex, base), axis=1))


def solid_heights(mesh: Mesh) -> tuple[Float, np.ndarray]:
    """Height ``(n_faces, 2)`` over each face of the farthest vertex of its owner and of its neighbour.

    In a convex cell that is the height of the largest tetrahedron, or pyramid, with this base that lies in
    the cell. Infinite outside the domain and for faces of no area. And which cells are convex
    ``(n_cells,)``.
    """
    from agglo_polydg_mg.space.solid_kernels import farthest_vertices

    heights = np.full((mesh.n_faces, 2), np.inf)
    (offsets, faces), (starts, vertices) = mesh.cell_faces, mesh.cell_vertices
    middle = frozen_float(mesh.face_centroids - mesh.origin)
    of_faces = mesh.face_cells, mesh.face_normals, middle

    def write(start: int, stop: int) -> np.ndarray:
        own = offsets[start : stop + 1], faces, starts[start : stop + 1], vertices
        return np.asarray(farthest_vertices(mesh.local_points, *own, *of_faces, start, heights))

    return heights, np.concatenate(over_ranges(write, mesh.n_cells, few=_FEW))


def require_convex(convex: np.ndarray, what: str) -> None:
    """Raise MeshError, naming them, for cells that are not ``convex (n_cells,)``."""
    others = np.flatnonzero(~convex)
    if len(others):
        raise MeshError(f"{what} in 3-D needs convex cells, and cells {others[:5].tolist()} are not")
