"""Replace VTK cells that are given by points alone by their convex hulls."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.errors import FileError
from agglo_core.mesh.checks import last_place
from agglo_core.mesh.elements import Polyhedra

_ROUNDING = 8  # tolerance for a vertex off the plane of its face, in units in the last place
_FLAT = 1e-10  # tolerance for a vertex off the plane of its face, relative to the cell size


def convex_hulls(points: Float, offsets: Int, vertices: Int, cells: Int) -> Polyhedra:
    """Return the convex hull of the points ``vertices[offsets[c]:offsets[c + 1]]`` for each given cell.

    Coplanar triangles form one face. Points inside a hull or a face are not used. The loop over cells takes
    about 0.2 ms per cell.

    Raises
    ------
    FileError
        For coplanar or non-finite points.
    """
    faces = [_hull(points, vertices[offsets[c] : offsets[c + 1]], int(c)) for c in cells]
    loops = [loop for cell in faces for loop in cell]
    return Polyhedra(
        frozen_int(np.cumsum([0, *(len(cell) for cell in faces)])),
        frozen_int(np.cumsum([0, *(len(loop) for loop in loops)])),
        frozen_int(np.concatenate([np.empty(0, np.int64), *loops])),
    )


def _hull(points: Float, nodes: Int, cell: int) -> list[Int]:
    """Return the faces of the convex hull of points, as loops of point numbers."""
    from scipy.spatial import ConvexHull, QhullError

    nodes = np.unique(nodes)
    corners = points[nodes] - points[nodes].mean(axis=0)
    try:
        hull = ConvexHull(corners)
    except (QhullError, ValueError):
        raise FileError(
            f"cell {cell} of VTK type 41 (convex point set): its {len(nodes)} points do not span a volume"
        ) from None
    # faces: largest vertex sets in the plane of a triangle, within the rounding of the coordinates
    tolerance = _ROUNDING * last_place(points[nodes]) + _FLAT * np.ptp(corners, axis=0).max()
    near = np.abs(hull.equations[:, :3] @ corners[hull.vertices].T + hull.equations[:, 3:]) <= tolerance
    sets, first = np.unique(near, axis=0, return_index=True)
    is_subset = sets.astype(int) @ ~sets.T == 0
    loops = []
    # Sort the vertices of each face by angle around its centre.
    for k in np.flatnonzero(is_subset.sum(axis=1) == 1):
        face_corners = hull.vertices[sets[k]]
        arm = corners[face_corners] - corners[face_corners].mean(axis=0)
        angle = np.arctan2(np.cross(arm[0], arm) @ hull.equations[first[k], :3], arm @ arm[0])
        loops.append(nodes[face_corners[np.argsort(angle)]])
    return loops
