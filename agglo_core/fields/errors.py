"""Errors of discrete functions against exact solutions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final

import numpy as np

from agglo_core.arrays import Float, Mask
from agglo_core.fields.polynomials import Polynomials
from agglo_core.fields.residuals import kappa_values, times
from agglo_core.fields.rules import Batch, inside
from agglo_core.fields.values import central_differences, sample
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion

_STEP: Final = 1e-3
"""Step of the differences of the exact solution at a quadrature point, relative to the root w^(1/d) of its
weight: steps are short in thin triangles at the boundary, and rounding errors count evenly."""
_TINY: Final = 1e-16
"""Smallest of these weights, relative to the measure of the cell."""


def error_norms(
    mesh: Mesh, problem: Diffusion, degree: int, u: Polynomials, cells: Mask
) -> Mapping[str, float]:
    """Return norms of the error of a piecewise polynomial of this degree on some ``cells (n_cells,)``.

    ``l2``, ``h1`` = ‖∇e‖, and ``energy`` = ‖√κ ∇e‖; none without an exact solution.
    """
    if problem.exact is None:
        return {}
    exact, kappa, sums = problem.exact, kappa_values(mesh, problem.kappa), np.zeros(3)
    for batch in inside(mesh, 2 * degree + 6):
        own, points, found = batch.cells, batch.points + mesh.origin, u.at(batch.cells, batch.points)
        values = sample(exact, points, "exact")
        gaps, offset = values - found.values, np.abs(u.offset).max()
        excess = max(1.0, offset / (np.abs(values - u.offset[own]).max() or 1.0))
        slopes = exact_gradient(mesh, exact, batch, excess) - found.slopes
        fluxes, weights = times(kappa(points, own), slopes), batch.weights * cells[own]
        sums += weights @ gaps**2, weights @ (slopes**2).sum(axis=1), weights @ (fluxes * slopes).sum(axis=1)
    return dict(zip(("l2", "h1", "energy"), np.sqrt(sums).tolist(), strict=True))


def exact_gradient(mesh: Mesh, exact: Callable[[Float], Float], batch: Batch, excess: float = 1.0) -> Float:
    """Return the gradient ``(q, d)`` of an exact solution at quadrature points, by central differences.

    ``excess`` is the size of the values relative to their variation: rounding errors grow with it, hence the
    steps.
    """
    sizes = np.maximum(np.abs(batch.weights), _TINY * mesh.cell_measures[batch.cells])
    steps = np.repeat(_STEP * excess**0.2 * sizes[:, None] ** (1.0 / mesh.dim), mesh.dim, axis=1)
    return central_differences(partial(sample, exact, name="exact"), batch.points + mesh.origin, steps)
