"""Points in each cell, with simplices between them, for pictures and files."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.errors import MeshError
from agglo_core.fields.simplices import tetrahedra_of_solids, triangulate
from agglo_core.mesh import Mesh

_INVERTED = -1e-12  # determinant relative to the cell volume: smaller in magnitude may be rounding


def sample_points(mesh: Mesh, p: int) -> tuple[Int, Float, Int]:
    """Return sample points in every cell: cells ``(q,)``, points ``(q, d)``, simplices ``(t, d + 1)``.

    Every cell is cut into simplices, and each simplex into pᵈ smaller simplices.
    """
    offsets, corners = triangulate(mesh) if mesh.dim == 2 else _tetrahedra(mesh)
    lattice, small = _lattice(p, mesh.dim)
    edges = corners[:, 1:] - corners[:, :1]
    points = corners[:, None, 0] + sum(lattice[:, k : k + 1] * edges[:, None, k] for k in range(mesh.dim)) / p
    cells = np.repeat(np.arange(mesh.n_cells), np.diff(offsets) * len(lattice))
    simplices = small + len(lattice) * np.arange(len(corners))[:, None, None]
    return cells, points.reshape(-1, mesh.dim) + mesh.origin, simplices.reshape(-1, mesh.dim + 1)


def _tetrahedra(mesh: Mesh) -> tuple[Int, Float]:
    """Return the tetrahedra of all cells, or raise MeshError if some are inverted."""
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
