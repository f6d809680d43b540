"""Jump penalty of elasticity that keeps the bilinear form provably coercive, cell by cell.

The argument is in ``docs/mathematics.md``: the components of C^½ ε(v) are polynomials of degree p − 1, and
the tractions on all faces of a cell are bounded together, by the largest eigenvalue of one matrix.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from agglo_core.authoring import Float, Int, Mask, MeshError, frozen_float
from agglo_core.fields.rules import batches
from agglo_polydg_mg.elasticity.material import (
    FaceWeights,
    Material,
    along,
    contraction,
    face_weights,
    root_of_tensor,
)
from agglo_polydg_mg.forms.face_quadrature import FaceRule, all_faces, face_rule
from agglo_polydg_mg.forms.penalty import simplex_heights
from agglo_polydg_mg.forms.sharp_penalty import MARGIN
from agglo_polydg_mg.space.basis import Basis
from agglo_polydg_mg.space.polynomials import n_polynomials

_NUMBERS = 4_000_000  # per batch of cells: some tens of MB
_THIN = 1e-12
"""Ratio of the extreme eigenvalues of a cell's mass matrix below which rounding may spoil the trace
inequality. A smaller value trusts flatter cells."""


def elastic_penalty(basis: Basis, material: Material, penalised: Mask) -> Float:
    """Return the penalty σ ``(n_faces,)``, in 1 / length, with a(v, v) >= MARGIN · ‖v‖² for all v.

    ‖v‖² = Σ_K ∫ σ(v) : ε(v) + Σ_F σ_F ∫ [v] · Γ [v]. It is 0 on faces that are not ``penalised (n_faces,)``.
    Cells too thin for the eigenvalue problem take the trace inequality of the simplices on their faces.

    Raises
    ------
    MeshError
        For thin cells that overlap themselves; in 3-D, for thin cells that are not convex.
    """
    mesh, n, m = basis.mesh, basis.mesh.n_cells, n_polynomials(basis.degree - 1, basis.mesh.dim)
    low = basis.mass_blocks[:, :m, :m]  # the first m polynomials have degree p − 1
    extremes = np.linalg.eigvalsh(low)[:, [0, -1]]
    thin = extremes[:, 0] <= _THIN * extremes[:, 1]
    inverse = np.linalg.inv(np.linalg.cholesky(np.where(thin[:, None, None], np.eye(m), low)))
    # 1. Pieces of faces by cell: the face, and the side on which the cell lies
    rule, weights = (
        face_rule(mesh, all_faces(mesh), basis.degree),
        face_weights(mesh, material, all_faces(mesh)),
    )
    pieces, sides = np.nonzero((mesh.face_cells[rule.faces] >= 0) & penalised[rule.faces, None])
    cells = mesh.face_cells[rule.faces[pieces], sides]
    order = np.argsort(cells, kind="stable")
    pieces, sides, cells = pieces[order], sides[order], cells[order]
    requirements = np.zeros((mesh.n_faces, 2))
    size = (m * mesh.dim * (mesh.dim + 1) // 2) ** 2
    starts = np.searchsorted(cells, np.arange(n + 1))
    for first, stop in batches(starts, _NUMBERS // size):
        part = slice(starts[first], starts[stop])
        if starts[stop] > starts[first]:
            own = rule.part(pieces[part])
            _require(basis, material, weights, own, sides[part], cells[part], inverse, requirements)
    # 2. Thin cells by simplices
    if thin.any():
        _require_by_simplices(basis, weights, material, penalised, thin, requirements)
    return frozen_float(requirements.sum(axis=1) / (1.0 - MARGIN) ** 2)


def _require(
    basis: Basis,
    material: Material,
    weights: FaceWeights,
    rule: FaceRule,
    sides: Int,
    cells: Int,
    inverse: Any,
    requirements: Float,
) -> None:
    """Compute the ``requirements (n_faces, 2)`` of a batch of cells, with the pieces of all their faces.

    ``cells (t,)`` are the cells of the pieces, sorted, and ``sides (t,)`` their sides; ``inverse`` whitens
    polynomials of degree p − 1 in each cell.
    """
    mesh, faces = basis.mesh, rule.faces
    count, dim = len(rule.points), mesh.dim
    # 1. Traces of an orthonormal basis, and tractions for unit C^½ ε
    values = basis.values(cells, rule.points)[:, :, : inverse.shape[1]] @ inverse[cells].transpose(0, 2, 1)
    traces = values.transpose(0, 2, 1) @ (rule.weights[:, :, None] * values)
    tractions = contraction(rule.normals) @ root_of_tensor(material, cells, dim)
    share = along(weights.share[faces, sides], rule.normals)
    squares = tractions.transpose(0, 2, 1) @ share @ tractions
    # 2. Ratio of the requirements on the faces of a cell: by size of the trace per measure
    sizes = np.zeros(requirements.shape)
    weight = (weights.share[faces, sides] * material.acoustic[cells]).max(axis=1)
    np.add.at(sizes, (faces, sides), weight * np.trace(traces, axis1=1, axis2=2) / mesh.face_measures[faces])
    ratio = np.sqrt(np.maximum(sizes[faces, sides], 0.0))
    factor = np.divide(1.0, ratio, out=np.zeros(count), where=ratio > 0.0)
    # 3. Largest eigenvalue of the weighted sum over the faces of each cell
    s, m = squares.shape[1], traces.shape[1]
    products = (factor[:, None, None] * squares)[:, :, None, :, None] * traces[:, None, :, None, :]
    starts = np.flatnonzero(np.diff(cells, prepend=-1))
    sums = np.add.reduceat(products.reshape(count, s * m, s * m), starts, axis=0)
    largest = np.linalg.eigvalsh(sums)[:, -1]
    requirements[faces, sides] = ratio * np.repeat(largest, np.diff(starts, append=count))


def _require_by_simplices(
    basis: Basis, weights: FaceWeights, material: Material, penalised: Mask, thin: Mask, requirements: Float
) -> None:
    """Replace the ``requirements (n_faces, 2)`` of ``thin`` cells by those from simplices on their faces.

    As :func:`~agglo_polydg_mg.forms.sharp_penalty.sharp_penalty` does; the simplices overlap, at worst all.
    """
    mesh, p = basis.mesh, basis.degree
    heights = simplex_heights(mesh, thin)
    faces, sides = np.nonzero((mesh.face_cells >= 0) & penalised[:, None] & np.isfinite(heights))
    cells = mesh.face_cells[faces, sides]
    faces, sides, cells = (each[thin[cells]] for each in (faces, sides, cells))
    flat = np.unique(cells[heights[faces, sides] == 0.0])[:5].tolist()
    if flat:
        raise MeshError(
            f"cells {flat} overlap themselves, or are flat: no simplex fits into them on some face"
        )
    weight = (weights.share[faces, sides] * material.acoustic[cells]).max(axis=1)
    number = np.bincount(cells, minlength=mesh.n_cells)[cells]
    requirements[faces, sides] = number * weight * p * (p + mesh.dim - 1) / heights[faces, sides]
