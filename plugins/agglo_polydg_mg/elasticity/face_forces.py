"""Forces on faces: conservative tractions, as the discretisation contains them."""

from __future__ import annotations

from functools import partial

import numpy as np

from agglo_core.authoring import Elasticity, Float, Mesh, frozen_int
from agglo_polydg_mg.elasticity.forms import add_rows, tractions
from agglo_polydg_mg.elasticity.loads import elastic_boundary, vector_data
from agglo_polydg_mg.elasticity.material import Material, along, face_weights
from agglo_polydg_mg.elasticity.norms import traces
from agglo_polydg_mg.elasticity.vectors import split
from agglo_polydg_mg.forms.face_quadrature import face_rule
from agglo_polydg_mg.forms.fluxes import on_edges
from agglo_polydg_mg.space.basis import Basis

_FACES = 4_000  # per batch: limits the memory for gradients of the basis at quadrature points


def face_forces(
    basis: Basis, mesh: Mesh, x: Float, problem: Elasticity, material: Material, sigma: Float
) -> Float:
    """Return the force ∫ σ(u) n on the first cell of each face ``(n_faces, d)``, n being outward.

    Tested with a constant on one cell, the discrete problem contains the traction {σ(u)n} − σ_F Γ[u] on
    inner faces, with u − g for [u] on faces with displacements, and the given traction on other boundary
    faces. If x solves the system, the forces on a cell therefore balance its body force less
    reaction.

    Parameters
    ----------
    basis : Basis
    mesh : Mesh
        The mesh of the basis before :func:`~agglo_polydg_mg.forms.sides.with_straight_sides`.
    x : (d n,) float
    problem : Elasticity
    material : Material
    sigma : (n_faces,) float
        Jump penalty, on the mesh of the basis.
    """
    through = partial(_through_faces, basis, split(basis, x), problem, material)
    return on_edges(basis.mesh, mesh, through, sigma)


def _through_faces(
    basis: Basis, u: Float, problem: Elasticity, material: Material, mesh: Mesh, sigma: Float
) -> Float:
    """Integrate tractions over all faces of a mesh ``(n_faces, d)``, with the jump penalty ``sigma``."""
    boundary, dim = elastic_boundary(mesh, problem), mesh.dim
    natural = np.zeros(mesh.n_faces, bool)
    natural[boundary.natural] = True
    forces = np.zeros((mesh.n_faces, dim))
    for start in range(0, mesh.n_faces, _FACES):
        # 1. Weighted means of the tractions, and jumps
        faces = frozen_int(np.arange(start, min(start + _FACES, mesh.n_faces)))
        rule = face_rule(mesh, faces, basis.degree + 2)
        weights, at = face_weights(mesh, material, faces), rule.faces - start
        points = rule.points + (mesh.origin - basis.mesh.origin)
        traction, jump = np.zeros(points.shape), np.zeros(points.shape)
        for side in range(2):
            cells = mesh.face_cells[rule.faces, side]
            pieces = np.flatnonzero((cells >= 0) & ~natural[rule.faces])
            cells, some = frozen_int(cells[pieces]), points[pieces]
            jump[pieces] += (1.0, -1.0)[side] * traces(basis, u, cells, some)
            means = along(weights.average[at[pieces], side], rule.normals[pieces])
            by_basis = tractions(basis, material, rule.part(pieces)._replace(points=some), cells)
            traction[pieces] += np.einsum("tqjbl,tbl,tij->tqi", by_basis, u[cells], means, optimize=True)
        # 2. Displacements on the boundary, and the penalty of jumps
        fixed = (mesh.face_cells[rule.faces, 1] < 0) & ~natural[rule.faces]
        jump[fixed] -= vector_data(mesh, boundary, problem.displacement, rule.part(fixed), "displacement")
        stiff = along(sigma[rule.faces, None] * weights.mean[at], rule.normals)
        traction -= jump @ stiff
        # 3. Given tractions
        free = natural[rule.faces]
        traction[free] = vector_data(mesh, boundary, problem.traction, rule.part(free), "traction")
        add_rows(forces, rule.faces, (rule.weights[:, :, None] * traction).sum(axis=1))
    return forces
