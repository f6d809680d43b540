"""Jumps of a discrete function at quadrature points on faces, as sparse matrices."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

import numpy as np
from scipy import sparse

from agglo_core.authoring import Field, Float, Int, Mesh, frozen_float, frozen_int
from agglo_core.fields.tensors import Tensor
from agglo_polydg_mg.forms.face_quadrature import face_coefficients, face_rule, on_pieces
from agglo_polydg_mg.space.basis import Basis

_MOST: Final = 20_000_000
"""Maximum number of stored entries: 240 MB."""
_FACES: Final = 20_000  # per batch: limits the memory for the basis at points (benchmarks/constants.py)


Outside = Callable[[Int, Float], Float]
"""Outer values ``(t, q)`` on boundary faces ``(t,)`` at points ``(t, q, d)`` relative to the origin."""


class JumpOperator(NamedTuple):
    """Jumps over inner faces, or traces on Dirichlet faces, at the points of a face rule.

    Attributes
    ----------
    values : (r, n) sparse
        ``values @ x`` are the jumps of the function with coefficients x.
    weights : (r,) float
        Quadrature weights times γσ.
    faces : (t,) int
        Face of each piece of Dirichlet faces; none for inner faces.
    points : (t, q, d) float
        Their points, relative to the mesh origin.
    """

    values: sparse.csr_array
    weights: Float
    faces: Int
    points: Float

    def targets(self, outside: Outside) -> Float:
        """Return the outer values ``(t, q)`` on Dirichlet faces, none on inner faces."""
        return outside(self.faces, self.points) if len(self.faces) else np.zeros((0, 1))

    def square(self, x: Float, targets: Float) -> float:
        """Return Σ_F γσ ‖[u]‖², with u − g on Dirichlet faces, for the values ``targets (t, q)`` of g."""
        jump = self.values @ x
        if targets.size:
            jump -= targets.ravel()
        return float((self.weights * jump**2).sum())


def jump_operators(basis: Basis, kappa: Field | Tensor, sigma: Float) -> Iterator[JumpOperator]:
    """Yield the operators for the penalty ``sigma (n_faces,)``, in batches of inner or Dirichlet faces."""
    mesh = basis.mesh
    for group, n, sides in _groups(basis, kappa, sigma):
        for first in range(0, len(group), _FACES):
            # 1. Quadrature points and weights
            faces = frozen_int(group[first : first + _FACES])
            rule = face_rule(mesh, faces, n)
            kappas = on_pieces(face_coefficients(mesh, kappa, faces, n), faces, rule)
            harmonic = 2 * kappas[:, 0] * (kappas[:, 1] / kappas.sum(axis=1))  # κ itself if both sides agree
            weights = frozen_float((rule.weights * sigma[rule.faces, None] * harmonic).ravel())
            # 2. Values of the basis on either side
            cells = mesh.face_cells[rule.faces, :sides]
            signed = [(1 - 2 * k) * basis.values(cells[:, k], rule.points) for k in range(sides)]
            columns = (cells[:, :, None] * basis.n_local + np.arange(basis.n_local)).reshape(len(cells), -1)
            columns = np.repeat(columns, rule.points.shape[1], axis=0)
            ends = np.arange(len(columns) + 1) * columns.shape[1]
            arrays = np.concatenate(signed, axis=2).ravel(), columns.ravel(), ends
            values = sparse.csr_array(arrays, shape=(len(columns), basis.n))
            yield JumpOperator(values, weights, *((rule.faces, rule.points) if sides == 1 else _none(mesh)))


def fit_in_memory(basis: Basis, kappa: Field | Tensor, sigma: Float) -> bool:
    """Return True unless the operators have too many entries to be kept."""
    dim, n_faces = basis.mesh.dim, basis.mesh.n_faces
    pieces = np.ones(n_faces) if dim == 2 else np.diff(basis.mesh.face_offsets) - 2.0
    groups = _groups(basis, kappa, sigma)
    rows = sum(n ** (dim - 1) * sides * pieces[faces].sum() for faces, n, sides in groups)
    return bool(rows * basis.n_local <= _MOST)


def _groups(basis: Basis, kappa: Field | Tensor, sigma: Float) -> Iterator[tuple[Int, int, int]]:
    """Yield the inner and the Dirichlet faces, with the number of Gauss points and of cells of each."""
    p, by_cell = basis.degree, kappa.by_cell if isinstance(kappa, Tensor) else not callable(kappa)
    inner = basis.mesh.face_cells[:, 1] >= 0
    yield np.flatnonzero((sigma > 0) & inner), p + 1 if by_cell else p + 4, 2
    yield np.flatnonzero((sigma > 0) & ~inner), p + 4, 1


def _none(mesh: Mesh) -> tuple[Int, Float]:
    return frozen_int([]), frozen_float(np.zeros((0, 1, mesh.dim)))
