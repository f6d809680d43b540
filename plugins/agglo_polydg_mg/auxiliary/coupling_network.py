"""A network of the unknowns of the continuous space, whose couplings all draw together.

In flat cells the matrix of the space is no guide to coarsening: a polynomial fits values at four corners in
the mean only, so that many couplings are positive, and large. The network has the same energy within factors
and no positive coupling: classical levels take from it which unknowns stay and how the others interpolate.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Int, Mesh, frozen_int
from agglo_polydg_mg.auxiliary.conforming_space import ConformingSpace

_HELD = 2.0
"""An unknown is held if its jump at the boundary costs more than this many times its couplings."""

Edges = tuple[Any, Any, Any]
"""Unknowns at both ends, and conductances."""


def coupling_network(space: ConformingSpace, mesh: Mesh, kappa: Float) -> sparse.csr_array:
    """Symmetric matrix ``(n, n)``, diagonally dominant, without positive entries off the diagonal.

    In each cell, vertices are joined along its faces, by what the difference between them costs at least. On
    rectangles that is the five-point matrix, on triangles the matrix of linear elements without its positive
    couplings. Across faces that do not tie their cells, unknowns of one vertex are joined by what a jump
    costs. Bubbles are not joined; see :func:`~agglo_polydg_mg.auxiliary.nodal_traces.nodal_network`.

    Parameters
    ----------
    space : ConformingSpace
    mesh : Mesh
        In 2-D, that of the space.
    kappa : (n_cells,) float
        Coefficient of the cells.
    """
    edges = [_along_faces(space, mesh, kappa, side) for side in (0, 1)]
    edges += [across_faces(space, mesh, end) for end in (0, 1)]
    ground = at_boundary(space, mesh)
    return network(edges, ground)


def network(edges: Sequence[Edges], ground: Any) -> sparse.csr_array:
    """The matrix ``(n, n)`` of edges, what each unknown costs by itself being ``ground (n,)``.

    Edges without an unknown at one end, and of no conductance, are left out. One to an unknown that the
    boundary holds is a cost of the other: there is nothing to interpolate from.
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
    """Between the ends of each face, in the cell on one side of it."""
    faces, weights = cotangents(mesh, kappa, side)
    first, second = space.ends[faces, side].T
    return first, second, weights


def cotangents(mesh: Mesh, kappa: Float, side: int) -> tuple[Int, Any]:
    """Faces ``(m,)`` with a cell on that side, and what the difference between their ends costs there."""
    faces = np.flatnonzero(mesh.face_cells[:, side] >= 0)
    cells, squares = mesh.face_cells[faces, side], mesh.face_measures**2
    offsets, of_cells = mesh.cell_faces
    sides, area = np.diff(offsets)[cells], mesh.cell_measures[cells]
    around = np.add.reduceat(squares[of_cells], offsets[:-1])[cells]
    cotangent = (around - 2.0 * squares[faces]) / (4.0 * area)  # of the angle opposite, in a triangle
    weights = np.where(sides == 3, 0.5 * cotangent, 2.0 * area / (sides * squares[faces]))
    return frozen_int(faces), kappa[cells] * weights


def across_faces(space: ConformingSpace, mesh: Mesh, end: int) -> Edges:
    """Between the unknowns that the cells beside a face have at one of its ends."""
    inner = mesh.face_cells[:, 1] >= 0
    first, second = space.ends[inner, :, end].T
    return first, second, 0.5 * space.jumps[inner]


def at_boundary(space: ConformingSpace, mesh: Mesh) -> Any:
    """What each unknown costs by its jump at the boundary ``(n,)``."""
    outer = np.flatnonzero(mesh.face_cells[:, 1] < 0)
    jumps = space.jumps[outer]
    ends = space.ends[outer, 0]
    halves = np.where(ends >= 0, 0.5 * jumps[:, None], 0.0)
    return np.bincount(np.maximum(ends, 0).ravel(), halves.ravel(), space.n)
