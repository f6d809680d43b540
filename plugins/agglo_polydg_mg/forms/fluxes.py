"""Numerical fluxes through faces: conservative, as the discretisation contains them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from agglo_core.authoring import Diffusion, Field, Float, Int, Mesh, frozen_float, frozen_int
from agglo_core.fields.boundary import BoundaryParts, boundary_values, natural_values, robin_alpha
from agglo_core.fields.coefficients import positive, velocity
from agglo_core.fields.tensors import Tensor
from agglo_polydg_mg.forms.assembly import jump_penalty
from agglo_polydg_mg.forms.boundary import boundary_faces
from agglo_polydg_mg.forms.convection import normal_speed
from agglo_polydg_mg.forms.face_quadrature import FaceRule, face_rule, on_both_sides, on_pieces
from agglo_polydg_mg.forms.norms import offset_of
from agglo_polydg_mg.forms.penalty import Penalty
from agglo_polydg_mg.space.basis import Basis

_FACES = 10_000  # per batch: limits the memory for gradients of the basis at quadrature points


def fluxes(basis: Basis, mesh: Mesh, x: Float, problem: Diffusion, penalty: Penalty) -> Float:
    """Return the numerical flux ∫ −κ ∂u/∂n + (b·n) u through each face ``(n_faces,)``, out of its first cell.

    Tested with the indicator function of a cell, the discrete problem contains −{κ∇u}·n + γσ[u] on inner
    faces, with u − g for [u] on Dirichlet faces, αu − g on Robin faces, and minus the given flux on Neumann
    faces. Convection adds (b·n) times the upwind value: that of the cell upstream, or g where b enters
    through a Dirichlet face. If x solves the system, the fluxes out of a cell therefore sum to the integral
    of f − c u + u div b, at the quadrature of the system; otherwise they differ by the residual.

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
    state = State.of(basis, x, problem)
    sigma = jump_penalty(basis, state.kappa, penalty, boundary_faces(basis.mesh, problem).natural)
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


class State(NamedTuple):
    """Function with ``coefficients (n_cells, n_local)``, added to a constant ``offset (n_cells,)``.

    ``slopes (n_cells, d, n_local)`` are the coefficients of its gradient.
    """

    basis: Basis
    coefficients: Float
    slopes: Float
    offset: Float
    kappa: Field | Tensor
    problem: Diffusion

    @classmethod
    def of(cls, basis: Basis, x: Float, problem: Diffusion) -> State:
        """Return the function with coefficients ``x (n,)``, apart from the offset of the data."""
        offset = offset_of(basis, problem)
        coefficients = basis.coefficients(x - basis.constants(offset))
        slopes, kappa = basis.gradient_coefficients(coefficients), positive(basis.mesh, problem.kappa)
        return cls(basis, coefficients, slopes, offset, kappa, problem)


class Traces(NamedTuple):
    """Traces of a function at the quadrature points of some faces.

    Attributes
    ----------
    rule : FaceRule
    kappa : (t, 2, q) float
        n·κn on both sides, with the inner value twice at the boundary.
    values : (t, q) float
        The function in the first cell, without its constant offset.
    slopes : (t, 2, q) float
        Derivatives on both sides along κn / (n·κn), with n outward from the first cell; 0 outside.
    jump : (t, q) float
        First minus second value, or value minus Dirichlet data; the value itself on natural faces.
    inner, fixed, free : (k,) int
        Pieces between cells, with Dirichlet data, and with natural data.
    """

    rule: FaceRule
    kappa: Float
    values: Float
    slopes: Float
    jump: Float
    inner: Int
    fixed: Int
    free: Int


def _through_faces(state: State, mesh: Mesh, sigma: Float) -> Float:
    """Integrate the flux over all faces of a mesh ``(n_faces,)``, with the jump penalty ``sigma``."""
    boundary, result = boundary_faces(mesh, state.problem), np.zeros(mesh.n_faces)
    b = velocity(mesh, state.problem.convection)
    for traces in traces_on_faces(state, mesh, boundary):
        rule, kappa, inner = traces.rule, traces.kappa, traces.inner
        # 1. Weights of derivative and jump: γ/2 and γ inside, κ at the boundary
        mean = kappa[:, 0].copy()
        mean[inner] *= kappa[inner, 1] / kappa[inner].sum(axis=1)
        weight = mean.copy()
        weight[inner] *= 2.0
        flux = weight * sigma[rule.faces, None] * traces.jump - mean * traces.slopes.sum(axis=1)
        # 2. Natural faces: α u − g
        flux[traces.free] = natural_fluxes(state, mesh, boundary, traces)
        # 3. Convection of the value upstream; where data are natural, of the inner value
        if b is not None:
            speed = normal_speed(mesh, b, rule)
            step = np.where(speed < 0.0, traces.jump, 0.0)
            step[traces.free] = 0.0
            offset = state.offset[mesh.face_cells[rule.faces, 0], None]
            flux += speed * (traces.values + offset - step)
        result += np.bincount(rule.faces, (rule.weights * flux).sum(axis=1), mesh.n_faces)
    return result


def traces_on_faces(state: State, mesh: Mesh, boundary: BoundaryParts) -> Iterator[Traces]:
    """Yield the traces on all faces of a mesh, in batches of faces."""
    natural = np.zeros(mesh.n_faces, bool)
    natural[boundary.natural] = True
    for start in range(0, mesh.n_faces, _FACES):
        # 1. Quadrature points, and on both sides n·κn and the direction of the derivative: n, or κn / n·κn
        faces = frozen_int(np.arange(start, min(start + _FACES, mesh.n_faces)))
        n = state.basis.degree + 2
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
        jump, slopes = values.copy(), np.stack((slope, np.zeros_like(slope)), axis=1)
        others, slopes[inner, 1] = _traces(state, second[inner], points[inner], directions[inner, 1])
        jump[inner] -= others
        part = rule.part(frozen_int(fixed))
        g = boundary_values(
            mesh, boundary.tags, state.problem.dirichlet, part.faces, part.points, "dirichlet"
        )
        jump[fixed] -= g - state.offset[first[fixed], None]
        yield Traces(rule, kappa, values, slopes, jump, *map(frozen_int, (inner, fixed, free)))


def natural_fluxes(state: State, mesh: Mesh, boundary: BoundaryParts, traces: Traces) -> Float:
    """Return α u − g ``(k, q)`` on the pieces with natural data."""
    part = traces.rule.part(traces.free)
    u = traces.values[traces.free] + state.offset[mesh.face_cells[part.faces, 0], None]
    alpha = robin_alpha(mesh, boundary.tags, state.problem, part.faces, part.points)
    return alpha * u - natural_values(mesh, boundary.tags, state.problem, part.faces, part.points)


def _traces(state: State, cells: Int, points: Float, directions: Float) -> tuple[Float, Float]:
    """Return values and derivatives ``(t, q)`` in ``cells (t,)`` at ``points (t, q, d)``.

    ``directions`` are ``(t, 1, d)`` or ``(t, q, d)``.
    """
    tests = state.basis.values(cells, points)
    slopes = np.einsum("tqk,tdk->tqd", tests, state.slopes[cells])
    values = np.einsum("tqk,tk->tq", tests, state.coefficients[cells])
    return values, (slopes * directions).sum(axis=2)
