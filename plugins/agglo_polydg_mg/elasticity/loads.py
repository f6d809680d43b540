"""Boundary faces and right-hand sides of elasticity: body force, tractions and displacements."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from agglo_core.authoring import (
    Elasticity,
    Field,
    Float,
    Mesh,
    OptionError,
    VectorField,
    frozen_float,
    frozen_int,
)
from agglo_core.fields.boundary import BoundaryParts, boundary_values, split_boundary
from agglo_core.fields.values import sample
from agglo_polydg_mg.elasticity.forms import add_rows, tractions
from agglo_polydg_mg.elasticity.material import Material, along
from agglo_polydg_mg.elasticity.vectors import components
from agglo_polydg_mg.forms.face_quadrature import FaceRule, face_rule
from agglo_polydg_mg.space.basis import Basis

_ROUNDING = 1e-6
"""Difference between exact solution and displacements, relative to their size, that counts as rounding."""


def elastic_boundary(mesh: Mesh, problem: Elasticity) -> BoundaryParts:
    """Return the faces with displacements, as Dirichlet faces, and others, as natural faces.

    Without any data the displacement is 0 on the whole boundary.

    Raises
    ------
    OptionError
        For an unknown face tag, a value in both kinds of data or on no face, or a component without
        displacements and reaction.
    """
    # 1. Split the boundary faces
    conflicts = sorted(set(problem.displacement) & set(problem.traction))
    if conflicts:
        raise OptionError(
            f"boundary tag {conflicts[0]} has both a displacement and a traction: give only one"
        )
    parts = split_boundary(mesh, problem.boundary, problem.displacement, problem.traction)
    if not (problem.displacement or problem.traction):
        return parts
    # 2. Refuse rigid motions
    kinds, held = mesh.boundary_kinds, list(problem.displacement)
    on_boundary = kinds.tags.get(problem.boundary, np.zeros_like(kinds.component))
    free = np.setdiff1d(kinds.component, kinds.component[np.isin(on_boundary, held)])
    if len(free):
        component, reaction = mesh.graph.components(), problem.reactions(mesh.n_cells)
        free = free[~np.isin(component[free], component[reaction > 0.0])]
    if len(free):
        present = np.unique(on_boundary).tolist()
        raise OptionError(
            f"the component of cell {free[0]} has no boundary face with a displacement, so it can move "
            f"rigidly; give a displacement for one of its boundary tags {present} (tags given: displacement "
            f"{held or 'none'}, traction {list(problem.traction) or 'none'})"
        )
    return parts


def vector_data(
    mesh: Mesh, boundary: BoundaryParts, data: Mapping[int, VectorField], rule: FaceRule, name: str
) -> Float:
    """Evaluate boundary data ``(t, q, d)`` at the points of a face rule, 0 without data."""
    by_tag = {tag: components(field, mesh, f"{name} of tag {tag}") for tag, field in data.items()}
    axes: list[dict[int, Field]] = [
        {tag: each[axis] for tag, each in by_tag.items()} for axis in range(mesh.dim)
    ]
    values = [boundary_values(mesh, boundary.tags, each, rule.faces, rule.points, name) for each in axes]
    return frozen_float(np.stack(values, axis=2))


def require_consistent(basis: Basis, problem: Elasticity) -> None:
    """Raise OptionError if the exact solution differs from the displacements at quadrature points.

    Displacements with one value per cell may be averages, and are not compared.
    """
    boundary, mesh = elastic_boundary(basis.mesh, problem), basis.mesh
    if problem.exact is None:
        return
    by_cell = [tag for tag, each in problem.displacement.items() if not callable(each) and np.ndim(each) == 2]
    faces = boundary.dirichlet[~np.isin(boundary.tags[boundary.dirichlet], by_cell)]
    rule = face_rule(mesh, faces, basis.degree + 2)
    points = rule.points.reshape(-1, mesh.dim) + mesh.origin
    g = vector_data(mesh, boundary, problem.displacement, rule, "displacement").reshape(points.shape)
    for axis, exact in enumerate(components(problem.exact, mesh, "exact")):
        assert callable(exact)
        values = sample(exact, points, "exact")
        gaps = np.abs(values - g[:, axis])
        worst = int(np.argmax(gaps)) if len(gaps) else -1
        inside = np.abs(sample(exact, mesh.cell_centroids, "exact")).max()
        if worst >= 0 and gaps[worst] > _ROUNDING * max(np.abs(values).max(), np.abs(g).max(), inside):
            place = ", ".join(f"{x:g}" for x in points[worst])
            raise OptionError(
                f"exact contradicts the displacements: at the boundary point ({place}) its component {axis} "
                f"is {values[worst]:g}, the data are {g[worst, axis]:g}; pass the exact values as "
                "displacements, or no exact solution"
            )


def external_load(basis: Basis, problem: Elasticity, boundary: BoundaryParts) -> Float:
    """Return the load ``(n_cells, d, m)`` of body force and tractions."""
    mesh = basis.mesh
    load = np.zeros((mesh.n_cells, mesh.dim, basis.n_local))
    if problem.force is not None:
        for axis, force in enumerate(components(problem.force, mesh, "force")):
            load[:, axis] = basis.weighted_moments(force, basis.degree, "force") * basis.scale[:, None]
    if problem.traction:
        rule = face_rule(mesh, boundary.natural, basis.degree + 2)
        g = vector_data(mesh, boundary, problem.traction, rule, "traction")
        _add_tests(basis, rule, g, load)
    return load


def displacement_load(
    basis: Basis, material: Material, boundary: BoundaryParts, data: Mapping[int, VectorField], sigma: Float
) -> Float:
    """Return the load ``(n_cells, d, m)`` of displacements g: ∫ σ_F g·Γv − g·σ(v)n."""
    mesh = basis.mesh
    load = np.zeros((mesh.n_cells, mesh.dim, basis.n_local))
    if not data:
        return load
    rule = face_rule(mesh, boundary.dirichlet, basis.degree + 2)
    cells = frozen_int(mesh.face_cells[rule.faces, 0])
    g = vector_data(mesh, boundary, data, rule, "displacement")
    stiff = along(sigma[rule.faces, None] * material.acoustic[cells], rule.normals)
    _add_tests(basis, rule, g @ stiff, load)
    forces = tractions(basis, material, rule, cells)
    values = np.einsum("tq,tqi,tqibl->tbl", rule.weights, g, forces, optimize=True)
    add_rows(load.reshape(mesh.n_cells, -1), cells, -values.reshape(len(cells), -1))
    return load


def _add_tests(basis: Basis, rule: FaceRule, g: Float, load: Float) -> None:
    """Add ∫ g·v over pieces of boundary faces to the load, for values ``g (t, q, d)``."""
    cells = basis.mesh.face_cells[rule.faces, 0]
    values = (rule.weights[:, :, None] * g).transpose(0, 2, 1) @ basis.values(cells, rule.points)
    add_rows(load.reshape(len(load), -1), cells, values.reshape(len(cells), -1))
