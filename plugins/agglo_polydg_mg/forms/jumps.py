"""Jumps of a discontinuous function, and its energy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from agglo_core.authoring import Diffusion, Field, Float, Int, frozen_int
from agglo_polydg_mg.forms.assembly import jump_penalty, positive, stiffness
from agglo_polydg_mg.forms.boundary import Boundary, boundary_faces, boundary_values, data_offset
from agglo_polydg_mg.forms.face_quadrature import face_coefficients, face_rule, on_pieces
from agglo_polydg_mg.forms.penalty import Penalty
from agglo_polydg_mg.space.basis import Basis

_FACES = 20_000  # taken at once

Outside = Callable[[Int, Float], Float]
"""Values ``(t, q)`` outside of boundary faces ``(t,)`` at points ``(t, q, d)`` relative to the origin."""


@dataclass(frozen=True, eq=False)
class EnergyNorm:
    """The DG norm of what ``x (n,)`` stands for, with the jumps to the Dirichlet data at the boundary.

    (‖√κ ∇u‖² + Σ_F γσ ‖[u]‖² + Σ_F κσ ‖u − g‖²)^½. It is a sum of squares, hence exact to rounding, where
    a(u, u) is not: that holds σ‖g‖², which may be anything beside the energy of u. u and g are taken
    without the :func:`~agglo_polydg_mg.forms.boundary.data_offset`.
    """

    basis: Basis
    problem: Diffusion
    penalty: Penalty

    def __call__(self, x: Float) -> float:
        """The norm."""
        u, kappa = self.basis.coefficients(x), self._kappa
        inside = float(np.einsum("ci,cij,cj->", u, self._blocks, u, optimize=True))
        return float(np.sqrt(inside + jumps(self.basis, x, self._data, kappa, self._sigma)))

    def _data(self, faces: Int, points: Float) -> Float:
        mesh, held = self.basis.mesh, self.problem.dirichlet
        g = boundary_values(mesh, self._boundary, held, faces, points, "dirichlet")
        return g - self._offset[mesh.face_cells[faces, 0], None]

    @cached_property
    def _boundary(self) -> Boundary:
        return boundary_faces(self.basis.mesh, self.problem)

    @cached_property
    def _offset(self) -> Float:
        return offset_of(self.basis, self.problem)

    @cached_property
    def _kappa(self) -> Field:
        return positive(self.basis.mesh, self.problem.kappa)

    @cached_property
    def _blocks(self) -> Float:
        return stiffness(self.basis, self._kappa)

    @cached_property
    def _sigma(self) -> Float:
        natural = self._boundary.natural
        return jump_penalty(self.basis, self._kappa, self.penalty, natural, inside=self._blocks)


def offset_of(basis: Basis, problem: Diffusion) -> Float:
    """The :func:`~agglo_polydg_mg.forms.boundary.data_offset` of a problem ``(n_cells,)``."""
    mesh, boundary = basis.mesh, boundary_faces(basis.mesh, problem)
    kappa = positive(mesh, problem.kappa)
    own = face_coefficients(mesh, kappa, boundary.dirichlet, basis.degree + 2)[:, 0]
    return data_offset(basis, problem, boundary, own)


def jumps(basis: Basis, x: Float, outside: Outside, kappa: Field, sigma: Float) -> float:
    """Σ_F γσ ‖[u]‖² over interior and Dirichlet faces, of the function with coefficients ``x (n,)``."""
    mesh, n, total = basis.mesh, basis.degree + 4, 0.0
    chosen = np.flatnonzero(sigma > 0)
    for first in range(0, len(chosen), _FACES):
        faces = frozen_int(chosen[first : first + _FACES])
        rule = face_rule(mesh, faces, n)
        own, points = rule.faces, rule.points
        inner, both = (
            mesh.face_cells[own, 1] >= 0,
            on_pieces(face_coefficients(mesh, kappa, faces, n), faces, rule),
        )
        jump = _traces(basis, x, mesh.face_cells[own, 0], points)
        jump[inner] -= _traces(basis, x, mesh.face_cells[own[inner], 1], points[inner])
        jump[~inner] -= outside(frozen_int(own[~inner]), points[~inner])
        harmonic = 2 * both[:, 0] * (both[:, 1] / both.sum(axis=1))  # κ itself where both sides agree
        total += float((rule.weights * sigma[own, None] * harmonic * jump**2).sum())
    return total


def _traces(basis: Basis, x: Float, cells: Int, points: Float) -> Float:
    """Values ``(f, q)`` of the function in ``cells (f,)`` at ``points (f, q, d)``."""
    values = basis.values(np.repeat(cells, points.shape[1]), points.reshape(-1, points.shape[2]))
    rows = np.repeat(basis.coefficients(x)[cells], points.shape[1], axis=0)
    return np.asarray(np.einsum("qk,qk->q", values, rows).reshape(points.shape[:2]))
