"""Evaluate discrete functions: at sample points in each cell for pictures, and at any points."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from agglo_core.authoring import (
    Float,
    Int,
    Mesh,
    MeshError,
    OptionError,
    Quadrature,
    Samples,
    frozen_float,
    frozen_int,
)
from agglo_polydg_mg.space.basis import Basis
from agglo_polydg_mg.space.quadrature import inside, triangulate
from agglo_polydg_mg.space.solid_geometry import boxes_of_solids, tetrahedra_of_solids, triangles_of_faces

_INVERTED = -1e-12  # determinant relative to the cell volume: smaller in magnitude may be rounding


def samples_of(basis: Basis, x: Float) -> Samples:
    """Sample the function with coefficients ``x (n,)`` at points in every cell, for pictures.

    Every cell is cut into simplices, and each simplex into pᵈ smaller simplices.

    Raises
    ------
    OptionError
        If the length of x does not match the space.
    MeshError
        In 3-D, for cells that are not star-shaped from their centroids.
    """
    cells, points, simplices = sample_points(basis)
    centres = points[simplices].mean(axis=1)
    slopes = basis.gradient(x, cells[simplices[:, 0]], centres)
    return Samples(cells, points, simplices, basis.evaluate(x, cells, points), slopes)


def sample_points(basis: Basis) -> tuple[Int, Float, Int]:
    """Return sample points in every cell: cells ``(q,)``, points ``(q, d)``, simplices ``(t, d + 1)``."""
    mesh, p = basis.mesh, basis.degree
    offsets, corners = triangulate(mesh) if mesh.dim == 2 else _tetrahedra(basis)
    lattice, small = _lattice(p, mesh.dim)
    edges = corners[:, 1:] - corners[:, :1]
    points = corners[:, None, 0] + sum(lattice[:, k : k + 1] * edges[:, None, k] for k in range(mesh.dim)) / p
    cells = np.repeat(np.arange(mesh.n_cells), np.diff(offsets) * len(lattice))
    simplices = small + len(lattice) * np.arange(len(corners))[:, None, None]
    return cells, points.reshape(-1, mesh.dim) + mesh.origin, simplices.reshape(-1, mesh.dim + 1)


def _tetrahedra(basis: Basis) -> tuple[Int, Float]:
    """Return the tetrahedra of all cells, or raise MeshError if some are inverted."""
    mesh = basis.mesh
    offsets, corners = tetrahedra_of_solids(mesh)
    edges, own = corners[:, 1:] - corners[:, :1], np.repeat(np.arange(mesh.n_cells), np.diff(offsets))
    bad = np.unique(own[np.linalg.det(edges) < _INVERTED * mesh.cell_measures[own]])
    if len(bad):
        raise MeshError(
            f"cells {bad[:5].tolist()} are not star-shaped from their centroids, so they cannot be divided "
            "into tetrahedra to sample a solution"
        )
    return offsets, corners


def _lattice(p: int, dim: int) -> tuple[Int, Int]:
    """Return integer points ``(q, d)`` in a simplex with side p, and the small simplices between them.

    In the coordinates x + y + z, y + z, z the cubes of the lattice are cut along their diagonals (H. Kuhn).
    """
    lattice = np.array([point[::-1] for point in product(range(p + 1), repeat=dim) if sum(point) <= p])
    number = {tuple(point): k for k, point in enumerate(lattice.tolist())}
    steps = np.eye(dim, dtype=int) - np.eye(dim, k=1, dtype=int).T
    small = []
    for corner in lattice:
        for axes in permutations(range(dim)):
            path = [
                tuple(point) for point in (corner + np.cumsum([0 * corner, *steps[list(axes)]], 0)).tolist()
            ]
            if all(point in number for point in path):
                is_positive = round(np.linalg.det(np.eye(dim)[list(axes)])) > 0
                path[1:] = path[1:] if is_positive else [*path[2:0:-1], *path[3:]]
                small.append([number[point] for point in path])
    return frozen_int(lattice), frozen_int(small)


_TRIANGLES = 1_000_000  # per batch: some hundred MB of corners, points and angles (benchmarks/constants.py)
_INSIDE = 0.01
"""Solid angle fraction above which a point belongs to a cell: on faces both cells have half.
Benchmark: benchmarks/constants.py."""


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
    ends, first = np.concatenate(([0], np.cumsum(sizes[cells]))), 0
    while first < len(cells):
        stop = max(first + 1, int(np.searchsorted(ends, ends[first] + _TRIANGLES, "right")) - 1)
        part = slice(first, stop)
        inside = _winding_numbers(mesh, points[candidates[part]], cells[part]) > _INSIDE
        np.minimum.at(lowest_cells, candidates[part][inside], cells[part][inside])
        first = stop
    return frozen_int(np.where(lowest_cells < mesh.n_cells, lowest_cells, -1))


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


_NEAR = 1e-9  # relative to the mesh size: points on a face may miss both cells by rounding


def evaluate(basis: Basis, x: Float, points: ArrayLike) -> Float:
    """Evaluate the function with coefficients ``x (n,)`` at ``points (q, d)``.

    Returns values ``(q,)``, NaN outside. On a face, where the function has two values, the cell with the
    lower number counts.

    Raises
    ------
    OptionError
        For points with another shape.
    """
    points = np.asarray(points, dtype=float)
    cells = locate(basis.mesh, points)
    found = cells >= 0
    values = np.full(len(points), np.nan)
    values[found] = basis.evaluate(x, cells[found], points[found])
    return values


def quadrature(basis: Basis) -> Quadrature:
    """Return a quadrature rule on all cells, exact up to twice the degree, with the basis at its points."""
    batches = list(inside(basis.mesh, 2 * basis.degree))
    points, weights = (np.concatenate([batch[k] for batch in batches]) for k in (2, 3))
    cells = np.concatenate([batch.cells for batch in batches])
    values = np.concatenate([basis.values(batch.cells, batch.points) for batch in batches])
    columns = cells[:, None] * basis.n_local + np.arange(basis.n_local)
    ends = np.arange(len(cells) + 1) * basis.n_local
    at_points = sparse.csr_array((values.ravel(), columns.ravel(), ends), shape=(len(cells), basis.n))
    return Quadrature(frozen_float(points + basis.mesh.origin), frozen_float(weights), at_points)


def gradient(basis: Basis, x: Float, points: ArrayLike) -> Float:
    """Evaluate the gradient of a function at ``points (q, d)``, in the cells that :func:`evaluate` uses.

    Returns gradients ``(q, d)``, NaN outside.

    Raises
    ------
    OptionError
        For points with another shape.
    """
    points = np.asarray(points, dtype=float)
    cells = locate(basis.mesh, points)
    found = cells >= 0
    slopes = np.full(points.shape, np.nan)
    slopes[found] = basis.gradient(x, cells[found], points[found])
    return slopes


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
