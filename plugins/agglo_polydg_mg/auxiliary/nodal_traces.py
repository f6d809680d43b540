"""Nodal face basis for stretched elements, where bubble and vertex modes couple strongly.

Across a flat cell the trace energy is its mean square, and in the mean square a vertex function is nearly a
sum of bubbles. Functions that are 1 at one Gauss–Lobatto point of a face and 0 at the others
are nearly orthogonal. Constants have the value 1 everywhere, and the matrix of linear elements between
these points is spectrally equivalent (S. Orszag, J. Comput. Phys. 37, 1980): it guides classical levels.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Int, Mask, Mesh, frozen_float
from agglo_polydg_mg.auxiliary.conforming_space import ConformingSpace, bubble_signs
from agglo_polydg_mg.auxiliary.coupling_network import (
    Edges,
    across_faces,
    at_boundary,
    cotangents,
    network,
)


def on_nodes(space: ConformingSpace, mesh: Mesh) -> Mask:
    """Return a mask of faces ``(n_faces,)`` with bubbles whose cells share the unknowns at both ends."""
    inner = mesh.face_cells[:, 1] >= 0
    on_both = (space.ends[:, 0] == space.ends[:, 1]).all(axis=1)
    return np.asarray((space.bubbles >= 0) & (~inner | on_both))


def nodal_basis(space: ConformingSpace, mesh: Mesh) -> sparse.csr_array:
    """Return the map T ``(n, n)`` from values at vertices and face points to the unknowns.

    Face points take the face's bubble numbers, from its first end to the second. Faces outside
    :func:`on_nodes` keep their bubbles.
    """
    # 1. Bubble coefficients from values at points
    faces, extra = np.flatnonzero(on_nodes(space, mesh)), space.bubbles_of_a_face
    t = _points(extra)
    powers = np.arange(extra)
    values = (4.0 * t * (1.0 - t))[:, None] * (2.0 * t - 1.0)[:, None] ** powers
    inverse = np.linalg.inv(values)  # coefficients of bubbles from values at points
    first = space.bubbles[faces]
    signs = bubble_signs(mesh, space.bubbles, extra, space.n)
    # 2. Rows of the bubbles on nodal faces
    rows, columns, entries = [], [], []
    for k in range(extra):
        row_signs = signs[first + k]
        columns += [space.ends[faces, 0, 0], space.ends[faces, 0, 1], *(first + m for m in range(extra))]
        weights = (-(inverse[k] @ (1.0 - t)), -(inverse[k] @ t), *inverse[k])
        rows += [first + k] * len(weights)
        entries += [weight * row_signs for weight in weights]
    # 3. Identity for all other unknowns
    diagonal = np.ones(space.n)
    diagonal[(first[:, None] + powers).ravel()] = 0.0
    everywhere = np.arange(space.n)
    parts = (np.concatenate(x) for x in ((*entries, diagonal), (*rows, everywhere), (*columns, everywhere)))
    data, row, column = parts
    some = (data != 0.0) & (column >= 0)
    return sparse.coo_array((data[some], (row[some], column[some])), shape=(space.n, space.n)).tocsr()


def nodal_network(space: ConformingSpace, mesh: Mesh, kappa: Float) -> sparse.csr_array:
    """Return the coupling network, an M-matrix ``(n, n)``, for the unknowns of :func:`nodal_basis`.

    It corresponds to :func:`~agglo_polydg_mg.auxiliary.coupling_network.coupling_network`. Successive
    points on a face are joined. So are points on two cell faces at equal positions: along lines
    parallel to the third face in a triangle, and from side to side in a quadrilateral.

    Parameters
    ----------
    space : ConformingSpace
    mesh : Mesh
        The space's mesh, in 2-D.
    kappa : (n_cells,) float
        Cell coefficient.
    """
    nodal = on_nodes(space, mesh)
    edges = [each for side in (0, 1) for each in _along_faces(space, mesh, kappa, side, nodal)]
    edges += [across_faces(space, mesh, end) for end in (0, 1)]
    edges += _in_triangles(space, mesh, kappa, nodal) + _in_quadrilaterals(space, mesh, kappa, nodal)
    ground = at_boundary(space, mesh)
    outer = np.flatnonzero((mesh.face_cells[:, 1] < 0) & nodal)
    for k, share in enumerate(_shares(space.bubbles_of_a_face)):
        ground[space.bubbles[outer] + k] += share * space.jumps[outer]
    return network(edges, ground)


def _points(extra: int) -> Float:
    """Return the inner Gauss–Lobatto points ``(extra,)`` of [0, 1]."""
    legendre = np.polynomial.Legendre.basis(extra + 1)
    return frozen_float(0.5 + 0.5 * np.sort(legendre.deriv().roots().real))


def _shares(extra: int) -> Float:
    """Return half the distance between each inner point's neighbours ``(extra,)``."""
    t = np.concatenate(([0.0], _points(extra), [1.0]))
    return frozen_float(0.5 * (t[2:] - t[:-2]))


