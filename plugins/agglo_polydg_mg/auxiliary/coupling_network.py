"""Build an M-matrix surrogate for the matrix of the continuous space, to guide coarsening.

In flat cells the matrix of the space is no guide: a polynomial fits the values at four corners only in the
mean, so that many couplings are positive and large. The network is spectrally equivalent and has no
positive coupling. Classical levels use it to choose C-points and interpolation.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Int, Mesh, frozen_int
from agglo_polydg_mg.auxiliary.conforming_space import ConformingSpace

_HELD = 2.0
"""An unknown is held if its boundary jump costs more than this multiple of its couplings. Held unknowns are
not interpolated from (benchmarks/solve.py --meshes layers)."""

Edges = tuple[Any, Any, Any]
"""Unknowns at both ends, and conductances."""


def coupling_network(space: ConformingSpace, mesh: Mesh, kappa: Float) -> sparse.csr_array:
    """Return the coupling network, a symmetric, diagonally dominant M-matrix ``(n, n)``.

    In each cell, the vertices are joined along its faces; the weight is a lower bound for the energy of
    their difference. On rectangles the result is the five-point matrix, on triangles the matrix of linear
    elements without its positive couplings. Across faces that do not couple their cells, the unknowns of a
    vertex are joined by the energy of a jump. Bubbles are not joined; see
    :func:`~agglo_polydg_mg.auxiliary.nodal_traces.nodal_network`.

    Parameters
    ----------
    space : ConformingSpace
    mesh : Mesh
        The space's mesh, in 2-D.
    kappa : (n_cells,) float
        Cell coefficient.
    """
    edges = [_along_faces(space, mesh, kappa, side) for side in (0, 1)]
    edges += [across_faces(space, mesh, end) for end in (0, 1)]
    ground = at_boundary(space, mesh)
    return network(edges, ground)


def network(edges: Sequence[Edges], ground: Any) -> sparse.csr_array:
    """Assemble the M-matrix ``(n, n)`` of weighted edges, with ``ground (n,)`` added to the diagonal.

    Edges without an unknown at one end, and edges without conductance, are left out. An edge to an unknown
    held by the boundary becomes a diagonal cost of the other end: there is nothing to interpolate from.
    """
    n = len(ground)
    first, second, weights = (np.concatenate(each) for each in zip(*edges, strict=True))
    kept = (first != second) & (first >= 0) & (second >= 0) & (weights > 0.0)
    first, second, weights = first[kept], second[kept], weights[kept]
    couplings = np.bincount(first, weights, n) + np.bincount(second, weights, n)
    diagonal = ground + couplings
    held = ground > _HELD * couplings
    free = ~(held[first] | held[second])
    first, second, weights = first[free], second[free], weights[free]
    everywhere = np.arange(n)
    rows = np.concatenate((first, second, everywhere))
    columns = np.concatenate((second, first, everywhere))
    values = np.concatenate((-weights, -weights, np.where(diagonal > 0.0, diagonal, 1.0)))
    return sparse.coo_array((values, (rows, columns)), shape=(n, n)).tocsr()


def _along_faces(space: ConformingSpace, mesh: Mesh, kappa: Float, side: int) -> Edges:
    """Return network edges between each face's end unknowns, for the cells on one side of faces."""
    faces, weights = cotangents(mesh, kappa, side)
    first, second = space.ends[faces, side].T
    return first, second, weights


def cotangents(mesh: Mesh, kappa: Float, side: int) -> tuple[Int, Any]:
    """Return the faces ``(m,)`` with a cell on the given side, and their edge weights in this cell.

    The weight is the energy in this cell for a unit difference between the face ends.
    """
    faces = np.flatnonzero(mesh.face_cells[:, side] >= 0)
    cells, squares = mesh.face_cells[faces, side], mesh.face_measures**2
    offsets, of_cells = mesh.cell_faces
    sides, area = np.diff(offsets)[cells], mesh.cell_measures[cells]
    around = np.add.reduceat(squares[of_cells], offsets[:-1])[cells]
    cotangent = (around - 2.0 * squares[faces]) / (4.0 * area)  # of the angle opposite, in a triangle
    weights = np.where(sides == 3, 0.5 * cotangent, 2.0 * area / (sides * squares[faces]))
    return frozen_int(faces), kappa[cells] * weights


def across_faces(space: ConformingSpace, mesh: Mesh, end: int) -> Edges:
    """Return network edges across inner faces, between both cells' unknowns at one end of the face."""
    inner = mesh.face_cells[:, 1] >= 0
    first, second = space.ends[inner, :, end].T
    return first, second, 0.5 * space.jumps[inner]


def at_boundary(space: ConformingSpace, mesh: Mesh) -> Any:
    """Return each unknown's boundary jump energy ``(n,)``."""
    outer = np.flatnonzero(mesh.face_cells[:, 1] < 0)
    jumps = space.jumps[outer]
    ends = space.ends[outer, 0]
    halves = np.where(ends >= 0, 0.5 * jumps[:, None], 0.0)
    return np.bincount(np.maximum(ends, 0).ravel(), halves.ravel(), space.n)
