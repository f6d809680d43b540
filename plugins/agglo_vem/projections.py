"""L2 projections of functions of the space on the cells."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Float, Int, OptionError, fields
from agglo_vem.local_spaces import Space
from agglo_vem.monomials import count, derivatives, monomials, products


def project(space: Space, x: Float) -> fields.Polynomials:
    """Project the function with unknowns ``x (n,)`` onto monomials in cell coordinates."""
    mesh, degree, frames, x = space.mesh, space.degree, space.frames, np.asarray(x, dtype=float)
    if x.shape != (space.n,):
        raise OptionError(f"x must have the shape ({space.n},), given {x.shape}")
    table = derivatives(degree, mesh.dim)

    def basis(cells: Int, points: Float) -> Float:
        return monomials(frames.coordinates(cells, points), degree)

    def gradient(coefficients: Float) -> Float:
        slopes = np.zeros((*coefficients.shape[:-1], *table.shape[:2]))
        local = np.einsum("amn,c...m->c...an", table, coefficients)
        slopes[..., : table.shape[2]] = np.einsum("c...an,cab->c...bn", local, frames.maps)
        return slopes

    coefficients = np.empty((mesh.n_cells, count(degree, mesh.dim)))
    for batch in space.batches():
        coefficients[batch.cells] = np.einsum("cmn,cn->cm", batch.l2, x[batch.unknowns])
    mass = space.means[:, products(degree, mesh.dim)] * mesh.cell_measures[:, None, None]
    return fields.Polynomials(basis, gradient, mass, coefficients, np.zeros(mesh.n_cells))
