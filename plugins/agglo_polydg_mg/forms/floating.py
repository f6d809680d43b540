"""Components of the domain where data determine the solution only up to a constant.

There the matrix is singular, and the solution exists only for data that balance. A positive number added to
one diagonal entry makes the matrix positive definite, and leaves the solution of a balanced system
unchanged up to the constant (``docs/mathematics.md``).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from agglo_core.authoring import Diffusion, Field, Float, Int, Mesh, OptionError, frozen_float, frozen_int
from agglo_core.fields.tensors import Tensor
from agglo_polydg_mg.forms.boundary import Boundary, natural_sizes
from agglo_polydg_mg.forms.coefficients import cell_means
from agglo_polydg_mg.space.basis import Basis

_QUADRATURE: Final = 1e-4
"""Imbalance of source and fluxes, relative to the integral of their magnitudes, that counts as quadrature
error and is corrected. A smaller value refuses balanced callables on coarse meshes."""
_log = logging.getLogger("agglo")


def floating_parts(mesh: Mesh, boundary: Boundary) -> list[Int]:
    """Return the cells of each component where the solution is determined only up to a constant."""
    if not len(boundary.floating):
        return []
    component = mesh.graph.components()
    return [frozen_int(np.flatnonzero(component == component[cell])) for cell in boundary.floating]


def hold(basis: Basis, kappa: Field | Tensor, parts: Sequence[Int], blocks: Float, places: Int) -> None:
    """Add a number to one diagonal entry of the matrix ``blocks`` for each floating component.

    The entry is that of the constant in the cell with the largest κ. For u = 1 it adds the energy κ |Ω|^(1 −
    2/d) with the mean of κ, which depends on the component alone, and not on its cells.
    """
    if not parts:
        return
    mesh, means = basis.mesh, cell_means(basis.mesh, kappa)
    ones = basis.constants(np.ones(mesh.n_cells))[:: basis.n_local]
    for cells in parts:
        cell, volumes = cells[np.argmax(means[cells])], mesh.cell_measures[cells]
        mean = means[cells] @ volumes / volumes.sum()
        blocks[places[cell], 0, 0] += mean * volumes.sum() ** (1.0 - 2.0 / mesh.dim) / ones[cell] ** 2


def balanced(
    basis: Basis, problem: Diffusion, boundary: Boundary, parts: Sequence[Int], loads: Float
) -> Float:
    """Return the loads ``(n_cells, n_local)`` with zero sum on each floating component.

    Imbalances at the level of quadrature errors are distributed as a constant source.

    Raises
    ------
    OptionError
        If source and fluxes do not balance, with their integral.
    """
    if not parts:
        return loads
    mesh, result = basis.mesh, loads.copy()
    ones = basis.constants(np.ones(mesh.n_cells))[:: basis.n_local]
    unit = basis.weighted_moments(1.0, basis.degree, "1") * basis.scale[:, None]
    source = _magnitude(problem.source)
    sizes = cell_means(mesh, source, "source") * mesh.cell_measures + natural_sizes(basis, problem, boundary)
    for cells in parts:
        imbalance, size = float(loads[cells, 0] @ ones[cells]), float(sizes[cells].sum())
        if abs(imbalance) > _QUADRATURE * size:
            raise OptionError(
                f"the component of cell {cells[0]} has no boundary face with Dirichlet data, no reaction and "
                "no Robin data with positive alpha, so the solution is determined only up to a constant "
                "there, and source and fluxes must balance; they integrate to "
                f"{imbalance:.6g}, their magnitudes to {size:.6g}: change the data, or give a Dirichlet "
                "value for one of its boundary tags"
            )
        if abs(imbalance) > 1e-12 * size:
            _log.info("source and fluxes are balanced up to %.1e, which is corrected", abs(imbalance) / size)
        result[cells] -= imbalance / mesh.cell_measures[cells].sum() * unit[cells]
    return result


def mean_remover(basis: Basis, parts: Sequence[Int]) -> Callable[[Float], Float] | None:
    """Return a map from coefficients to those of the means on floating components, or None without any.

    The result ``(n,)`` is constant on each floating component and 0 elsewhere.
    """
    if not parts:
        return None
    mesh, unit = basis.mesh, basis.weighted_moments(1.0, basis.degree, "1") * basis.scale[:, None]

    def means(x: Float) -> Float:
        integrals, values = (unit * basis.coefficients(x)).sum(axis=1), np.zeros(mesh.n_cells)
        for cells in parts:
            values[cells] = integrals[cells].sum() / mesh.cell_measures[cells].sum()
        return basis.constants(frozen_float(values))

    return means


def _magnitude(field: Field) -> Field:
    if callable(field):
        return lambda points: np.abs(np.asarray(field(points), float))
    return frozen_float(np.abs(np.asarray(field, float)))