def _along_faces(space: ConformingSpace, mesh: Mesh, kappa: Float, side: int, nodal: Mask) -> list[Edges]:
    """Return network edges between successive points on a face, for the cells on one side of faces."""
    faces, weights = cotangents(mesh, kappa, side)
    extra, is_nodal = space.bubbles_of_a_face, nodal[faces]
    start, end = space.ends[faces, side].T
    t = np.concatenate(([0.0], _points(extra), [1.0]))
    chain = [start[is_nodal], *(space.bubbles[faces[is_nodal]] + k for k in range(extra)), end[is_nodal]]
    steps = zip(chain[:-1], chain[1:], np.diff(t), strict=True)
    edges = [(a, b, weights[is_nodal] / ((extra + 1) * step)) for a, b, step in steps]
    return [*edges, (start[~is_nodal], end[~is_nodal], 0.5 * weights[~is_nodal])]


def _in_triangles(space: ConformingSpace, mesh: Mesh, kappa: Float, nodal: Mask) -> list[Edges]:
    """Return network edges between points on two faces of a triangle, parallel to the third face."""
    # 1. Triangles with their faces
    offsets, of_cells = mesh.cell_faces
    cells = np.flatnonzero(np.diff(offsets) == 3)
    faces = of_cells[offsets[cells][:, None] + np.arange(3)]
    squares, extra = mesh.face_measures[faces] ** 2, space.bubbles_of_a_face
    places = _shares(extra) / _points(extra)
    edges = []
    # 2. For each third face: orient the two others from their common vertex, and join equal positions
    for third in range(3):
        e, f = faces[:, third - 2], faces[:, third - 1]
        cotangent = (squares.sum(axis=1) - 2.0 * squares[:, third]) / (4.0 * mesh.cell_measures[cells])
        both_nodal = nodal[e] & nodal[f]
        a, b = mesh.face_pairs[e[both_nodal]], mesh.face_pairs[f[both_nodal]]
        turned = [
            ~(x[:, :1] == y).any(axis=1) for x, y in ((a, b), (b, a))
        ]  # True if the face ends at the common vertex
        weights = (kappa[cells] * cotangent)[both_nodal]
        for k, place in enumerate(places):
            ends = [
                space.bubbles[g[both_nodal]] + np.where(flip, extra - 1 - k, k)
                for g, flip in zip((e, f), turned, strict=True)
            ]
            edges.append((*ends, place * weights))
    return edges


def _in_quadrilaterals(space: ConformingSpace, mesh: Mesh, kappa: Float, nodal: Mask) -> list[Edges]:
    """Return network edges between points on opposite faces of quadrilaterals."""
    cells, pairs = _opposite_faces(mesh)
    extra, squares = space.bubbles_of_a_face, mesh.face_measures[pairs] ** 2
    points = mesh.local_points[mesh.face_pairs[pairs]]
    directions = points[:, :, :, 1] - points[:, :, :, 0]
    alike = (directions[:, :, 0] * directions[:, :, 1]).sum(axis=2) > 0.0
    edges = []
    for pair in (0, 1):
        both_nodal = nodal[pairs[:, pair]].all(axis=1)
        first, second = space.bubbles[pairs[both_nodal, pair]].T
        weights = ((kappa * mesh.cell_measures)[cells] * (1.0 / squares[:, 1 - pair]).mean(axis=1))[
            both_nodal
        ]
        for k, share in enumerate(_shares(extra)):
            opposite = second + np.where(alike[both_nodal, pair], k, extra - 1 - k)
            edges.append((first + k, opposite, share * weights))
    return edges


def _opposite_faces(mesh: Mesh) -> tuple[Int, Any]:
    """Return the quadrilateral cells ``(q,)`` and their two pairs of opposite faces ``(q, 2, 2)``."""
    offsets, of_cells = mesh.cell_faces
    cells = np.flatnonzero(np.diff(offsets) == 4)
    faces = of_cells[offsets[cells][:, None] + np.arange(4)]
    ends = mesh.face_pairs[faces]
    meets = (ends[:, :1, :, None] == ends[:, 1:, None, :]).any(axis=(2, 3))
    partner = 1 + np.argmin(meets, axis=1)
    others = np.array([[2, 3], [1, 3], [1, 2]])[partner - 1]
    order = np.column_stack((np.zeros_like(partner), partner, others))
    return cells, np.take_along_axis(faces, order, axis=1).reshape(-1, 2, 2)
