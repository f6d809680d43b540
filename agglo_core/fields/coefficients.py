"""Coefficients of the elliptic problem with checked values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.errors import OptionError
from agglo_core.fields.tensors import Tensor, is_tensor, tensor
from agglo_core.fields.values import per_cell, sample
from agglo_core.mesh import Mesh
from agglo_core.problems import Field


def positive(mesh: Mesh, kappa: Field) -> Field | Tensor:
    """Check that κ is positive: return cell values ``(n_cells,)``, or a callable that checks its values.

    A tensor is returned as :class:`~agglo_core.fields.tensors.Tensor`.
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
        if not len(values):
            return None
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


def velocity(mesh: Mesh, convection: Any) -> Float | Callable[[Float], Float] | None:
    """Return b as checked cell values ``(n_cells, d)`` or a callable with values ``(q, d)``, or None for 0.

    Raises
    ------
    OptionError
        For another shape, or values that are not finite, with the cell.
    """
    if callable(convection):
        return lambda points: sample(convection, points, "convection", (mesh.dim,))
    if not np.any(convection):
        return None
    values = frozen_float(convection)
    if values.shape not in ((mesh.dim,), (mesh.n_cells, mesh.dim)):
        raise OptionError(
            f"convection has shape {values.shape}: expected ({mesh.dim},), ({mesh.n_cells}, {mesh.dim}) or a "
            "callable"
        )
    values = np.broadcast_to(values, (mesh.n_cells, mesh.dim))
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        raise OptionError(f"convection is {values[bad[0]].tolist()} in cell {bad[0]}, not finite")
    return frozen_float(values)


def is_zero(field: Field) -> bool:
    """Return True for data that are 0 without evaluation: a number or an array."""
    return not callable(field) and not np.any(field)
