"""Residuals of a discrete solution: in the cells, and of its fluxes and values on faces."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from agglo_core.authoring import Diffusion, Float, fields, frozen_float
from agglo_core.fields.coefficients import velocity
from agglo_polydg_mg.forms.assembly import jump_penalty
from agglo_polydg_mg.forms.boundary import boundary_faces
from agglo_polydg_mg.forms.convection import normal_speed
from agglo_polydg_mg.forms.fluxes import State, Traces, natural_fluxes, traces_on_faces
from agglo_polydg_mg.forms.norms import polynomials_of
from agglo_polydg_mg.forms.penalty import Penalty
from agglo_polydg_mg.space.basis import Basis


def squared_residuals(
    basis: Basis, x: Float, problem: Diffusion, penalty: Penalty, inside: bool = True
) -> Mapping[str, Float]:
    """Return the weighted squares of all residuals of a solution, by kind and cell ``(n_cells,)``.

    - ``cell`` and ``oscillation``, unless ``inside`` is False:
      :class:`~agglo_core.fields.residuals.CellResiduals`;
    - ``flux``: jumps of κ∇u·n between cells, and its gaps to Neumann and Robin data;
    - ``jump``: γσ[u]², as in the DG norm, with u − g on Dirichlet faces.
    """
    state = State.of(basis, x, problem)
    squares: dict[str, Float] = {}
    if inside:
        u = polynomials_of(basis, state.coefficients, state.offset)
        cell, oscillation, reach = fields.cell_residuals(basis.mesh, problem, basis.degree, u)
        squares = {"cell": cell, "oscillation": oscillation}
    else:
        reach = fields.reach_of(basis.mesh, problem, basis.degree)
    flux, jump = _on_faces(state, penalty, reach)
    return squares | {"flux": frozen_float(flux), "jump": frozen_float(jump)}


def _on_faces(state: State, penalty: Penalty, reach: Float) -> tuple[Float, Float]:
    """Return the weighted squares of flux residuals and jumps ``(n_cells,)``, shared by both cells."""
    mesh, problem = state.basis.mesh, state.problem
    boundary, speed = boundary_faces(mesh, problem), velocity(mesh, problem.convection)
    sigma = jump_penalty(state.basis, state.kappa, penalty, boundary.natural)
    flux, jump = np.zeros(mesh.n_cells), np.zeros(mesh.n_cells)
    for traces in traces_on_faces(state, mesh, boundary):
        rule, inner, kappa = traces.rule, traces.inner, traces.kappa
        first, second = mesh.face_cells[rule.faces].T
        # 1. Gaps of the normal flux: to the neighbour, or to natural data
        gap = kappa[:, 0] * traces.slopes[:, 0]
        gap[inner] -= kappa[inner, 1] * traces.slopes[inner, 1]
        gap[traces.fixed] = 0.0
        gap[traces.free] += natural_fluxes(state, mesh, boundary, traces)
        strength = kappa[:, 0].copy()
        strength[inner] += kappa[inner, 1]
        squares = (rule.weights * gap**2 / strength).sum(axis=1)
        # 2. Jumps with their penalty, and upwind with the flow through the face
        jumps = _penalised(traces, sigma)
        if speed is not None:
            jumps = jumps + _upwind(traces, np.abs(normal_speed(mesh, speed, rule)), reach[first])
        # 3. Shares of both cells
        share = np.ones(len(first))
        share[inner] = 0.5
        for cells, chosen in ((first, slice(None)), (second, inner)):
            own = cells[chosen]
            flux += np.bincount(own, (share * squares)[chosen] * reach[own], mesh.n_cells)
            jump += np.bincount(own, (share * jumps)[chosen], mesh.n_cells)
    return np.maximum(flux, 0.0), np.maximum(jump, 0.0)


def _penalised(traces: Traces, sigma: Float) -> Float:
    """Return γσ‖[u]‖² per piece, with κσ for γσ on Dirichlet faces."""
    kappa, inner = traces.kappa, traces.inner
    weight = kappa[:, 0].copy()
    weight[inner] *= 2.0 * kappa[inner, 1] / kappa[inner].sum(axis=1)
    weights = traces.rule.weights * sigma[traces.rule.faces, None] * weight
    return np.asarray((weights * traces.jump**2).sum(axis=1))


def _upwind(traces: Traces, speed: Float, reach: Float) -> Float:
    """Return the squared jumps carried by the flow: |b·n| [u]², times |b·n| h/κ where that is below 1."""
    number = np.minimum(1.0, speed * reach[:, None] / traces.kappa.min(axis=1))
    jump = traces.jump.copy()
    jump[traces.free] = 0.0
    return np.asarray((traces.rule.weights * speed * number * jump**2).sum(axis=1))
