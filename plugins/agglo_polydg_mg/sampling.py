"""Discontinuous polynomials sampled cell by cell, for files and pictures."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Float, Int, Samples
from agglo_polydg_mg.basis import Basis
from agglo_polydg_mg.quadrature import triangulate

__all__ = ["sampled", "samples_of"]


def samples_of(basis: Basis, x: Float) -> Samples:
    """The function with coefficients ``x (n,)``: every cell is cut into triangles, each into p² smaller ones.

    Raises
    ------
    OptionError
        If x has another length than the space.
    """
    cells, points, triangles = sampled(basis)
    return Samples(cells, points, triangles, basis.evaluate(x, cells, points))


def sampled(basis: Basis) -> tuple[Int, Float, Int]:
    """Points that sample every cell: their cells ``(q,)``, the points ``(q, 2)`` and triangles ``(t, 3)``."""
    offsets, corners = triangulate(basis.mesh)
    p = basis.degree
    lattice = np.array([(i, j) for j in range(p + 1) for i in range(p + 1 - j)])
    number = {(i, j): k for k, (i, j) in enumerate(lattice.tolist())}
    small = [(number[i, j], number[i + 1, j], number[i, j + 1]) for i, j in number if i + j < p]
    small += [(number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]) for i, j in number if i + j < p - 1]
    u, v = (corners[:, k] - corners[:, 0] for k in (1, 2))
    points = corners[:, None, 0] + (lattice[:, :1] * u[:, None] + lattice[:, 1:] * v[:, None]) / p
    cells = np.repeat(np.arange(basis.mesh.n_cells), np.diff(offsets) * len(lattice))
    triangles = np.array(small) + len(lattice) * np.arange(len(corners))[:, None, None]
    return cells, points.reshape(-1, 2) + basis.mesh.origin, triangles.reshape(-1, 3)
