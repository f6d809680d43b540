"""Evaluate discrete functions: at sample points in each cell for pictures, and at any points."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from agglo_core.authoring import (
    Float,
    Quadrature,
    Samples,
    frozen_float,
)
from agglo_core.fields.location import locate
from agglo_core.fields.rules import inside
from agglo_core.fields.sampling import sample_points
from agglo_polydg_mg.space.basis import Basis


def samples_of(basis: Basis, x: Float) -> Samples:
    """Sample a function at points in every cell, for pictures, with ``x`` as of :meth:`.Basis.evaluate`.

    The points are those of :func:`~agglo_core.fields.sample_points`.

    Raises
    ------
    OptionError
        If the length of x does not match the space.
    """
    cells, points, simplices = sample_points(basis.mesh, basis.degree)
    centres = points[simplices].mean(axis=1)
    slopes = basis.gradient(x, cells[simplices[:, 0]], centres)
    return Samples(cells, points, simplices, basis.evaluate(x, cells, points), slopes)


def evaluate(basis: Basis, x: Float, points: ArrayLike) -> Float:
    """Evaluate a function at ``points (q, d)``, with ``x`` as of :meth:`.Basis.evaluate`.

    Returns values ``(q, ...)``, NaN outside. On a face, where the function has two values, the cell with the
    lower number counts.

    Raises
    ------
    OptionError
        For points with another shape.
    """
    points = np.asarray(points, dtype=float)
    cells = locate(basis.mesh, points)
    found = cells >= 0
    values = np.full((len(points), *basis.coefficients(x).shape[1:-1]), np.nan)
    values[found] = basis.evaluate(x, cells[found], points[found])
    return values


def quadrature(basis: Basis) -> Quadrature:
    """Return a quadrature rule on all cells, exact up to twice the degree, with basis values."""
    batches = list(inside(basis.mesh, 2 * basis.degree))
    points, weights = (np.concatenate([batch[k] for batch in batches]) for k in (2, 3))
    cells = np.concatenate([batch.cells for batch in batches])
    values = np.concatenate([basis.values(batch.cells, batch.points) for batch in batches])
    columns = cells[:, None] * basis.n_local + np.arange(basis.n_local)
    ends = np.arange(len(cells) + 1) * basis.n_local
    at_points = sparse.csr_array((values.ravel(), columns.ravel(), ends), shape=(len(cells), basis.n))
    return Quadrature(frozen_float(points + basis.mesh.origin), frozen_float(weights), at_points)


def gradient(basis: Basis, x: Float, points: ArrayLike | None) -> Float:
    """Evaluate the gradient of a function at ``points (q, d)``, in the cells that :func:`evaluate` uses.

    Returns gradients ``(q, ..., d)``, NaN outside; without points the means over the cells.

    Raises
    ------
    OptionError
        For points with another shape.
    """
    if points is None:
        integrals = cell_integrals(basis, basis.gradient_coefficients(x))
        return frozen_float(integrals / basis.mesh.cell_measures.reshape(-1, *(1,) * (integrals.ndim - 1)))
    points = np.asarray(points, dtype=float)
    cells = locate(basis.mesh, points)
    found = cells >= 0
    slopes = np.full((len(points), *basis.coefficients(x).shape[1:-1], basis.mesh.dim), np.nan)
    slopes[found] = basis.gradient(x, cells[found], points[found])
    return slopes


def cell_integrals(basis: Basis, x: Float) -> Float:
    """Integrate functions over each cell, with ``x`` as of :meth:`.Basis.evaluate`."""
    one = basis.constants(np.ones(basis.mesh.n_cells)).reshape(-1, basis.n_local)[:, 0]
    moments = one[:, None] * basis.mass_blocks[:, 0]
    return frozen_float(np.einsum("ck,c...k->c...", moments, basis.coefficients(x)))
