"""Which polyhedron holds a point: by the winding number of its surface, whatever its shape."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Float, Int, Mesh, frozen_int
from agglo_polydg_mg.space.solid_geometry import boxes_of_solids, triangles_of_faces

_TRIANGLES = 1_000_000  # looked at together
_INSIDE = 0.01
"""Part of the solid angle from which a point belongs to a cell: on faces both have half of it."""


def cells_that_hold(mesh: Mesh, points: Float) -> Int:
    """Cell of each of the ``points (q, 3)`` from the origin: the lowest of those that hold it, −1 outside."""
    candidates, cells = _in_boxes(mesh, points)
    offsets, faces = mesh.cell_faces
    triangles = np.diff(mesh.face_offsets)[faces] - 2
    sizes = np.add.reduceat(triangles, offsets[:-1])
    found = np.full(len(points), mesh.n_cells)
    ends, first = np.concatenate(([0], np.cumsum(sizes[cells]))), 0
    while first < len(cells):
        stop = max(first + 1, int(np.searchsorted(ends, ends[first] + _TRIANGLES, "right")) - 1)
        part = slice(first, stop)
        inside = _winding(mesh, points[candidates[part]], cells[part]) > _INSIDE
        np.minimum.at(found, candidates[part][inside], cells[part][inside])
        first = stop
    return frozen_int(np.where(found < mesh.n_cells, found, -1))


def _in_boxes(mesh: Mesh, points: Float) -> tuple[Int, Int]:
    """Pairs of points and cells whose bounding boxes hold them, by points."""
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


def _winding(mesh: Mesh, points: Float, cells: Int) -> Float:
    """How often the surface of each cell winds around a point ``(m,)``: 1 inside, 0 outside, 1/2 on faces.

    Sums of the solid angles of triangles: A. van Oosterom, J. Strackee, IEEE Trans. Biomed. Eng. 30, 1983.
    """
    offsets, faces = mesh.cell_faces
    count = offsets[cells + 1] - offsets[cells]
    pair = np.repeat(np.arange(len(cells)), count)
    own = faces[np.arange(len(pair)) - np.repeat(np.cumsum(count) - count, count) + offsets[cells[pair]]]
    of_own, corners = triangles_of_faces(mesh, frozen_int(own))
    pair = np.repeat(pair, np.diff(mesh.face_offsets)[own] - 2)
    a, b, c = (corners[:, k] - points[pair] for k in range(3))
    la, lb, lc = (np.linalg.norm(each, axis=1) for each in (a, b, c))
    volume = (a * np.cross(b, c)).sum(axis=1)
    size = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
    flat = np.abs(volume) <= 1e-12 * np.maximum(np.maximum(la, lb), lc) ** 3
    angle = np.where(flat & (size >= 0.0), 0.0, np.arctan2(volume, size))
    angle = np.where(flat & (size < 0.0), 0.5 * np.pi, angle)  # on the triangle: half of all around
    sign = np.where(mesh.face_cells[of_own, 0] == cells[pair], 1.0, -1.0)
    sign = np.where(flat & (size < 0.0), 1.0, sign)
    return np.bincount(pair, sign * angle, len(cells)) / (2.0 * np.pi)
