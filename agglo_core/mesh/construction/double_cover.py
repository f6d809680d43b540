"""Detect overlapping 2-D cells by the winding number of the mesh boundary."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.mesh.checks import box_centre, merge_equal
from agglo_core.mesh.construction.conforming import TOLERANCE
from agglo_core.mesh.derived import Derived
from agglo_core.mesh.elsewhere import import_function

_log = logging.getLogger("agglo")

_BITS = 44  # bits of coordinates in the union: without a grid, GEOS loses cells of some unions


def warn_of_double_cover(mesh: Derived) -> None:
    """Log a warning if 2-D cells overlap, with the area that is counted twice.

    The winding number of the outer faces counts the cells at a point (Stokes), so the cost depends on the
    outer faces only. Overlaps within the tolerance of :meth:`Mesh.conforming` are accepted. Cells on the same
    side of an edge are already reported during edge matching. 3-D meshes are not examined.
    """
    if mesh.dim != 2 or "overlapping edges left apart" in mesh.repairs:
        return
    outer = np.flatnonzero(mesh.face_cells[:, 1] < 0)
    if not _covers_twice(mesh.points, frozen_int(mesh.face_pairs.take(outer, axis=0))):
        return
    import shapely

    grid = 2.0 ** (np.frexp(np.abs(mesh.points).max())[1] - _BITS)
    total = float(mesh.cell_measures.sum())
    union = float(
        shapely.union_all(
            import_function("agglo_core.interchange:mesh_to_shapely")(mesh), grid_size=grid
        ).area
    )
    _log.warning(
        "cells overlap: their total measure is %.10g, that of their union %.10g, so %.4g is counted "
        "twice. strict=True reports the cells. In a periodic mesh, give cells that wrap around separate "
        "points on the far side",
        total,
        union,
        total - union,
    )


def _covers_twice(points: Float, faces: Int) -> bool:
    """Return True if the winding number of the directed edges ``faces (m, 2)`` exceeds 1 somewhere.

    The cells lie on the left of these edges.
    """
    import shapely

    # Region within each loop; its measure is positive around cells and negative around a hole.
    order, starts = _loops(_followers(points, faces))
    tail, head = points[faces[order]].transpose(1, 0, 2)
    centre = box_centre(tail)
    (x, y), (u, v) = (tail - centre).T, (head - centre).T
    measure = 0.5 * np.add.reduceat(x * v - u * y, starts)
    slack = TOLERANCE * np.add.reduceat((u - x) ** 2 + (v - y) ** 2, starts)
    sizes = np.diff(starts, append=len(order))
    is_region = sizes > 2  # two faces enclose nothing
    ring = np.repeat(np.where(is_region, np.cumsum(is_region) - 1, -1), sizes)
    corners = np.stack((x, y), axis=1)[ring >= 0]
    regions = shapely.polygons(shapely.linearrings(corners, indices=ring[ring >= 0]))
    measure, slack = measure[is_region], slack[is_region]
    crossed = ~shapely.is_valid(regions)
    if len(starts) == 1 and not crossed.any():
        return False

    # Cracks are no boundary of the covered region.
    merged, boundary = _remove_cracks(points, faces)
    if len(boundary) < len(faces):
        return _covers_twice(merged, boundary)

    # A self-touching loop winds more than once if its even-odd region has a different measure.
    if crossed.any():
        regions[crossed] = shapely.make_valid(regions[crossed])
        excess = np.abs(np.abs(measure) - shapely.area(regions))
        if (excess > slack)[crossed].any():
            return True
        is_region = ~(crossed & (shapely.area(regions) <= slack))  # the two sides of a crack
        regions, measure, slack = regions[is_region], measure[is_region], slack[is_region]
    slack = np.minimum(slack, TOLERANCE * np.abs(measure))
    return len(regions) > 1 and _nest_twice(regions, frozen_float(measure), frozen_float(slack))


def _nest_twice(regions: Any, measure: Float, slack: Float) -> bool:
    """Return True if two boundary loops overlap partially, or one around cells lies within cells."""
    import shapely

    outside, inside = shapely.STRtree(regions).query(regions, predicate="intersects")
    shapely.prepare(regions[np.unique(outside)])
    within = shapely.contains_properly(regions[outside], regions[inside])
    nested = np.stack((outside, inside), axis=1)[within]

    # Other pairs touch, cross or are equal, which their common area decides.
    key, n = np.sort(nested, axis=1) @ [len(regions), 1], len(regions)
    unsure = (outside < inside) & ~np.isin(outside * n + inside, key)
    a, b = outside[unsure], inside[unsure]
    shared = shapely.area(shapely.intersection(regions[a], regions[b]))
    near = np.minimum(slack[a], slack[b])
    is_inside = np.abs(measure[np.stack((a, b))]) - shared <= near  # a within b, b within a
    if ((shared > near) & ~is_inside.any(axis=0)).any():
        return True
    pairs = np.concatenate(
        (nested, np.stack((b, a), axis=1)[is_inside[0]], np.stack((a, b), axis=1)[is_inside[1]])
    )

    # Winding number on the left of a loop around cells: its own turn and those of the enclosing loops.
    turns = np.bincount(pairs[:, 1], np.sign(measure)[pairs[:, 0]], n)
    return bool((turns[measure > 0] > 0).any())


def _remove_cracks(points: Float, faces: Int) -> tuple[Float, Int]:
    """Remove cracks: pairs of faces that run in opposite directions between equal points."""
    used, ends = np.unique(faces, return_inverse=True)
    points = frozen_float(points[used])
    ends = merge_equal(points, frozen_int(ends.ravel()))[0].reshape(-1, 2)

    # Number the edges, and the faces in each direction along an edge.
    edge = np.unique(np.sort(ends, axis=1) @ [len(points), 1], return_inverse=True)[1]
    side = 2 * edge + (ends[:, 0] < ends[:, 1])
    count = np.bincount(side, minlength=2 * len(faces))
    order = np.argsort(side, kind="stable")
    rank = np.empty(len(faces), np.int64)
    rank[order] = np.arange(len(faces)) - (np.cumsum(count) - count)[side[order]]

    # Remove as many faces as run in the opposite direction.
    kept = (rank >= count[side ^ 1]) & (ends[:, 0] != ends[:, 1])
    return points, frozen_int(ends[kept])


def _followers(points: Float, faces: Int) -> Int:
    """Return for each outer face the next one along its boundary loop.

    Where loops touch, the successor stays at the cells of the sector.
    """
    tail, head = faces.T
    number = np.arange(len(faces))
    first = np.empty(len(points), np.int64)
    first[tail] = number
    follower = first[head]
    shared = np.unique(tail[first[tail] != number])
    if not len(shared):
        return frozen_int(follower)

    # Face ends at each shared vertex, clockwise; at the end of a crack, the leaving face comes first.
    leaving, arriving = np.flatnonzero(np.isin(tail, shared)), np.flatnonzero(np.isin(head, shared))
    vertex = np.concatenate((tail[leaving], head[arriving]))
    beyond = np.concatenate((head[leaving], tail[arriving]))
    arrives = np.repeat([False, True], len(leaving))
    x, y = (points[beyond] - points[vertex]).T
    order = np.lexsort((arrives, -np.arctan2(y, x), vertex))

    # Cells fill the sector from an arriving face clockwise to a leaving face: pair these.
    arrives = arrives[order]
    face = np.concatenate((leaving, arriving))[order]
    leaving, arriving, vertex = face[~arrives], face[arrives], vertex[order][arrives]
    start = np.searchsorted(vertex, vertex)
    count = np.searchsorted(vertex, vertex, side="right") - start
    shift = ~arrives[2 * start]  # the first leaving face belongs to the last arriving face
    follower[arriving] = leaving[start + (np.arange(len(vertex)) - start + shift) % count]
    return frozen_int(follower)


def _loops(follower: Int) -> tuple[Int, Int]:
    """Sort faces into closed loops by pointer doubling: faces in loop order, and loop starts."""
    number = np.arange(len(follower))

    # The smallest face number identifies a loop.
    name, jump = np.minimum(number, follower), follower[follower]
    while (name != name[jump]).any():
        name, jump = np.minimum(name, name[jump]), jump[jump]

    # Number of steps from each face to the end of its loop, which is cut before its smallest face.
    last = name == follower
    steps, jump = (~last).astype(np.int64), np.where(last, number, follower)
    while steps[jump].any():
        steps, jump = steps + steps[jump], jump[jump]
    order = np.lexsort((-steps, name))
    return frozen_int(order), frozen_int(np.flatnonzero(name[order] == order))
