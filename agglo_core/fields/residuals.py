"""Residuals of discrete solutions inside the cells, with the weights of error estimates.

The weights are those of the interior penalty analysis on polytopes (A. Cangiani, Z. Dong, E. Georgoulis,
SIAM J. Numer. Anal. 61, 2023), with the cell diameter h on all faces of a cell, however short they are, and
with the smaller of h/(πp√κ) and 1/√c where there is a reaction (R. Verfürth, Numer. Math. 78, 1998).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.fields.coefficients import is_zero, nonnegative, positive, velocity
from agglo_core.fields.polynomials import Polynomials
from agglo_core.fields.rules import Batch, inside
from agglo_core.fields.tensors import Tensor
from agglo_core.fields.values import per_cell, sample
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion

_MORE: Final = 2
"""Degrees of the quadrature above twice that of the solution, for data that are no polynomials."""

Values = Callable[[Float, Int], Float]
"""A coefficient as a function of points ``(q, d)`` in user coordinates and their cells ``(q,)``."""


class CellResiduals(NamedTuple):
    """Weighted residuals of a solution inside the cells.

    Attributes
    ----------
    squares : (n_cells,) float
        Squares of the residual f + ∇·(κ∇u) − b·∇u − cu, and of the part of κ∇u that is no polynomial.
    oscillation : (n_cells,) float
        Share of ``squares`` that no polynomial of the degree of u represents.
    reach : (n_cells,) float
        Length by which squares of flux residuals are weighted: h/(πp), or √(κ/c) where that is smaller.
    """

    squares: Float
    oscillation: Float
    reach: Float


def cell_residuals(mesh: Mesh, problem: Diffusion, degree: int, u: Polynomials) -> CellResiduals:
    """Return the weighted residuals of a piecewise polynomial solution of this degree."""
    kappa = kappa_values(mesh, problem.kappa)
    source, reaction = _values(problem.source, mesh, "source"), _values(problem.reaction, mesh, "reaction")
    speed = velocity(mesh, problem.convection)
    smallest, reach = _scales(mesh, degree, problem, kappa, reaction)
    fluxes, beyond = _project_fluxes(mesh, degree, problem, kappa, u, smallest)
    divergence = np.einsum("cddk->ck", u.gradient(fluxes))
    squares, oscillation = np.zeros(mesh.n_cells), np.zeros(mesh.n_cells)
    for batch in inside(mesh, 2 * degree + _MORE):
        cells, points = batch.cells, batch.points + mesh.origin
        part = slice(batch.first, batch.first + len(batch.offsets) - 1)
        tests = u.basis(cells, batch.points)
        # 1. Residual
        residual = np.einsum("qk,qk->q", tests, divergence[cells])
        if source is not None:
            residual += source(points, cells)
        if speed is not None:
            b = speed(points) if callable(speed) else speed[cells]
            residual -= np.einsum("qd,qk,qdk->q", b, tests, u.slopes[cells], optimize=True)
        if reaction is not None:
            values = np.einsum("qk,qk->q", tests, u.coefficients[cells]) + u.offset[cells]
            residual -= reaction(points, cells) * values
        # 2. Squares of the residual, and of its distance to polynomials
        coefficients = _projection(batch, u.mass[part], tests, residual[:, None])[cells - batch.first, 0]
        rest = residual - np.einsum("qk,qk->q", tests, coefficients)
        weight = reach[part] ** 2 / smallest[part]
        squares[part] = weight * _sum(batch, residual**2) + beyond[part]
        oscillation[part] = weight * _sum(batch, rest**2) + beyond[part]
    squares = np.maximum(squares, 0.0)
    found = squares, np.clip(oscillation, 0.0, squares), reach
    return CellResiduals(*(frozen_float(values) for values in found))


def reach_of(mesh: Mesh, problem: Diffusion, degree: int) -> Float:
    """Return :attr:`CellResiduals.reach` alone ``(n_cells,)``."""
    kappa, reaction = kappa_values(mesh, problem.kappa), _values(problem.reaction, mesh, "reaction")
    return frozen_float(_scales(mesh, degree, problem, kappa, reaction)[1])


def _project_fluxes(
    mesh: Mesh, degree: int, problem: Diffusion, kappa: Values, u: Polynomials, smallest: Float
) -> tuple[Float, Float]:
    """Project κ∇u: coefficients ``(n_cells, d, m)``, and ‖κ∇u − Πκ∇u‖² / κ ``(n_cells,)``."""
    if not _varies(mesh, problem.kappa):
        values = kappa(mesh.cell_centroids, frozen_int(np.arange(mesh.n_cells)))
        product = "c,cdk->cdk" if values.ndim == 1 else "cde,cek->cdk"
        return np.einsum(product, values, u.slopes), np.zeros(mesh.n_cells)
    projected, beyond = np.empty_like(u.slopes), np.empty(mesh.n_cells)
    for batch in inside(mesh, 2 * degree + _MORE):
        cells, part = batch.cells, slice(batch.first, batch.first + len(batch.offsets) - 1)
        tests = u.basis(cells, batch.points)
        values = kappa(batch.points + mesh.origin, cells)
        flux = times(values, np.einsum("qk,qdk->qd", tests, u.slopes[cells]))
        projected[part] = _projection(batch, u.mass[part], tests, flux)
        missing = flux - np.einsum("qk,qdk->qd", tests, projected[cells])
        beyond[part] = _sum(batch, (missing**2).sum(axis=1)) / smallest[part]
    return projected, beyond


def kappa_values(mesh: Mesh, kappa: Any) -> Values:
    """Return κ as a function of points and cells, with values ``(q,)``, or ``(q, d, d)`` for a tensor."""
    field = positive(mesh, kappa)
    if isinstance(field, Tensor):
        return field.at
    found = _values(field, mesh, "kappa")
    assert found is not None  # κ is positive
    return found


def _varies(mesh: Mesh, kappa: Any) -> bool:
    """Return True if κ may vary within cells."""
    field = positive(mesh, kappa)
    return not field.by_cell if isinstance(field, Tensor) else callable(field)


def _scales(
    mesh: Mesh, degree: int, problem: Diffusion, kappa: Values, reaction: Values | None
) -> tuple[Float, Float]:
    """Return per cell the smallest eigenvalue of κ at quadrature points, and the length of the weights."""
    smallest = _smallest(mesh, 2 * degree, kappa, _varies(mesh, problem.kappa))
    reach = mesh.cell_diameters / (np.pi * degree)
    if reaction is not None:
        least = _smallest(mesh, 2 * degree, reaction, callable(problem.reaction))
        held = least > 0
        reach[held] = np.minimum(reach[held], np.sqrt(smallest[held] / least[held]))
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


def times(kappa: Float, slopes: Float) -> Float:
    """Return the fluxes ``(q, d)`` for gradients ``(q, d)``."""
    if kappa.ndim == 1:
        return np.asarray(kappa[:, None] * slopes)
    return np.asarray(np.einsum("qij,qj->qi", kappa, slopes))


def _projection(batch: Batch, mass: Float, tests: Float, values: Float) -> Float:
    """Return the coefficients ``(n, k, m)`` of the L2 projections of ``values (q, k)``."""
    products = (batch.weights[:, None] * values)[:, :, None] * tests[:, None, :]
    sums = np.add.reduceat(products, batch.offsets[:-1], axis=0)
    return np.asarray(np.swapaxes(np.linalg.solve(mass, np.swapaxes(sums, 1, 2)), 1, 2))


def _sum(batch: Batch, values: Float) -> Float:
    """Integrate ``values (q,)`` over each cell of a batch."""
    return np.asarray(np.add.reduceat(batch.weights * values, batch.offsets[:-1]))


def _values(field: Any, mesh: Mesh, name: str) -> Values | None:
    """Return a number, cell values or a callable as a function of points and cells, None for 0."""
    if is_zero(field):
        return None
    field = nonnegative(mesh, field) if name == "reaction" else field
    if callable(field):
        return lambda points, cells: sample(field, points, name)
    values = per_cell(field, mesh.n_cells, name)
    return lambda points, cells: values[cells]
