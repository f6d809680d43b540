"""Coefficients of the elliptic problem with checked values."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float
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


def is_zero(field: Field) -> bool:
    """Return True for data that are 0 without evaluation: a number or an array."""
    return not callable(field) and not np.any(field)
