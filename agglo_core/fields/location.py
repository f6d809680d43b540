"""Search for the cells that contain points."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import OptionError
from agglo_core.fields.rules import batches
from agglo_core.fields.simplices import triangles_of_faces
from agglo_core.mesh import Mesh

_TRIANGLES = 1_000_000  # per batch: some hundred MB of corners, points and angles (benchmarks/constants.py)
_INSIDE = 0.01
"""Solid angle fraction above which a point belongs to a cell: on faces both cells have half.
Benchmark: benchmarks/constants.py."""
_NEAR = 1e-9  # relative to the mesh size: points on a face may miss both cells by rounding


def locate(mesh: Mesh, points: ArrayLike) -> Int:
    """Find the cell ``(q,)`` that contains each point, the first of several, −1 outside the mesh.

    Raises
    ------
    OptionError
        For points with another shape than ``(q, d)``.
    """
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != mesh.dim:
        raise OptionError(f"points must have shape (q, {mesh.dim}); given {points.shape}")
    if mesh.dim == 3:
        return cells_that_hold(mesh, np.asarray(points - mesh.origin))
    # 1. Polygons that contain the points
    import shapely

    tree = shapely.STRtree(mesh.to_shapely())
    cells = np.full(len(points), mesh.n_cells)
    np.minimum.at(cells, *tree.query(shapely.points(points), predicate="intersects"))
    # 2. Points missed by rounding: the nearest polygons
    missed = np.flatnonzero((cells == mesh.n_cells) & np.isfinite(points).all(axis=1))
    reach = _NEAR * float(np.ptp(mesh.local_points, axis=0).max())
    at, near = tree.query_nearest(shapely.points(points[missed]), max_distance=reach)
    np.minimum.at(cells, missed[at], near)
    return frozen_int(np.where(cells < mesh.n_cells, cells, -1))


def cells_that_hold(mesh: Mesh, points: Float) -> Int:
    """Find the polyhedron that contains each of ``points (q, 3)``, −1 outside the mesh.

    Points are relative to the mesh origin. If several cells contain a point, the lowest number counts.
    """
    # 1. Candidate cells by bounding boxes
    candidates, cells = _in_boxes(mesh, points)
    offsets, faces = mesh.cell_faces
    triangles = np.diff(mesh.face_offsets)[faces] - 2
    sizes = np.add.reduceat(triangles, offsets[:-1])
    lowest_cells = np.full(len(points), mesh.n_cells)
    # 2. Winding numbers, in batches of triangles
    for first, stop in batches(np.concatenate(([0], np.cumsum(sizes[cells]))), _TRIANGLES):
        part = slice(first, stop)
        inside = _winding_numbers(mesh, points[candidates[part]], cells[part]) > _INSIDE
        np.minimum.at(lowest_cells, candidates[part][inside], cells[part][inside])
    return frozen_int(np.where(lowest_cells < mesh.n_cells, lowest_cells, -1))


def boxes_of_solids(mesh: Mesh) -> Float:
    """Return the bounding boxes of polyhedra ``(n_cells, 6)``: centre from the mesh origin, half sides."""
    offsets, vertices = mesh.cell_vertices
    corners = mesh.local_points.take(vertices, axis=0)
    low, high = (each.reduceat(corners, offsets[:-1]) for each in (np.minimum, np.maximum))
    return frozen_float(np.concatenate((0.5 * (low + high), 0.5 * (high - low)), axis=1))


def _in_boxes(mesh: Mesh, points: Float) -> tuple[Int, Int]:
    """Return the pairs of points and cells whose bounding boxes contain them, sorted by point."""
    import shapely

    boxes = boxes_of_solids(mesh)
    reach = 1e-9 * boxes[:, 3:].max()
    low, high = boxes[:, :3] - boxes[:, 3:] - reach, boxes[:, :3] + boxes[:, 3:] + reach
    finite = np.flatnonzero(np.isfinite(points).all(axis=1))
    tree = shapely.STRtree(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))
    at, cells = tree.query(shapely.points(points[finite, :2]), predicate="intersects")
    at = finite[at]
    kept = (points[at, 2] >= low[cells, 2]) & (points[at, 2] <= high[cells, 2])
    return frozen_int(at[kept]), frozen_int(cells[kept])


def _winding_numbers(mesh: Mesh, points: Float, cells: Int) -> Float:
    """Return the winding number of each cell's surface around a point ``(m,)``.

    It is 1 inside, 0 outside and 1/2 on faces: the sum of the triangles' solid angles (A. van Oosterom, J.
    Strackee, IEEE Trans. Biomed. Eng. 30, 1983).
    """
    # 1. Triangles of all faces of the cells
    offsets, faces = mesh.cell_faces
    count = offsets[cells + 1] - offsets[cells]
    pair = np.repeat(np.arange(len(cells)), count)
    own = faces[np.arange(len(pair)) - np.repeat(np.cumsum(count) - count, count) + offsets[cells[pair]]]
    of_own, corners = triangles_of_faces(mesh, frozen_int(own))
    pair = np.repeat(pair, np.diff(mesh.face_offsets)[own] - 2)
    # 2. Solid angles; 2π for a point on a triangle
    a, b, c = (corners[:, k] - points[pair] for k in range(3))
    la, lb, lc = (np.linalg.norm(each, axis=1) for each in (a, b, c))
    volume = (a * np.cross(b, c)).sum(axis=1)
    size = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
    flat = np.abs(volume) <= 1e-12 * np.maximum(np.maximum(la, lb), lc) ** 3
    angle = np.where(flat & (size >= 0.0), 0.0, np.arctan2(volume, size))
    angle = np.where(flat & (size < 0.0), 0.5 * np.pi, angle)  # on the triangle: half of the full solid angle
    # 3. Signed sums per cell
    sign = np.where(mesh.face_cells[of_own, 0] == cells[pair], 1.0, -1.0)
    sign = np.where(flat & (size < 0.0), 1.0, sign)
    return np.bincount(pair, sign * angle, len(cells)) / (2.0 * np.pi)
