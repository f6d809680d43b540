"""Residuals of a discrete solution: in the cells, and of its fluxes and values on faces.

The weights are those of the interior penalty analysis on polytopes (A. Cangiani, Z. Dong, E. Georgoulis,
SIAM J. Numer. Anal. 61, 2023), with the cell diameter h on all faces of a cell, however short they are, and
with the smaller of h/(πp√κ) and 1/√c where there is a reaction (R. Verfürth, Numer. Math. 78, 1998).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from agglo_core.authoring import Diffusion, Field, Float, Int, Mesh, frozen_float, frozen_int
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
    smallest = _smallest(mesh, 2 * degree, kappa, varies=_varies(state.kappa))
    least_reaction = np.zeros(mesh.n_cells)
    if reaction is not None:
        least_reaction = _smallest(mesh, 2 * degree, reaction, varies=callable(state.problem.reaction))
    reach = mesh.cell_diameters / (np.pi * degree)
    held = least_reaction > 0
    reach[held] = np.minimum(reach[held], np.sqrt(smallest[held] / least_reaction[held]))
    return smallest, reach


def _smallest(mesh: Mesh, degree: int, values: Values, varies: bool) -> Float:
    """Return the smallest value or eigenvalue per cell ``(n_cells,)``, at quadrature points if it varies."""

    def least(points: Float, cells: Int) -> Float:
        found = values(points, cells)
        return np.asarray(found if found.ndim == 1 else np.linalg.eigvalsh(found)[:, 0], float)

    if not varies:
        return np.array(least(mesh.cell_centroids, frozen_int(np.arange(mesh.n_cells))))
    batches = inside(mesh, degree)
    return np.concatenate(
        [np.minimum.reduceat(least(b.points + mesh.origin, b.cells), b.offsets[:-1]) for b in batches]
    )


def _fluxes(state: State, smallest: Float) -> tuple[Float, Float]:
    """Project κ∇u: coefficients ``(n_cells, d, n_local)``, and ‖κ∇u − Πκ∇u‖² / κ ``(n_cells,)``."""
    basis, mesh, kappa = state.basis, state.basis.mesh, _tensor_values(state)
    if not _varies(state.kappa):
        values = kappa(mesh.cell_centroids, frozen_int(np.arange(mesh.n_cells)))
        product = "c,cdk->cdk" if values.ndim == 1 else "cde,cek->cdk"
        return np.einsum(product, values, state.slopes), np.zeros(mesh.n_cells)
    projected, beyond = np.empty_like(state.slopes), np.empty(mesh.n_cells)
    for batch in inside(mesh, 2 * basis.degree + _MORE):
        cells, part = batch.cells, slice(batch.first, batch.first + len(batch.offsets) - 1)
        tests, values = basis.values(cells, batch.points), kappa(batch.points + mesh.origin, cells)
        slopes = np.einsum("qk,qdk->qd", tests, state.slopes[cells])
        flux = values[:, None] * slopes if values.ndim == 1 else np.einsum("qij,qj->qi", values, slopes)
        projected[part] = _projection(basis, batch, part, tests, flux)
        missing = flux - np.einsum("qk,qdk->qd", tests, projected[cells])
        beyond[part] = _sum(batch, (missing**2).sum(axis=1)) / smallest[part]
    return projected, beyond


def _in_cells(state: State, smallest: Float, reach: Float) -> tuple[Float, Float]:
    """Return the weighted squares of the cell residuals and of their oscillation, both ``(n_cells,)``."""
    basis, mesh, problem = state.basis, state.basis.mesh, state.problem
    source = _values(problem.source, mesh, "source")
    reaction, speed = _values(problem.reaction, mesh, "reaction"), velocity(mesh, problem.convection)
    projected, beyond = _fluxes(state, smallest)
    divergence = np.einsum("cddk->ck", basis.gradient_coefficients(projected))
    squares, oscillation = np.zeros(mesh.n_cells), np.zeros(mesh.n_cells)
    for batch in inside(mesh, 2 * basis.degree + _MORE):
        cells, points = batch.cells, batch.points + mesh.origin
        part = slice(batch.first, batch.first + len(batch.offsets) - 1)
        tests = basis.values(cells, batch.points)
        # 1. Residual
        residual = np.einsum("qk,qk->q", tests, divergence[cells])
        if source is not None:
            residual += source(points, cells)
        if speed is not None:
            b = speed(points) if callable(speed) else speed[cells]
            residual -= np.einsum("qd,qk,qdk->q", b, tests, state.slopes[cells], optimize=True)
        if reaction is not None:
            values = np.einsum("qk,qk->q", tests, state.coefficients[cells]) + state.offset[cells]
            residual -= reaction(points, cells) * values
        # 2. Squares of the residual, and of its distance to polynomials
        coefficients = _projection(basis, batch, part, tests, residual[:, None])[cells - batch.first, 0]
        rest = residual - np.einsum("qk,qk->q", tests, coefficients)
        weight = reach[part] ** 2 / smallest[part]
        squares[part] = weight * _sum(batch, residual**2) + beyond[part]
        oscillation[part] = weight * _sum(batch, rest**2) + beyond[part]
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
    """Return the coefficients ``(n, m, n_local)`` of the L2 projections of ``values (q, m)``."""
    products = (batch.weights[:, None] * values)[:, :, None] * tests[:, None, :]
    sums = np.add.reduceat(products, batch.offsets[:-1], axis=0)
    found = np.linalg.solve(basis.mass_blocks[part], np.swapaxes(sums, 1, 2))
    return frozen_float(np.swapaxes(found, 1, 2))


def _sum(batch: Batch, values: Float) -> Float:
    """Integrate ``values (q,)`` over each cell of a batch."""
    return np.asarray(np.add.reduceat(batch.weights * values, batch.offsets[:-1]))


def _varies(kappa: Field | Tensor) -> bool:
    """Return True if a coefficient may vary within cells."""
    return not kappa.by_cell if isinstance(kappa, Tensor) else callable(kappa)


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
