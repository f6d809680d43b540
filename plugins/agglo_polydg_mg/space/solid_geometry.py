"""Geometry of polyhedra: bounding boxes, triangles, tetrahedra, heights over faces."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Float, Mesh, MeshError, frozen_float
from agglo_core.threads import COSTLY, over_ranges


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
