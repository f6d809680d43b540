"""L2 projection of a discrete function onto another mesh with coarser and finer cells."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from agglo_core.authoring import Float, Int, frozen_float
from agglo_core.fields.gauss_points import gauss
from agglo_polydg_mg.space.basis import Basis


def transfer(source: Basis, x: Float, target: Basis, pairs: Int) -> Float:
    """Return the coefficients ``(target.n,)`` of the projection of a function with coefficients ``x``.

    ``pairs (k, 2)`` are the cells of the source and the target that overlap. In each pair one cell contains
    the other. In cells that are divided, the function stays as it is. The degree of the target is at least
    that of the source.
    """
    # 1. Polynomials of the degree of the target: further coefficients are 0
    u = np.zeros((source.mesh.n_cells, target.n_local))
    u[:, : source.n_local] = source.coefficients(x)
    source = replace(source, degree=target.degree)
    # 2. Restriction to the parts of divided cells
    found = np.zeros((target.mesh.n_cells, target.n_local))
    joined = np.bincount(pairs[:, 1], minlength=len(found))[pairs[:, 1]] > 1
    old, new = pairs[~joined].T
    found[new] = np.einsum("pij,pj->pi", _changes(source, old, target, new), u[old])
    # 3. Integrals over joined cells, times the inverse mass matrix of their union
    old, new = pairs[joined].T
    moments = np.einsum("pij,pj->pi", source.mass_blocks[old], u[old])
    load = np.zeros_like(found)
    np.add.at(load, new, np.einsum("pij,pi->pj", _changes(target, new, source, old), moments))
    unions = np.unique(new)
    found[unions] = np.linalg.solve(target.mass_blocks[unions], load[unions, :, None])[:, :, 0]
    return frozen_float(found.ravel())


def _changes(source: Basis, old: Int, target: Basis, new: Int) -> Float:
    """Return the matrices ``(k, m, m)`` from coefficients in cells ``old (k,)`` to those in ``new (k,)``.

    The polynomials are equal. They are integrated over the boxes of ``new``, where the basis is orthogonal.
    """
    dim = target.mesh.dim
    at, weights = gauss(target.degree + 1)
    reference = np.array(list(product(at, repeat=dim)))
    weights = np.prod(list(product(weights, repeat=dim)), axis=1)
    tests = target.on_reference(reference.T) * weights
    points = target.from_boxes(new, reference) + (target.mesh.origin - source.mesh.origin)
    values = source.values(old, points) / target.scale[new, None, None]
    return np.asarray(np.einsum("iq,pqj->pij", tests, values, optimize=True))
