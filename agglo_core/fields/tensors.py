"""Symmetric positive definite tensors K as coefficients: constant, by cell, or a callable of points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.errors import AggloError, OptionError
from agglo_core.fields.values import sample
from agglo_core.mesh import Mesh

_SYMMETRIC: Final = 1e-12
"""Difference of mirrored entries, relative to the largest entry, that counts as rounding."""


@dataclass(frozen=True, eq=False)
class Tensor:
    """Tensor coefficient on a mesh.

    Attributes
    ----------
    mesh : Mesh
    field : (n_cells, d, d) float, or callable
        The values, or a function of points ``(q, d)`` with values ``(q, d, d)`` or ``(d, d)``. Values of a
        callable are checked whenever it is called.
    """

    mesh: Mesh
    field: Any

    @property
    def by_cell(self) -> bool:
        """True if the tensor is constant in each cell."""
        return not callable(self.field)

    def at(self, points: Any, cells: Any) -> Float:
        """Return the values ``(q, d, d)`` at points ``(q, d)`` in user coordinates, in ``cells (q,)``.

        If they are constant in each cell, ``points`` may be None, otherwise ``cells``.
        """
        if self.by_cell:
            return np.asarray(self.field[cells])
        dim = self.mesh.dim
        values = sample(self.field, points, "kappa", (dim, dim))
        worst = _worst(values)
        if worst is not None:
            raise OptionError(f"{_refusal(values[worst])} at {points[worst].tolist()}")
        return values


def is_tensor(kappa: Any, mesh: Mesh) -> bool:
    """Return True if κ is a tensor: an array with two axes or more, or a callable of tensors."""
    if not callable(kappa):
        return np.ndim(kappa) >= 2
    try:
        return np.ndim(kappa(mesh.cell_centroids[:1])) >= 2
    except AggloError:
        raise
    except Exception:  # the evaluation at quadrature points raises the error with its name
        return False


def tensor(mesh: Mesh, kappa: Any) -> Tensor:
    """Return a checked tensor coefficient.

    Raises
    ------
    OptionError
        For another shape, or values that are not symmetric and positive definite, with cell and value.
    """
    if callable(kappa):
        return Tensor(mesh, kappa)
    shape = mesh.dim, mesh.dim
    values = frozen_float(kappa)
    if values.shape not in (shape, (mesh.n_cells, *shape)):
        raise OptionError(
            f"kappa has shape {values.shape}: expected a number, ({mesh.n_cells},) values, {shape} or "
            f"{(mesh.n_cells, *shape)} values or a callable"
        )
    values = np.broadcast_to(values, (mesh.n_cells, *shape))
    worst = _worst(values)
    if worst is not None:
        raise OptionError(f"{_refusal(values[worst])} in cell {worst}")
    return Tensor(mesh, frozen_float(values))


def _worst(values: Float) -> int | None:
    """Return the first matrix ``(q, d, d)`` that is not symmetric positive definite, or None."""
    largest = np.abs(values).max(axis=(1, 2), initial=0.0)
    gaps = np.abs(values - values.transpose(0, 2, 1)).max(axis=(1, 2), initial=0.0)
    with np.errstate(invalid="ignore"):
        minors = [np.linalg.det(values[:, :k, :k]) for k in range(1, values.shape[1] + 1)]
        ok = np.isfinite(largest) & (gaps <= _SYMMETRIC * largest) & (np.array(minors) > 0).all(axis=0)
    bad = np.flatnonzero(~ok)
    return int(bad[0]) if len(bad) else None


def _refusal(value: Float) -> str:
    if not np.isfinite(value).all():
        return f"kappa is {value.tolist()}, not finite,"
    if np.abs(value - value.T).max() > _SYMMETRIC * np.abs(value).max():
        return f"kappa must be symmetric: it is {value.tolist()}"
    least = np.linalg.eigvalsh(value)[0]
    return f"kappa must be positive definite: it is {value.tolist()}, with the eigenvalue {least:g},"
