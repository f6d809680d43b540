"""Values of a discrete function: at points of each cell for pictures, and at any points."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.authoring import Float, Int, Mesh, MeshError, OptionError, Samples, frozen_int
from agglo_polydg_mg.space.basis import Basis
from agglo_polydg_mg.space.quadrature import triangulate
from agglo_polydg_mg.space.solid_geometry import boxes_of_solids, tetrahedra_of_solids, triangles_of_faces

_INVERTED = -1e-12  # of the volume of a cell


def samples_of(basis: Basis, x: Float) -> Samples:
    """The function with coefficients ``x (n,)``: every cell is cut into simplices, each into pᵈ smaller ones.

    Raises
    ------
    OptionError
        If x has another length than the space.
    MeshError
        In 3-D, for cells that are not star-shaped from their centroids.
    """
    cells, points, simplices = sampled(basis)
    return Samples(cells, points, simplices, basis.evaluate(x, cells, points))


def sampled(basis: Basis) -> tuple[Int, Float, Int]:
    """Points that sample every cell: their cells ``(q,)``, points ``(q, d)``, simplices ``(t, d + 1)``."""
    mesh, p = basis.mesh, basis.degree
    offsets, corners = triangulate(mesh) if mesh.dim == 2 else _tetrahedra(basis)
    lattice, small = _lattice(p, mesh.dim)
    edges = corners[:, 1:] - corners[:, :1]
    points = corners[:, None, 0] + sum(lattice[:, k : k + 1] * edges[:, None, k] for k in range(mesh.dim)) / p
    cells = np.repeat(np.arange(mesh.n_cells), np.diff(offsets) * len(lattice))
    simplices = small + len(lattice) * np.arange(len(corners))[:, None, None]
    return cells, points.reshape(-1, mesh.dim) + mesh.origin, simplices.reshape(-1, mesh.dim + 1)


def _tetrahedra(basis: Basis) -> tuple[Int, Float]:
    """Those of all cells, or MeshError if some are inside out."""
    mesh = basis.mesh
    offsets, corners = tetrahedra_of_solids(mesh)
    edges, own = corners[:, 1:] - corners[:, :1], np.repeat(np.arange(mesh.n_cells), np.diff(offsets))
    bad = np.unique(own[np.linalg.det(edges) < _INVERTED * mesh.cell_measures[own]])
    if len(bad):
        raise MeshError(
            f"cells {bad[:5].tolist()} are not star-shaped from their centroids: no tetrahedra to sample a "
            "solution on them"
        )
    return offsets, corners


def _lattice(p: int, dim: int) -> tuple[Int, Int]:
    """Points ``(q, d)`` of a simplex of side p, integers, and the small simplices between them.

    In the coordinates x + y + z, y + z, z the cubes of the lattice are cut along their diagonals (H. Kuhn).
    """
    lattice = np.array([each[::-1] for each in product(range(p + 1), repeat=dim) if sum(each) <= p])
    number = {tuple(each): k for k, each in enumerate(lattice.tolist())}
    steps = np.eye(dim, dtype=int) - np.eye(dim, k=1, dtype=int).T
    small = []
    for corner in lattice:
        for axes in permutations(range(dim)):
            path = [
                tuple(each) for each in (corner + np.cumsum([0 * corner, *steps[list(axes)]], 0)).tolist()
            ]
            if all(each in number for each in path):
                even = round(np.linalg.det(np.eye(dim)[list(axes)])) > 0
                path[1:] = path[1:] if even else [*path[2:0:-1], *path[3:]]
                small.append([number[each] for each in path])
    return frozen_int(lattice), frozen_int(small)


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


_NEAR = 1e-9  # of the mesh's size: points on a face may miss both of its cells by rounding


def evaluate(basis: Basis, x: Float, points: ArrayLike) -> Float:
    """Values ``(q,)`` of the function with coefficients ``x (n,)`` at ``points (q, d)``; NaN outside.

    On a face, where the function has two values, that of the cell with the lower number.

    Raises
    ------
    OptionError
        For points of another shape.
    """
    points = np.asarray(points, dtype=float)
    cells = locate(basis.mesh, points)
    found = cells >= 0
    values = np.full(len(points), np.nan)
    values[found] = basis.evaluate(x, cells[found], points[found])
    return values


def locate(mesh: Mesh, points: ArrayLike) -> Int:
    """Cell of each point ``(q,)``: the lowest of those that hold it, −1 outside the mesh.

    Raises
    ------
    OptionError
        For points of another shape than ``(q, d)``.
    """
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != mesh.dim:
        raise OptionError(f"points must have shape (q, {mesh.dim}); given {points.shape}")
    if mesh.dim == 3:
        return cells_that_hold(mesh, np.asarray(points - mesh.origin))
    import shapely

    tree = shapely.STRtree(mesh.to_shapely())
    cells = np.full(len(points), mesh.n_cells)
    np.minimum.at(cells, *tree.query(shapely.points(points), predicate="intersects"))
    missed = np.flatnonzero((cells == mesh.n_cells) & np.isfinite(points).all(axis=1))
    reach = _NEAR * float(np.ptp(mesh.local_points, axis=0).max())
    at, near = tree.query_nearest(shapely.points(points[missed]), max_distance=reach)
    np.minimum.at(cells, missed[at], near)
    return frozen_int(np.where(cells < mesh.n_cells, cells, -1))
