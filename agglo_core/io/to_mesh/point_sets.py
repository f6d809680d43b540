"""Convex point sets of VTK as polyhedra: their convex hulls."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.errors import FileError
from agglo_core.mesh.checks import last_place
from agglo_core.mesh.elements import Polyhedra

_ROUNDING = 8  # units in the last place that a vertex may be off the plane of its face
_FLAT = 1e-10  # the same relative to the size of the cell


def convex_hulls(points: Float, offsets: Int, vertices: Int, cells: Int) -> Polyhedra:
    """Hulls of the points ``vertices[offsets[c]:offsets[c + 1]]`` of each of the given cells.

    Triangles in one plane are one face. Points inside a hull or inside a face are not used. Cells are visited
    one by one: about 0.2 ms each.

    Raises
    ------
    FileError
        For points that lie in a plane, or are not finite.
    """
    faces = [_hull(points, vertices[offsets[c] : offsets[c + 1]], int(c)) for c in cells]
    loops = [loop for cell in faces for loop in cell]
    return Polyhedra(
        frozen_int(np.cumsum([0, *(len(cell) for cell in faces)])),
        frozen_int(np.cumsum([0, *(len(loop) for loop in loops)])),
        frozen_int(np.concatenate([np.empty(0, np.int64), *loops])),
    )


def _hull(points: Float, nodes: Int, cell: int) -> list[Int]:
    """Faces of the hull of some points as loops of their numbers."""
    from scipy.spatial import ConvexHull, QhullError

    nodes = np.unique(nodes)
    corners = points[nodes] - points[nodes].mean(axis=0)
    try:
        hull = ConvexHull(corners)
    except (QhullError, ValueError):
        raise FileError(
            f"cell {cell} of VTK type 41 (convex point set): its {len(nodes)} points do not span a volume"
        ) from None
    # faces: largest sets of vertices in the plane of a triangle, within the rounding of the coordinates
    off = _ROUNDING * last_place(points[nodes]) + _FLAT * np.ptp(corners, axis=0).max()
    near = np.abs(hull.equations[:, :3] @ corners[hull.vertices].T + hull.equations[:, 3:]) <= off
    sets, first = np.unique(near, axis=0, return_index=True)
    within = sets.astype(int) @ ~sets.T == 0
    loops = []
    for k in np.flatnonzero(within.sum(axis=1) == 1):
        used = hull.vertices[sets[k]]
        arm = corners[used] - corners[used].mean(axis=0)
        angle = np.arctan2(np.cross(arm[0], arm) @ hull.equations[first[k], :3], arm @ arm[0])
        loops.append(nodes[used[np.argsort(angle)]])
    return loops
