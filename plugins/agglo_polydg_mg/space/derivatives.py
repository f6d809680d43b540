"""Derivatives of the basis functions as polynomials in each cell, and means over cells."""

from __future__ import annotations

from functools import cache

import numpy as np

from agglo_core.authoring import Float, frozen_float
from agglo_core.fields.gauss_points import gauss
from agglo_polydg_mg.space.basis import Basis
from agglo_polydg_mg.space.polynomials import legendre, orders, slopes


@cache
def _derivatives(degree: int, dim: int) -> Float:
    """Return the derivatives D ``(d, m, m)`` in box coordinates.

    ∂φ_k / ∂x̂_a = Σ_l D[a, l, k] φ_l.
    """
    nodes, weights = gauss(degree + 1)
    values = legendre(nodes, degree)
    line = np.einsum("iq,kq,q->ik", values, slopes(values), weights)
    powers = orders(degree, dim)
    tables = [
        np.prod(
            [
                (line if axis == other else np.eye(degree + 1))[
                    powers[:, None, other], powers[None, :, other]
                ]
                for other in range(dim)
            ],
            axis=0,
        )
        for axis in range(dim)
    ]
    return frozen_float(tables)


def directions(basis: Basis) -> Float:
    """Return the matrices R ``(n_cells, d, d)`` with ∂/∂x_i = Σ_a R[i, a] ∂/∂x̂_a in box coordinates."""
    scaled = 1.0 / basis.halves
    if basis.mesh.dim == 3:
        return np.asarray(scaled[:, :, None] * np.eye(3))
    c, s = basis.boxes[:, 4:].T
    turned = np.stack((np.stack((c, -s), axis=1), np.stack((s, c), axis=1)), axis=1)
    return np.asarray(turned * scaled[:, None, :])


def derivatives(basis: Basis) -> Float:
    """Return the derivatives E ``(n_cells, d, m, m)`` of the basis functions.

    ∂φ_k / ∂x_i = Σ_l E[i, l, k] φ_l in each cell.
    """
    E = np.einsum("cia,alk->cilk", directions(basis), _derivatives(basis.degree, basis.mesh.dim))
    return np.asarray(E)


def cell_integrals(basis: Basis, x: Float) -> Float:
    """Integrate functions with coefficients ``x (n,)`` or ``(n_cells, ..., n_local)`` over each cell."""
    one = basis.constants(np.ones(basis.mesh.n_cells)).reshape(-1, basis.n_local)[:, 0]
    moments = one[:, None] * basis.mass_blocks[:, 0]
    return frozen_float(np.einsum("ck,c...k->c...", moments, basis.coefficients(x)))


def mean_gradients(basis: Basis, x: Float) -> Float:
    """Return the means of gradients over each cell ``(n_cells, ..., d)``, for ``x`` as in integrals."""
    slopes = np.einsum("cilk,c...k->c...il", derivatives(basis), basis.coefficients(x))
    measures = basis.mesh.cell_measures.reshape(-1, *(1,) * (slopes.ndim - 2))
    return frozen_float(cell_integrals(basis, slopes) / measures)
