"""Norms of discrete functions and their errors, including the jumps on faces."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from agglo_core.authoring import Diffusion, Field, Float, Int, Mask, Mesh, OptionError
from agglo_core.fields.boundary import BoundaryParts, boundary_values
from agglo_core.fields.coefficients import positive
from agglo_core.fields.errors import error_norms
from agglo_core.fields.polynomials import Polynomials
from agglo_core.fields.tensors import Tensor
from agglo_core.fields.values import sample
from agglo_polydg_mg.forms.assembly import jump_penalty
from agglo_polydg_mg.forms.boundary import (
    RobinTerms,
    boundary_faces,
    data_offset,
    robin_terms,
)
from agglo_polydg_mg.forms.coefficients import reaction_blocks
from agglo_polydg_mg.forms.face_quadrature import face_coefficients
from agglo_polydg_mg.forms.jump_operator import JumpOperator, Outside, fit_in_memory, jump_operators
from agglo_polydg_mg.forms.penalty import PAPER, Penalty
from agglo_polydg_mg.space.basis import Basis, stiffness

_WITHOUT_DATA = ("_boundary", "_kappa", "_blocks", "_reaction", "_sigma", "_operators")


@dataclass(frozen=True, eq=False)
class EnergyNorm:
    """The DG norm of a discrete function, with its distance to the boundary data and the reaction.

    (‖√κ ∇u‖² + ‖√c u‖² + Σ_F γσ ‖[u]‖² + Σ_F κσ ‖u − g‖²)^½, for Robin data with α ‖u − g/α‖² on their
    faces. It is a sum of squares, hence exact to rounding. In contrast, a(u, u) contains σ‖g‖², which may
    exceed the energy of u by any factor. u and g are taken without the
    :func:`~agglo_polydg_mg.forms.boundary.data_offset`.
    """

    basis: Basis
    problem: Diffusion
    penalty: Penalty

    def __call__(self, x: Float) -> float:
        """Return the norm of the function with coefficients ``x (n,)``."""
        u = self.basis.coefficients(x)
        inside = float(np.einsum("ci,cij,cj->", u, self._blocks, u, optimize=True))
        if self._reaction is not None:
            inside += float(np.einsum("ci,cij,cj->", u, self._reaction, u, optimize=True))
        if self._robin is not None:
            inside += self._robin.energy(u)
        if self._operators is None:
            return float(np.sqrt(inside + jumps(self.basis, x, self._data, self._kappa, self._sigma)))
        pairs = zip(self._operators, self._targets, strict=True)
        return float(np.sqrt(inside + sum(each.square(x, targets) for each, targets in pairs)))

    def with_data(self, problem: Diffusion) -> EnergyNorm:
        """Return the norm for a problem with an equal matrix, reusing all parts without data."""
        norm = EnergyNorm(self.basis, problem, self.penalty)
        vars(norm).update({name: vars(self)[name] for name in _WITHOUT_DATA if name in vars(self)})
        return norm

    def _data(self, faces: Int, points: Float) -> Float:
        mesh, held = self.basis.mesh, self.problem.dirichlet
        g = boundary_values(mesh, self._boundary.tags, held, faces, points, "dirichlet")
        return g - self._offset[mesh.face_cells[faces, 0], None]

    @cached_property
    def _operators(self) -> list[JumpOperator] | None:
        parts = self.basis, self._kappa, self._sigma
        return list(jump_operators(*parts)) if fit_in_memory(*parts) else None

    @cached_property
    def _targets(self) -> list[Float]:
        return [each.targets(self._data) for each in self._operators or ()]

    @cached_property
    def _boundary(self) -> BoundaryParts:
        return boundary_faces(self.basis.mesh, self.problem)

    @cached_property
    def _offset(self) -> Float:
        return offset_of(self.basis, self.problem)

    @cached_property
    def _kappa(self) -> Field | Tensor:
        return positive(self.basis.mesh, self.problem.kappa)

    @cached_property
    def _blocks(self) -> Float:
        return stiffness(self.basis, self._kappa)

    @cached_property
    def _reaction(self) -> Float | None:
        return reaction_blocks(self.basis, self.problem.reaction)

    @cached_property
    def _robin(self) -> RobinTerms | None:
        return robin_terms(self.basis, self.problem, self._boundary)

    @cached_property
    def _sigma(self) -> Float:
        natural = self._boundary.natural
        return jump_penalty(self.basis, self._kappa, self.penalty, natural, inside=self._blocks)


def jumps(basis: Basis, x: Float, outside: Outside, kappa: Field | Tensor, sigma: Float) -> float:
    """Return Σ_F γσ ‖[u]‖² over inner and Dirichlet faces, for coefficients ``x (n,)``."""
    operators = jump_operators(basis, kappa, sigma)
    return sum(each.square(x, each.targets(outside)) for each in operators)


def offset_of(basis: Basis, problem: Diffusion) -> Float:
    """Compute the :func:`~agglo_polydg_mg.forms.boundary.data_offset` ``(n_cells,)`` of a problem."""
    mesh, boundary = basis.mesh, boundary_faces(basis.mesh, problem)
    kappa = positive(mesh, problem.kappa)
    own = face_coefficients(mesh, kappa, boundary.dirichlet, basis.degree + 2)[:, 0]
    return data_offset(basis, problem, boundary, own)


class Errors(NamedTuple):
    """Norms of the error u − u_h.

    ``h1`` = ‖∇(u − u_h)‖ cell by cell, and ``dg`` = (‖√κ ∇(u − u_h)‖² + Σ_F γσ ‖[u − u_h]‖²)^½, including
    jumps over Dirichlet faces.
    """

    l2: float
    h1: float
    dg: float


def errors(
    basis: Basis,
    x: Float,
    problem: Diffusion,
    *,
    penalty: Penalty = PAPER,
    chosen: Mask | None = None,
) -> Errors:
    """Compute the L2, H1 and DG norms of the error of a discrete function against ``problem.exact``.

    The cells contribute :func:`~agglo_core.fields.errors.error_norms`.

    Parameters
    ----------
    basis : Basis
    x : (n,) float
    problem : Diffusion
        Its ``exact`` solution must be continuous across faces.
    penalty : float, "paper" or "sharp"
        Discretisation penalty, contained in the DG norm.
    chosen : (n_cells,) bool, optional
        Cells to include, by default all; each cell contributes half of its inner faces.

    Raises
    ------
    OptionError
        If the problem has no exact solution; see also :func:`~agglo_polydg_mg.forms.assembly.discretise`.
    """
    exact = problem.exact
    if exact is None:
        raise OptionError("this problem has no exact solution to compare with")
    # 1. Integrals over the cells
    mesh, c = basis.mesh, offset_of(basis, problem)
    remainder = x - basis.constants(c)
    cells = np.ones(mesh.n_cells, bool) if chosen is None else chosen
    norms = error_norms(mesh, problem, basis.degree, polynomials_of(basis, remainder, c), cells)

    # 2. Face jumps
    def outside(faces: Int, points: Float) -> Float:
        values = sample(exact, points.reshape(-1, mesh.dim) + mesh.origin, "exact")
        return values.reshape(points.shape[:2]) - c[mesh.face_cells[faces, 0], None]

    kappa = positive(mesh, problem.kappa)
    sigma = jump_penalty(basis, kappa, penalty, boundary_faces(mesh, problem).natural)
    sigma = sigma if chosen is None else sigma * shares_of_faces(mesh, chosen)
    squares = jumps(basis, remainder, outside, kappa, sigma)
    return Errors(norms["l2"], norms["h1"], float(np.sqrt(norms["energy"] ** 2 + squares)))


def polynomials_of(basis: Basis, x: Float, offset: Float) -> Polynomials:
    """Return the function with coefficients ``x (n,)`` plus constants ``offset (n_cells,)``."""
    coefficients = basis.coefficients(x)
    return Polynomials(basis.values, basis.gradient_coefficients, basis.mass_blocks, coefficients, offset)


def shares_of_faces(mesh: Mesh, cells: Mask) -> Float:
    """Return the fraction of each face ``(n_faces,)`` that belongs to the chosen cells."""
    sides = mesh.face_cells
    return np.asarray(np.append(cells, False)[sides].sum(axis=1) / (sides >= 0).sum(axis=1))
