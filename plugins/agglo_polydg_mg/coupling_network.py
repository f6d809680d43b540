"""A network of the unknowns of the continuous space, whose couplings all draw together.

In flat cells the matrix of the space is no guide to coarsening: a polynomial fits values at four corners in
the mean only, so that many couplings are positive, and large. The network has the same energy within factors
and no positive coupling: classical levels take from it which unknowns stay and how the others interpolate.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Int, Mesh
from agglo_polydg_mg.conforming_space import ConformingSpace, directions

__all__ = ["coupling_network"]

_STRONG = 1.0
"""Bubbles are joined if that couples them more than this many times what each costs by itself."""
_SLOPE, _MASS = 16 / 3, 8 / 15
"""Integrals over 0..1 of the squares of the slope of 4t(1 − t), and of itself."""


def coupling_network(space: ConformingSpace, mesh: Mesh, kappa: Float) -> sparse.csr_array:
    """Symmetric matrix ``(n, n)``, diagonally dominant, without positive entries off the diagonal.

    In each cell, vertices are joined along its faces, by what the difference between them costs at least. On
    rectangles that is the five-point matrix, on triangles the matrix of linear elements without its positive
    couplings. Across faces that do not tie their cells, unknowns of one vertex are joined by what a jump
    costs. Bubbles of opposite faces of a quadrilateral are joined where they are near to each other.

    Parameters
    ----------
    space : ConformingSpace
    mesh : Mesh
        In 2-D, that of the space.
    kappa : (n_cells,) float
        Coefficient of the cells.
    """
    edges = [_along_faces(space, mesh, kappa, side) for side in (0, 1)]
    edges += [_across_faces(space, mesh, end) for end in (0, 1)]
    diagonal = _boundary(space, mesh)
    if space.n > space.n_vertices:
        diagonal += _own(space, mesh, kappa)
        edges += _between_bubbles(space, mesh, kappa, diagonal)
    first, second, weights = (np.concatenate(each) for each in zip(*edges, strict=True))
    kept = (first != second) & (first >= 0) & (second >= 0) & (weights > 0.0)
    first, second, weights = first[kept], second[kept], weights[kept]
    diagonal += np.bincount(first, weights, space.n) + np.bincount(second, weights, space.n)
    everywhere = np.arange(space.n)
    rows = np.concatenate((first, second, everywhere))
    columns = np.concatenate((second, first, everywhere))
    values = np.concatenate((-weights, -weights, np.where(diagonal > 0.0, diagonal, 1.0)))
    return sparse.coo_array((values, (rows, columns)), shape=(space.n, space.n)).tocsr()


_Edges = tuple[Any, Any, Any]
"""Unknowns at both ends, and conductances."""


def _along_faces(space: ConformingSpace, mesh: Mesh, kappa: Float, side: int) -> _Edges:
    """Between the ends of each face, in the cell on one side of it."""
    faces = np.flatnonzero(mesh.face_cells[:, side] >= 0)
    cells, squares = mesh.face_cells[faces, side], mesh.face_measures**2
    offsets, of_cells = mesh.cell_faces
    sides, area = np.diff(offsets)[cells], mesh.cell_measures[cells]
    around = np.add.reduceat(squares[of_cells], offsets[:-1])[cells]
    cotangent = (around - 2.0 * squares[faces]) / (4.0 * area)  # of the angle opposite, in a triangle
    weights = np.where(sides == 3, 0.5 * cotangent, 2.0 * area / (sides * squares[faces]))
    first, second = space.ends[faces, side].T
    return first, second, kappa[cells] * weights


def _across_faces(space: ConformingSpace, mesh: Mesh, end: int) -> _Edges:
    """Between the unknowns that the cells beside a face have at one of its ends."""
    inner = mesh.face_cells[:, 1] >= 0
    first, second = space.ends[inner, :, end].T
    return first, second, 0.5 * space.jumps[inner]


def _boundary(space: ConformingSpace, mesh: Mesh) -> Any:
    """What each unknown costs by its jump at the boundary ``(n,)``."""
    outer = mesh.face_cells[:, 1] < 0
    ends = space.ends[outer, 0]
    halves = np.where(ends >= 0, 0.5 * space.jumps[outer, None], 0.0)
    return np.bincount(np.maximum(ends, 0).ravel(), halves.ravel(), space.n)


def _own(space: ConformingSpace, mesh: Mesh, kappa: Float) -> Any:
    """What each bubble costs by its slope along the face ``(n,)``."""
    found = np.zeros(space.n)
    for side in (0, 1):
        faces = np.flatnonzero((mesh.face_cells[:, side] >= 0) & (space.bubbles >= 0))
        cells = mesh.face_cells[faces, side]
        costs = 0.5 * _SLOPE * kappa[cells] * mesh.cell_measures[cells] / mesh.face_measures[faces] ** 2
        for k in range(space.bubbles_of_a_face):
            found[space.bubbles[faces] + k] += costs
    return found


def _between_bubbles(space: ConformingSpace, mesh: Mesh, kappa: Float, own: Float) -> list[_Edges]:
    """Between those of one order on both pairs of opposite faces of quadrilaterals."""
    cells, pairs = _opposite_faces(mesh)
    apart = mesh.face_measures[pairs].mean(axis=2)[:, ::-1]  # faces of one pair are as far apart
    weights = _MASS * (kappa * mesh.cell_measures)[cells, None] / apart**2
    first, second = (space.bubbles[pairs[:, :, k]] for k in (0, 1))
    kept = (first >= 0) & (second >= 0)
    kept &= weights > _STRONG * np.maximum(own[np.maximum(first, 0)], own[np.maximum(second, 0)])
    along = directions(mesh)[pairs]
    alike = (along[:, :, 0] * along[:, :, 1]).sum(axis=2) > 0.0
    found = []
    for k in range(space.bubbles_of_a_face):
        some = kept & alike if k % 2 else kept
        found.append((first[some] + k, second[some] + k, weights[some]))
    return found


def _opposite_faces(mesh: Mesh) -> tuple[Int, Any]:
    """Quadrilaterals ``(q,)``, and both pairs of their faces without a common vertex ``(q, 2, 2)``."""
    offsets, of_cells = mesh.cell_faces
    cells = np.flatnonzero(np.diff(offsets) == 4)
    faces = of_cells[offsets[cells][:, None] + np.arange(4)]
    ends = mesh.face_pairs[faces]
    meets = (ends[:, :1, :, None] == ends[:, 1:, None, :]).any(axis=(2, 3))
    partner = 1 + np.argmin(meets, axis=1)
    others = np.array([[2, 3], [1, 3], [1, 2]])[partner - 1]
    order = np.column_stack((np.zeros_like(partner), partner, others))
    return cells, np.take_along_axis(faces, order, axis=1).reshape(-1, 2, 2)
