"""The surfaces of agglomerates in space, as triangles, and the balls inside.

Faces of cells that are not flat are taken to be the triangles they are cut in, the same from both sides.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from agglo_core.arrays import Float, Index, Int, frozen_float, frozen_index, frozen_int
from agglo_core.mesh import Mesh
from agglo_core.threads import over_ranges

_FEW = 200  # agglomerates one thread looks at in some ten milliseconds


def ball_radii(mesh: Mesh, anywhere: bool) -> Float:
    """Radius of the largest ball inside each cell ``(n_cells,)``, or of that about the centroid (else 0)."""
    from agglo_core.shapes.balls import balls

    return over_surfaces(mesh, balls, mesh.local_centroids, mesh.cell_diameters, anywhere)


def over_surfaces(mesh: Mesh, kernel: Callable[..., Any], *more: Any) -> Float:
    """What a kernel finds of the triangles around each cell ``(n_cells,)``."""
    points, (offsets, faces) = mesh.local_points, mesh.cell_faces
    triangles = _triangles(mesh)

    def of_cells(start: int, stop: int) -> Float:
        own = offsets[start : stop + 1]
        found: Float = kernel(points, start, own, faces, mesh.face_cells, *triangles, *more)
        return found

    return np.concatenate(over_ranges(of_cells, mesh.n_cells, few=_FEW))


def _triangles(mesh: Mesh) -> tuple[Int, Index]:
    """Where the triangles of each face begin ``(n_faces + 1,)``, and their vertices ``(t, 3)``."""
    from agglo_core.shapes.solid_triangles import face_triangles

    vectors = frozen_float(mesh.face_normals * mesh.face_measures[:, None])
    starts, triangles = face_triangles(mesh.local_points, mesh.face_offsets, mesh.face_vertices, vectors)
    return frozen_int(starts), frozen_index(triangles)
