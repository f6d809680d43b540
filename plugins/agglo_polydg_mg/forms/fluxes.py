"""Numerical fluxes through faces: conservative, as the discretisation contains them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from agglo_core.authoring import Diffusion, Field, Float, Int, Mesh, frozen_float, frozen_int
from agglo_core.fields.boundary import boundary_values
from agglo_core.fields.coefficients import positive
from agglo_core.fields.tensors import Tensor
from agglo_polydg_mg.forms.assembly import jump_penalty
from agglo_polydg_mg.forms.boundary import boundary_faces, natural_values, robin_alpha
from agglo_polydg_mg.forms.face_quadrature import face_rule, on_both_sides, on_pieces
from agglo_polydg_mg.forms.norms import offset_of
from agglo_polydg_mg.forms.penalty import Penalty
from agglo_polydg_mg.space.basis import Basis

_FACES = 10_000  # per batch: limits the memory for gradients of the basis at quadrature points


def fluxes(basis: Basis, mesh: Mesh, x: Float, problem: Diffusion, penalty: Penalty) -> Float:
    """Return the numerical flux ∫ −κ ∂u/∂n through each face ``(n_faces,)``, outward of its first cell.

    Tested with the indicator function of a cell, the discrete problem contains −{κ∇u}·n + γσ[u] on inner
    faces, with u − g for [u] on Dirichlet faces, αu − g on Robin faces, and minus the given flux on Neumann
    faces. If x solves the system, the fluxes out of a cell therefore sum to the integral of f − c u, at the
    quadrature of the system; otherwise they differ by the residual.

    Parameters
    ----------
    basis : Basis
    mesh : Mesh
        The mesh of the basis before :func:`~agglo_polydg_mg.forms.sides.with_straight_sides`. A merged edge
        has one penalty, and its flux is divided among its edges in ``mesh``.
    x : (n,) float
    problem : Diffusion
    penalty : float, "paper" or "sharp"
        Jump penalty of the discretisation.
    """
    kappa = positive(basis.mesh, problem.kappa)
    sigma = jump_penalty(basis, kappa, penalty, boundary_faces(basis.mesh, problem).natural)
    offset = offset_of(basis, problem)
    state = _State(basis, basis.coefficients(x - basis.constants(offset)), offset, kappa, problem)
    return on_edges(basis.mesh, mesh, partial(_through_faces, state), sigma)


def on_edges(merged: Mesh, mesh: Mesh, through: Callable[[Mesh, Float], Float], sigma: Float) -> Float:
    """Return the fluxes ``(n_faces, ...)`` through the faces of a mesh, which sum to those of merged edges.

    Parameters
    ----------
    merged : Mesh
        The mesh after :func:`~agglo_polydg_mg.forms.sides.with_straight_sides`.
    mesh : Mesh
    through : callable
        Returns the integrals of the flux over all faces of a mesh, for its jump penalties.
    sigma : (n_merged_faces,) float
        Jump penalty of the merged mesh.
    """
    # 1. Fluxes through the faces that the discretisation uses
    of_sides = through(merged, sigma)
    if merged is mesh:
        return frozen_float(of_sides)
    # 2. Fluxes through the edges of merged edges, corrected so that quadrature errors do not alter the sum
    assert merged.simplification is not None
    side = merged.simplification.faces
    values = through(mesh, frozen_float(sigma[side]))
    sign = np.where(mesh.face_cells[:, 0] == merged.face_cells[side, 0], 1.0, -1.0)
    shares = mesh.face_measures / np.bincount(side, mesh.face_measures)[side]
    missing = of_sides.copy()
    np.subtract.at(missing, side, (sign * values.T).T)
    return frozen_float(values + (sign * shares * missing[side].T).T)


class _State(NamedTuple):
    """Function with ``coefficients (n_cells, n_local)``, added to a constant ``offset (n_cells,)``."""

    basis: Basis
    coefficients: Float
    offset: Float
    kappa: Field | Tensor
    problem: Diffusion


def _through_faces(state: _State, mesh: Mesh, sigma: Float) -> Float:
    """Integrate the flux over all faces of a mesh ``(n_faces,)``, with the jump penalty ``sigma``."""
    boundary, n = boundary_faces(mesh, state.problem), state.basis.degree + 2
    natural = np.zeros(mesh.n_faces, bool)
    natural[boundary.natural] = True
    result = np.zeros(mesh.n_faces)
    for start in range(0, mesh.n_faces, _FACES):
        # 1. Quadrature points, and on both sides n·κn and the direction of the derivative: n, or κn / n·κn
        faces = frozen_int(np.arange(start, min(start + _FACES, mesh.n_faces)))
        rule = face_rule(mesh, faces, n)
        on_faces = on_both_sides(mesh, state.kappa, faces, n)
        kappa, directions = on_pieces(on_faces.kappa, faces, rule), rule.normals[:, None, None]
        if len(on_faces.directions):
            directions = on_pieces(on_faces.directions, faces, rule)
        directions = np.broadcast_to(directions, (len(kappa), 2, *directions.shape[2:]))
        first, second = mesh.face_cells[rule.faces].T
        inner, free = np.flatnonzero(second >= 0), np.flatnonzero(natural[rule.faces])
        fixed = np.flatnonzero((second < 0) & ~natural[rule.faces])
        # 2. Normal derivatives and jumps: to the second cell, or to the Dirichlet data
        points = rule.points + (mesh.origin - state.basis.mesh.origin)
        values, slope = _traces(state, first, points, directions[:, 0])
        jump = values.copy()
        others, slopes = _traces(state, second[inner], points[inner], directions[inner, 1])
        jump[inner] -= others
        slope[inner] += slopes
        part = rule.part(frozen_int(fixed))
        g = boundary_values(
            mesh, boundary.tags, state.problem.dirichlet, part.faces, part.points, "dirichlet"
        )
        jump[fixed] -= g - state.offset[first[fixed], None]
        # 3. Weights of derivative and jump: γ/2 and γ inside, κ at the boundary
        mean = kappa[:, 0].copy()
        mean[inner] *= kappa[inner, 1] / kappa[inner].sum(axis=1)
        weight = mean.copy()
        weight[inner] *= 2.0
        flux = weight * sigma[rule.faces, None] * jump - mean * slope
        # 4. Natural faces: α u − g
        part = rule.part(frozen_int(free))
        alpha = robin_alpha(mesh, boundary, state.problem, part)
        u = values[free] + state.offset[first[free], None]
        flux[free] = alpha * u - natural_values(mesh, boundary, state.problem, part)
        result += np.bincount(rule.faces, (rule.weights * flux).sum(axis=1), mesh.n_faces)
    return result


def _traces(state: _State, cells: Int, points: Float, directions: Float) -> tuple[Float, Float]:
    """Return values and derivatives ``(t, q)`` in ``cells (t,)`` at ``points (t, q, d)``.

    ``directions`` are ``(t, 1, d)`` or ``(t, q, d)``.
    """
    count, n, dim = points.shape
    rows, flat = np.repeat(cells, n), points.reshape(-1, dim)
    own = state.coefficients[rows]
    values = np.einsum("qk,qk->q", state.basis.values(rows, flat), own)
    slopes = np.einsum("qdk,qk->qd", state.basis.gradients(rows, flat), own)
    along = (slopes.reshape(count, n, dim) * directions).sum(axis=2)
    return values.reshape(count, n), along
