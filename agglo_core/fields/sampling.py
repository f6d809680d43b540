"""Points in each cell, with simplices between them, for pictures and files."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.fields.simplices import tetrahedra_of_solids, triangulate
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import gather

_INVERTED = -1e-12  # determinant relative to the cell volume: smaller in magnitude may be rounding


def sample_points(mesh: Mesh, p: int) -> tuple[Int, Float, Int]:
    """Return sample points in every cell: cells ``(q,)``, points ``(q, d)``, simplices ``(t, d + 1)``.

    Every cell is cut into simplices, and each simplex into pᵈ smaller simplices. A polyhedron that is not
    star-shaped from its centroid has its vertices as points, in the order of ``mesh.cell_vertices`` and after
    the points of other cells, and no simplices.
    """
    offsets, corners = triangulate(mesh) if mesh.dim == 2 else tetrahedra_of_solids(mesh)
    inverted = _inverted(mesh, offsets, corners) if mesh.dim == 3 else frozen_int([])
    if len(inverted):
        is_kept = np.ones(mesh.n_cells, bool)
        is_kept[inverted] = False
        corners = frozen_float(corners[np.repeat(is_kept, np.diff(offsets))])
        offsets = frozen_int(np.concatenate(([0], np.cumsum(np.diff(offsets) * is_kept))))
    lattice, small = _lattice(p, mesh.dim)
    edges = corners[:, 1:] - corners[:, :1]
    points = corners[:, None, 0] + sum(lattice[:, k : k + 1] * edges[:, None, k] for k in range(mesh.dim)) / p
    points = points.reshape(-1, mesh.dim) + mesh.origin
    cells = np.repeat(np.arange(mesh.n_cells), np.diff(offsets) * len(lattice))
    simplices = small + len(lattice) * np.arange(len(corners))[:, None, None]
    if len(inverted):
        starts, places = gather(mesh.cell_vertices[0], inverted)
        cells = np.concatenate((cells, np.repeat(inverted, np.diff(starts))))
        points = np.concatenate((points, mesh.points[mesh.cell_vertices[1][places]]))
    return cells, points, simplices.reshape(-1, mesh.dim + 1)


def _inverted(mesh: Mesh, offsets: Int, corners: Float) -> Int:
    """Return the cells with an inverted tetrahedron: not star-shaped from their centroids."""
    edges, own = corners[:, 1:] - corners[:, :1], np.repeat(np.arange(mesh.n_cells), np.diff(offsets))
    return frozen_int(np.unique(own[np.linalg.det(edges) < _INVERTED * mesh.cell_measures[own]]))


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
