"""Coefficients of the elliptic problem: checked values, cell means, and the mass term of the reaction."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Field, Float, Mesh, OptionError, frozen_float
from agglo_polydg_mg.space.basis import Basis
from agglo_polydg_mg.space.quadrature import per_cell, sample, weighted_moments
from agglo_polydg_mg.space.tensors import Tensor, is_tensor, tensor


def positive(mesh: Mesh, kappa: Field) -> Field | Tensor:
    """Check that κ is positive: return cell values ``(n_cells,)``, or a callable that checks its values.

    A tensor is returned as :class:`~agglo_polydg_mg.space.tensors.Tensor`.
    """
    if is_tensor(kappa, mesh):
        return tensor(mesh, kappa)
    return _checked(mesh, kappa, "kappa", zero=False)


def nonnegative(mesh: Mesh, reaction: Field) -> Field:
    """Check that the reaction is not negative, and return it as :func:`positive` does."""
    return _checked(mesh, reaction, "reaction", zero=True)


def _checked(mesh: Mesh, field: Field, name: str, *, zero: bool) -> Field:
    """Return cell values ``(n_cells,)`` or a callable of checked values, 0 only if ``zero``."""
    required = "must not be negative" if zero else "must be positive"

    def worst_of(values: Float) -> int | None:
        worst = int(np.argmin(values))
        return worst if values[worst] < 0 or (values[worst] == 0 and not zero) else None

    if callable(field):

        def checked(points: Float) -> Float:
            values = sample(field, points, name)
            worst = worst_of(values)
            if worst is not None:
                raise OptionError(f"{name} {required}: it is {values[worst]} at {points[worst].tolist()}")
            return values

        return checked
    values = per_cell(field, mesh.n_cells, name)
    worst = worst_of(values)
    if worst is not None:
        raise OptionError(f"{name} {required}: it is {values[worst]} in cell {worst}")
    return values


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


def is_zero(field: Field) -> bool:
    """Return True for data that are 0 without evaluation: a number or an array."""
    return not callable(field) and not np.any(field)


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
