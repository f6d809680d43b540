"""Jumps of a discrete function at quadrature points on faces, as a sparse matrix for repeated use."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from scipy import sparse

from agglo_core.authoring import Field, Float, Int, frozen_float, frozen_int
from agglo_core.fields.tensors import Tensor
from agglo_polydg_mg.forms.face_quadrature import face_coefficients, face_rule, on_pieces
from agglo_polydg_mg.space.basis import Basis

_MOST: Final = 20_000_000
"""Maximum number of stored entries: 240 MB."""
_FACES: Final = 20_000  # per batch


class JumpOperator(NamedTuple):
    """Jumps over inner faces, then traces on Dirichlet faces, at the points of a face rule.

    Attributes
    ----------
    values : (r, n) sparse
        ``values @ x`` are the jumps of the function with coefficients x.
    weights : (r,) float
        Quadrature weights times γσ.
    faces : (t,) int
        Dirichlet face of each of the last pieces.
    points : (t, q, d) float
        Their points, relative to the mesh origin.
    """

    values: sparse.csr_array
    weights: Float
    faces: Int
    points: Float

    def square(self, x: Float, targets: Float) -> float:
        """Return Σ_F γσ ‖[u]‖², with u − g on Dirichlet faces, for the values ``targets (t, q)`` of g."""
        jump = self.values @ x
        jump[len(jump) - targets.size :] -= targets.ravel()
        return float((self.weights * jump**2).sum())


def jump_operator(basis: Basis, kappa: Field | Tensor, sigma: Float) -> JumpOperator | None:
    """Return the operator for the penalty ``sigma (n_faces,)``, or None if it takes too much memory."""
    # 1. Faces, and quadrature rules as in the sums without operator where κ varies
    mesh, p = basis.mesh, basis.degree
    by_cell = kappa.by_cell if isinstance(kappa, Tensor) else not callable(kappa)
    penalised = np.flatnonzero(sigma > 0)
    is_inner, sizes = mesh.face_cells[penalised, 1] >= 0, np.diff(mesh.face_offsets)
    groups = ((penalised[is_inner], p + 1 if by_cell else p + 4, 2), (penalised[~is_inner], p + 4, 1))
    pieces = np.ones(mesh.n_faces) if mesh.dim == 2 else sizes - 2.0
    rows = sum(n ** (mesh.dim - 1) * cells * pieces[faces].sum() for faces, n, cells in groups)
    if rows * basis.n_local > _MOST:
        return None
    # 2. Values of the basis on either side, batch by batch
    lists: list[list[Any]] = [[np.zeros(0)] for _ in range(4)]
    entries, columns, counts, weights = lists
    faces, points = np.zeros(0, int), np.zeros((0, 1, mesh.dim))
    for group, n, cells in groups:
        for first in range(0, len(group), _FACES):
            some = frozen_int(group[first : first + _FACES])
            rule = face_rule(mesh, some, n)
            count = rule.points.shape[1]
            kappas = on_pieces(face_coefficients(mesh, kappa, some, n), some, rule)
            harmonic = 2 * kappas[:, 0] * (kappas[:, 1] / kappas.sum(axis=1))
            weights.append((rule.weights * sigma[rule.faces, None] * harmonic).ravel())
            owners = mesh.face_cells[rule.faces, :cells]
            signed = [(1 - 2 * k) * basis.values(owners[:, k], rule.points) for k in range(cells)]
            entries.append(np.concatenate(signed, axis=2).ravel())
            places = (owners[:, :, None] * basis.n_local + np.arange(basis.n_local)).reshape(len(owners), -1)
            columns.append(np.repeat(places, count, axis=0).ravel())
            counts.append(np.full(rule.weights.size, cells * basis.n_local))
            if cells == 1:
                faces = np.concatenate((faces, rule.faces))
                points = np.concatenate((points.reshape(-1, count, mesh.dim), rule.points))
    # 3. The matrix
    ends = np.concatenate(([0], np.cumsum(np.concatenate(counts)))).astype(int)
    arrays = np.concatenate(entries), np.concatenate(columns).astype(int), ends
    values = sparse.csr_array(arrays, shape=(len(ends) - 1, basis.n))
    return JumpOperator(
        values, frozen_float(np.concatenate(weights)), frozen_int(faces), frozen_float(points)
    )
