"""Shape measures of 3-D agglomerates, computed from the triangles of their surface."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from agglo_core.arrays import Float, Index, Int, frozen_float, frozen_index, frozen_int
from agglo_core.errors import MeshError
from agglo_core.mesh import Mesh
from agglo_core.threads import over_ranges

_FEW = 200
"""Minimum number of agglomerates for a thread: their balls and hulls take some ten milliseconds.
Benchmark: benchmarks/constants.py."""


def ball_radii(mesh: Mesh, anywhere: bool) -> Float:
    """Return the radius of the largest ball inside each cell, with any centre or about the centroid.

    The radii have shape ``(n_cells,)``.

    About a centroid outside the cell the radius is 0.
    """
    from agglo_core.shapes.balls import balls

    return over_surfaces(mesh, balls, mesh.local_centroids, mesh.cell_diameters, anywhere)


def over_surfaces(mesh: Mesh, kernel: Callable[..., Any], *arguments: Any) -> Float:
    """Apply a kernel to the surface triangles of all cells, in several threads, and return ``(n_cells,)``."""
    points, (offsets, faces) = mesh.local_points, mesh.cell_faces
    triangles = _triangles(mesh)

    def of_cells(start: int, stop: int) -> Float:
        row_offsets = offsets[start : stop + 1]
        values: Float = kernel(points, start, row_offsets, faces, mesh.face_cells, *triangles, *arguments)
        return values

    return np.concatenate(over_ranges(of_cells, mesh.n_cells, few=_FEW))


def _triangles(mesh: Mesh) -> tuple[Int, Index]:
    """Return the triangles of all faces: offsets ``(n_faces + 1,)``, and vertices ``(t, 3)``."""
    from agglo_core.shapes.solid_triangles import face_triangles

    vectors = frozen_float(mesh.face_normals * mesh.face_measures[:, None])
    starts, triangles = face_triangles(mesh.local_points, mesh.face_offsets, mesh.face_vertices, vectors)
    return frozen_int(starts), frozen_index(triangles)


_Hulls = tuple[Float, Int, Index, Index]


def hull_volumes(mesh: Mesh) -> Float:
    """Return the convex hull volumes ``(n_cells,)``."""
    return np.concatenate([volumes for volumes, *_ in _hulls(mesh)])


def narrowest_boxes(mesh: Mesh) -> Float:
    """Return the ratio of shortest to longest side of the narrowest box around each cell ``(n_cells,)``.

    The box may have any orientation.
    """
    from agglo_core.shapes.solid_boxes import solid_box_ratios

    points = mesh.local_points
    hulls = _hulls(mesh)
    return np.concatenate([solid_box_ratios(points, *hull) for _, *hull in hulls])


def sight_volumes(mesh: Mesh) -> Float:
    """Return the volumes ``(n_cells,)`` of the kernels: the points from which the whole cell is visible."""
    from agglo_core.shapes.star_kernels import solid_kernel_volumes

    return over_surfaces(mesh, solid_kernel_volumes)


def face_area_ratios(mesh: Mesh) -> Float:
    """Return the area ratio ``(n_cells,)`` of the smallest to the largest flat face of each cell."""
    from agglo_core.shapes.flat_faces import face_ratios

    return over_surfaces(mesh, face_ratios)


def _hulls(mesh: Mesh) -> list[_Hulls]:
    """Return volumes and triangles of the convex hulls, for consecutive cell ranges."""
    from agglo_core.shapes.solid_hulls import solid_hulls

    points, (corners, vertices) = mesh.local_points, mesh.cell_vertices

    def hulls(start: int, stop: int) -> _Hulls:
        first, last = corners[start], corners[stop]
        row_offsets = frozen_int(corners[start : stop + 1] - first)
        result: _Hulls = solid_hulls(points, row_offsets, vertices[first:last])
        # Agglomerates that are flat up to rounding have no hull.
        flat_cells = np.flatnonzero(~(result[0] > 0.0))
        if len(flat_cells):
            raise MeshError(
                f"agglomerate {start + flat_cells[0]} is too thin, relative to its extent, for a convex "
                "hull in double precision"
            )
        volumes, ends, triangles, neighbours = result
        return volumes, frozen_int(ends), frozen_index(triangles), frozen_index(neighbours)

    return over_ranges(hulls, mesh.n_cells, few=_FEW)
