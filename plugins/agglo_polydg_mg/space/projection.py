"""L2 projection of a discrete function onto another mesh with coarser and finer cells."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Float, Int, frozen_float, frozen_int
from agglo_core.fields.rules import inside
from agglo_polydg_mg.space.basis import Basis


def transfer(source: Basis, x: Float, target: Basis, pairs: Int) -> Float:
    """Return the coefficients ``(target.n,)`` of the projection of a function with coefficients ``x``.

    ``pairs (k, 2)`` are the cells of the source and the target that overlap. In each pair one cell contains
    the other. In cells that are divided, the function stays as it is if the degree of the target suffices.
    """
    load = np.zeros((target.mesh.n_cells, target.n_local))
    count = np.bincount(pairs[:, 1], minlength=target.mesh.n_cells)
    joined = count[pairs[:, 1]] > 1
    # Integrals over divided and unchanged cells on the target, over joined cells on the source
    _add(source, x, target, pairs[~joined], load, on_source=False)
    _add(source, x, target, pairs[joined], load, on_source=True)
    return frozen_float(np.linalg.solve(target.mass_blocks, load[:, :, None]).ravel())


def _add(source: Basis, x: Float, target: Basis, pairs: Int, load: Float, *, on_source: bool) -> None:
    """Add the integrals of the function times the target's polynomials, over the smaller cells of pairs."""
    if not len(pairs):
        return
    mesh = source.mesh if on_source else target.mesh
    partner = np.full(mesh.n_cells, -1)
    partner[pairs[:, 0 if on_source else 1]] = pairs[:, 1 if on_source else 0]
    coefficients = source.coefficients(x)
    for batch in inside(mesh, source.degree + target.degree):
        cells, others = batch.cells, partner[batch.cells]
        kept = others >= 0
        cells, others = frozen_int(cells[kept]), frozen_int(others[kept])
        of_source, of_target = (cells, others) if on_source else (others, cells)
        points = batch.points[kept] + mesh.origin
        values = source.values(of_source, points - source.mesh.origin)
        values = np.einsum("qk,qk->q", values, coefficients[of_source]) * batch.weights[kept]
        tests = target.values(of_target, points - target.mesh.origin)
        np.add.at(load, of_target, values[:, None] * tests)
