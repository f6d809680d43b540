"""L2 projection of a discrete function onto another mesh with coarser and finer cells."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Float, Int, Mask, frozen_float, frozen_int
from agglo_core.fields.rules import inside
from agglo_polydg_mg.space.basis import Basis


def transfer(source: Basis, x: Float, target: Basis, pairs: Int) -> Float:
    """Return the coefficients ``(target.n,)`` of the projection of a function with coefficients ``x``.

    ``pairs (k, 2)`` are the cells of the source and the target that overlap. In each pair one cell contains
    the other. In cells that are divided, the function stays as it is if the degree of the target suffices.
    """
    # 1. Integrals over divided cells on the target, over joined cells on the source
    load = np.zeros((target.mesh.n_cells, target.n_local))
    divided, joined = (
        np.bincount(cells, minlength=basis.mesh.n_cells)[cells] > 1
        for cells, basis in zip(pairs.T, (source, target), strict=True)
    )
    kept = ~(divided | joined) & _equal_bases(source, target, pairs)
    _add(source, x, target, pairs[~joined & ~kept], load, on_source=False)
    _add(source, x, target, pairs[joined], load, on_source=True)
    # 2. Coefficients, with copies in unchanged cells
    found = np.linalg.solve(target.mass_blocks, load[:, :, None])[:, :, 0]
    found[pairs[kept, 1]] = source.coefficients(x)[pairs[kept, 0]] if kept.any() else 0.0
    return frozen_float(found.ravel())


def _equal_bases(source: Basis, target: Basis, pairs: Int) -> Mask:
    """Return a mask of the pairs whose cells have equal basis functions."""
    if (source.degree, source.scaled) != (target.degree, target.scaled):
        return np.zeros(len(pairs), bool)
    shift = np.zeros(source.boxes.shape[1])
    shift[: source.mesh.dim] = source.mesh.origin - target.mesh.origin
    return np.asarray((source.boxes[pairs[:, 0]] + shift == target.boxes[pairs[:, 1]]).all(axis=1))


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
