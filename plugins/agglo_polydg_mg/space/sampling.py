"""Discontinuous polynomials sampled cell by cell, for files and pictures."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from agglo_core.authoring import Float, Int, MeshError, Samples, frozen_int
from agglo_polydg_mg.space.basis import Basis
from agglo_polydg_mg.space.solid_geometry import tetrahedra_of_solids
from agglo_polydg_mg.space.triangulation import triangulate

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
