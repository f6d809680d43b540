"""Symmetric interior penalty form of elasticity on polygons and polyhedra.

a(u, v) = Σ_K ∫ σ(u) : ε(v) + c u·v − Σ_F ∫ ({σ(u) n}·[v] + {σ(v) n}·[u]) + Σ_F σ_F ∫ [u]·Γ[v], boundary
faces with displacements included. Averages and Γ weigh tangential and normal parts separately, see
:class:`~agglo_polydg_mg.elasticity.material.FaceWeights`.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Int, frozen_int
from agglo_polydg_mg.elasticity.material import Material, along, face_weights
from agglo_polydg_mg.elasticity.vectors import vector_blocks
from agglo_polydg_mg.forms.face_quadrature import FaceRule, face_rule
from agglo_polydg_mg.space.basis import Basis
from agglo_polydg_mg.space.polynomials import derivatives

_NUMBERS = 4_000_000  # per batch of faces: some tens of MB


def cell_blocks(basis: Basis, material: Material, reaction: Float) -> Float:
    """Return ∫ σ(φ_l e_b) : ε(φ_k e_a) + c φ_l e_b · φ_k e_a per cell ``(n_cells, d m, d m)``."""
    dim, m = basis.mesh.dim, basis.n_local
    # ∂φ_k / ∂x_i = Σ_l E[i, l, k] φ_l in each cell
    E: Float = np.einsum("cia,alk->cilk", basis.directions, derivatives(basis.degree, dim))
    weighted = basis.mass_blocks[:, None] @ E
    # ∫ ∂_i φ_k ∂_j φ_l with axes cell, i, k, j, l
    products = (
        E.transpose(0, 1, 3, 2).reshape(-1, dim * m, m)
        @ weighted.transpose(0, 2, 1, 3).reshape(-1, m, dim * m)
    ).reshape(-1, dim, m, dim, m)
    blocks = material.lame[:, None, None, None, None] * products
    blocks += material.mu[:, None, None, None, None] * products.transpose(0, 3, 2, 1, 4)
    along_all = material.mu[:, None, None] * np.einsum("cikil->ckl", products)
    for axis in range(dim):
        blocks[:, axis, :, axis] += along_all
    stiffness = blocks.reshape(-1, dim * m, dim * m)
    if reaction.any():
        stiffness += vector_blocks(reaction[:, None, None] * basis.mass_blocks, dim)
    return stiffness


def tractions(basis: Basis, material: Material, rule: FaceRule, cells: Int) -> Float:
    """Return the tractions σ(φ_l e_b) n ``(t, q, d, d, m)`` of cells ``(t,)``: direction, then b and l."""
    slopes = basis.gradients(cells, rule.points)
    lame, mu = (each[cells, None, None, None] for each in material)
    normals = rule.normals[:, None, :, None]
    found = (lame * slopes)[:, :, None] * normals[:, :, :, None]
    found += (mu * slopes)[:, :, :, None] * normals[:, :, None]
    along_normal = mu[:, :, 0] * (slopes * normals).sum(axis=2)
    for axis in range(basis.mesh.dim):
        found[:, :, axis, axis] += along_normal
    return np.asarray(found)


def matrix(basis: Basis, material: Material, reaction: Float, sigma: Float) -> sparse.bsr_array:
    """Return the matrix ``(n_cells d m, n_cells d m)``, with one block per cell and per pair of neighbours.

    The ``reaction (n_cells,)`` is c.
    ``sigma (n_faces,)`` is the :func:`~agglo_polydg_mg.elasticity.penalty.elastic_penalty`; faces with
    penalty 0 are natural boundary faces, or have no measure.
    """
    mesh, width = basis.mesh, basis.mesh.dim * basis.n_local
    indptr, indices, diagonal, slots = basis.pattern
    blocks = np.zeros((len(indices), width, width))
    blocks[diagonal] = cell_blocks(basis, material, reaction)
    if mesh.dim == 3:  # the pattern lists sides instead of faces
        own = basis.sides.of_faces
        turned = mesh.face_cells[:, 0] != basis.sides.cells[own, 0]
        slots = slots[own]
        slots[turned] = slots[turned][:, ::-1, ::-1]
    inner = mesh.face_cells[:, 1] >= 0
    for n_sides, chosen in ((2, inner), (1, ~inner)):
        faces = np.flatnonzero(chosen & (sigma > 0.0))
        q = (basis.degree + 1) ** (mesh.dim - 1)
        batch = max(1, _NUMBERS // (n_sides * width * max(n_sides * width, mesh.dim * q)))
        for first in range(0, len(faces), batch):
            _add_faces(
                basis, material, sigma, frozen_int(faces[first : first + batch]), n_sides, slots, blocks
            )
    shape = (mesh.n_cells * width, mesh.n_cells * width)
    return sparse.bsr_array((blocks, indices, indptr), shape=shape)


def _add_faces(
    basis: Basis, material: Material, sigma: Float, faces: Int, n_sides: int, slots: Int, blocks: Float
) -> None:
    """Add the terms of faces with ``n_sides`` cells to the matrix blocks."""
    mesh, rule = basis.mesh, face_rule(basis.mesh, faces, basis.degree + 1)
    count, q, dim = rule.points.shape
    m, at = basis.n_local, np.searchsorted(faces, rule.faces)
    weights, cells = face_weights(mesh, material, faces), mesh.face_cells[rule.faces]
    # 1. Jumps of the scalar polynomials, and averages of tractions, of all cells
    jumps = np.empty((count, q, n_sides, m))
    averages = np.empty((count, q, n_sides, dim, dim, m))
    for side in range(n_sides):
        values = basis.values(cells[:, side], rule.points)
        jumps[:, :, side] = -values if side else values
        mean = along(weights.average[at, side], rule.normals)
        found = tractions(basis, material, rule, frozen_int(cells[:, side]))
        averages[:, :, side] = (mean[:, None] @ found.reshape(count, q, dim, -1)).reshape(found.shape)
    # 2. Integrals: axes piece, cell and polynomial of the test function, its component, then of the trial
    tests = (rule.weights[:, :, None, None] * jumps).reshape(count, q, -1).transpose(0, 2, 1)
    mixed = tests @ averages.reshape(count, q, -1)
    mixed = mixed.reshape(count, n_sides, m, n_sides, dim, dim, m).transpose(0, 1, 4, 2, 3, 5, 6)
    products = (tests @ jumps.reshape(count, q, -1)).reshape(count, n_sides, m, n_sides, m)
    form = -mixed - mixed.transpose(0, 4, 5, 6, 1, 2, 3)
    stiff = along(sigma[faces[at], None] * weights.mean[at], rule.normals)
    form += stiff[:, None, :, None, None, :, None] * products[:, :, None, :, :, None, :]
    # 3. Sums per block
    rows = slots[rule.faces][:, :n_sides, :n_sides].reshape(-1)
    values = form.reshape(count, n_sides, dim * m, n_sides, dim * m).transpose(0, 1, 3, 2, 4)
    add_rows(blocks.reshape(len(blocks), -1), rows, values.reshape(len(rows), -1))


def add_rows(target: Float, rows: Int, values: Float) -> None:
    """Add ``values (k, w)`` to the given rows of ``target (n, w)``, which may repeat."""
    unique, place = np.unique(rows, return_inverse=True)
    ones = np.ones(len(rows))
    sums = sparse.csr_array((ones, (place, np.arange(len(rows)))), shape=(len(unique), len(rows)))
    target[unique] += sums @ values
