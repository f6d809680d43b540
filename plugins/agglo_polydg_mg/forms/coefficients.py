"""Coefficients of the elliptic problem: checked values, cell means, and the mass term of the reaction."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Field, Float, Mesh, frozen_float
from agglo_core.fields.coefficients import is_zero, nonnegative
from agglo_core.fields.tensors import Tensor, is_tensor, tensor
from agglo_core.fields.values import per_cell
from agglo_polydg_mg.space.basis import Basis
from agglo_polydg_mg.space.quadrature import weighted_moments


def cell_means(mesh: Mesh, field: Field | Tensor, name: str = "kappa") -> Float:
    """Return the mean of a coefficient over each cell ``(n_cells,)``, for a tensor of its trace / d."""
    if not isinstance(field, Tensor) and is_tensor(field, mesh):
        field = tensor(mesh, field)
    if isinstance(field, Tensor):
        given, dim = field, mesh.dim
        if given.by_cell:
            return frozen_float(np.trace(given.field, axis1=1, axis2=2) / dim)
        return cell_means(mesh, lambda x: np.trace(given.at(x, None), axis1=1, axis2=2) / dim, name)
    if not callable(field):
        return per_cell(field, mesh.n_cells, name)
    unit = [0.0, 0.0, 1.0, 1.0, 1.0, 0.0] if mesh.dim == 2 else [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    boxes = np.tile(unit, (mesh.n_cells, 1))
    integrals = weighted_moments(mesh, field, boxes, 0, name)[:, 0]
    return frozen_float(2.0 ** (0.5 * mesh.dim) * integrals / mesh.cell_measures)  # L₀ = √½


def cell_tensors(mesh: Mesh, kappa: Field | Tensor) -> Float | None:
    """Return a tensor coefficient at the cell centroids ``(n_cells, d, d)``, or None for a scalar."""
    if not isinstance(kappa, Tensor):
        if not is_tensor(kappa, mesh):
            return None
        kappa = tensor(mesh, kappa)
    return frozen_float(kappa.at(mesh.cell_centroids, np.arange(mesh.n_cells)))


def reaction_blocks(basis: Basis, reaction: Field) -> Float | None:
    """Return the mass matrix ∫ c φ_i φ_j per cell ``(n_cells, n_local, n_local)``, or None for c = 0.

    Raises
    ------
    OptionError
        For a negative value, with its cell or point.
    """
    if is_zero(reaction):
        return None
    values = nonnegative(basis.mesh, reaction)
    if not callable(values):
        return frozen_float(basis.mass_blocks * np.asarray(values)[:, None, None])
    return basis.weighted_mass(values, "reaction")
