"""Residuals of a discrete solution: in the cells, and of its fluxes and values on faces.

The weights are those of the interior penalty analysis on polytopes (A. Cangiani, Z. Dong, E. Georgoulis,
SIAM J. Numer. Anal. 61, 2023), with the cell diameter h on all faces of a cell, however short they are, and
with the smaller of h/(πp√κ) and 1/√c where there is a reaction (R. Verfürth, Numer. Math. 78, 1998).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from agglo_core.authoring import Diffusion, Float, Int, Mesh, frozen_float
from agglo_core.fields.coefficients import is_zero, nonnegative
from agglo_core.fields.rules import Batch, inside
from agglo_core.fields.tensors import Tensor
from agglo_core.fields.values import per_cell, sample
from agglo_polydg_mg.forms.assembly import jump_penalty
from agglo_polydg_mg.forms.boundary import boundary_faces
from agglo_polydg_mg.forms.convection import normal_speed, velocity
from agglo_polydg_mg.forms.fluxes import State, Traces, natural_fluxes, traces_on_faces
from agglo_polydg_mg.forms.penalty import Penalty
from agglo_polydg_mg.space.basis import Basis

_MORE: Final = 2
"""Degrees of the quadrature above twice that of the solution, for data that are no polynomials."""

Values = Callable[[Float, Int], Float]
"""A coefficient as a function of points ``(q, d)`` in user coordinates and their cells ``(q,)``."""


def squared_residuals(basis: Basis, x: Float, problem: Diffusion, penalty: Penalty) -> Mapping[str, Float]:
    """Return the weighted squares of all residuals of a solution, by kind and cell ``(n_cells,)``.

    - ``cell``: the residual f + ∇·(κ∇u) − b·∇u − cu, and the part of κ∇u that is no polynomial;
    - ``flux``: jumps of κ∇u·n between cells, and its gaps to Neumann and Robin data;
    - ``jump``: γσ[u]², as in the DG norm, with u − g on Dirichlet faces;
    - ``oscillation``: the share of ``cell`` that no polynomial of the degree of u represents.
    """
    state = State.of(basis, x, problem)
    smallest, reach = _scales(state)
    cell, oscillation = _in_cells(state, smallest, reach)
    flux, jump = _on_faces(state, penalty, reach)
    squares = {"cell": cell, "flux": flux, "jump": jump, "oscillation": oscillation}
    return {name: frozen_float(values) for name, values in squares.items()}


def _scales(state: State) -> tuple[Float, Float]:
    """Return per cell the smallest eigenvalue of κ at quadrature points, and the length of the weights.

    The length is h/(πp), or √(κ/c) where that is smaller.
    """
    mesh, degree = state.basis.mesh, state.basis.degree
    kappa, reaction = _tensor_values(state), _values(state.problem.reaction, mesh, "reaction")
    smallest, least_reaction = np.empty(mesh.n_cells), np.zeros(mesh.n_cells)
    for batch in inside(mesh, 2 * degree):
        cells, points, first = batch.cells, batch.points + mesh.origin, batch.offsets[:-1]
        part = slice(batch.first, batch.first + len(first))
        values = kappa(points, cells)
        least = values if values.ndim == 1 else np.linalg.eigvalsh(values)[:, 0]
        smallest[part] = np.minimum.reduceat(least, first)
        if reaction is not None:
            least_reaction[part] = np.minimum.reduceat(reaction(points, cells), first)
    reach = mesh.cell_diameters / (np.pi * degree)
    held = least_reaction > 0
    reach[held] = np.minimum(reach[held], np.sqrt(smallest[held] / least_reaction[held]))
    return smallest, reach


def _in_cells(state: State, smallest: Float, reach: Float) -> tuple[Float, Float]:
    """Return the weighted squares of the cell residuals and of their oscillation, both ``(n_cells,)``."""
    basis, mesh, problem = state.basis, state.basis.mesh, state.problem
    kappa = _tensor_values(state)
    source = _values(problem.source, mesh, "source")
    reaction, speed = _values(problem.reaction, mesh, "reaction"), velocity(mesh, problem.convection)
    squares, oscillation = np.zeros(mesh.n_cells), np.zeros(mesh.n_cells)
    for batch in inside(mesh, 2 * basis.degree + _MORE):
        cells, points = batch.cells, batch.points + mesh.origin
        part = slice(batch.first, batch.first + len(batch.offsets) - 1)
        tests, gradients = basis.values(cells, batch.points), basis.gradients(cells, batch.points)
        u = state.coefficients[cells]
        slopes = np.einsum("qdk,qk->qd", gradients, u)
        # 1. Divergence of the flux, by its projection onto polynomials
        values = kappa(points, cells)
        flux = values[:, None] * slopes if values.ndim == 1 else np.einsum("qij,qj->qi", values, slopes)
        projected = _projection(basis, batch, part, tests, flux)
        residual = np.einsum("qdk,qkd->q", gradients, projected[cells - batch.first])
        missing = flux - np.einsum("qk,qkd->qd", tests, projected[cells - batch.first])
        # 2. Residual
        if source is not None:
            residual += source(points, cells)
        if speed is not None:
            b = speed(points) if callable(speed) else speed[cells]
            residual -= (b * slopes).sum(axis=1)
        if reaction is not None:
            values = np.einsum("qk,qk->q", tests, u) + state.offset[cells]
            residual -= reaction(points, cells) * values
        # 3. Squares of the residual, and of its distance to polynomials
        coefficients = _projection(basis, batch, part, tests, residual[:, None])[cells - batch.first, :, 0]
        rest = residual - np.einsum("qk,qk->q", tests, coefficients)
        weight = reach[part] ** 2 / smallest[part]
        beyond = _sum(batch, (missing**2).sum(axis=1)) / smallest[part]
        squares[part] = weight * _sum(batch, residual**2) + beyond
        oscillation[part] = weight * _sum(batch, rest**2) + beyond
    return np.maximum(squares, 0.0), np.clip(oscillation, 0.0, np.maximum(squares, 0.0))


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


def _projection(basis: Basis, batch: Batch, part: slice, tests: Float, values: Float) -> Float:
    """Return the coefficients ``(n, n_local, m)`` of the L2 projections of ``values (q, m)``."""
    products = batch.weights[:, None, None] * tests[:, :, None] * values[:, None, :]
    sums = np.add.reduceat(products, batch.offsets[:-1], axis=0)
    return frozen_float(np.linalg.solve(basis.mass_blocks[part], sums))


def _sum(batch: Batch, values: Float) -> Float:
    """Integrate ``values (q,)`` over each cell of a batch."""
    return np.asarray(np.add.reduceat(batch.weights * values, batch.offsets[:-1]))


def _tensor_values(state: State) -> Values:
    """Return κ as a function with values ``(q,)``, or ``(q, d, d)`` for a tensor."""
    kappa = state.kappa
    if isinstance(kappa, Tensor):
        return kappa.at
    found = _values(kappa, state.basis.mesh, "kappa")
    assert found is not None  # κ is positive
    return found


def _values(field: Any, mesh: Mesh, name: str) -> Values | None:
    """Return a number, cell values or a callable as a function of points and cells, None for 0."""
    if is_zero(field):
        return None
    field = nonnegative(mesh, field) if name == "reaction" else field
    if callable(field):
        return lambda points, cells: sample(field, points, name)
    values = per_cell(field, mesh.n_cells, name)
    return lambda points, cells: values[cells]
