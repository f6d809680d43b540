"""Boundary data: Dirichlet and Neumann faces, and their right-hand sides."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from agglo_core.authoring import Diffusion, Field, Float, Int, Mask, Mesh, OptionError, frozen_int
from agglo_polydg_mg.forms.coefficients import cell_means, is_zero, nonnegative
from agglo_polydg_mg.forms.face_quadrature import FaceRule, face_rule, on_pieces
from agglo_polydg_mg.space.basis import Basis
from agglo_polydg_mg.space.quadrature import per_cell, sample

_ROUNDING = 1e-6
"""Difference between exact solution and Dirichlet data, relative to their size, that counts as rounding."""


class Boundary(NamedTuple):
    """Face tags ``(n_faces,)``, Dirichlet faces, and natural (Neumann) faces of the boundary."""

    tags: Int
    dirichlet: Int
    natural: Int


def boundary_faces(mesh: Mesh, problem: Diffusion) -> Boundary:
    """Return the boundary faces with and without Dirichlet data, and all face tags.

    Without any data all boundary faces are Dirichlet faces, with value 0.

    Raises
    ------
    OptionError
        For an unknown face tag, a value in both kinds of data or on no face, or a component with neither
        Dirichlet faces nor reaction.
    """
    # 1. Check the tags
    tags = _tags(mesh, problem.boundary)
    outer, kinds = mesh.face_cells[:, 1] < 0, mesh.boundary_kinds
    on_boundary = kinds.tags.get(problem.boundary, np.zeros_like(kinds.component))
    present = np.unique(on_boundary).tolist()
    conflicts = sorted(set(problem.dirichlet) & set(problem.neumann))
    if conflicts:
        raise OptionError(
            f"boundary tags {conflicts} have both Dirichlet and Neumann data: give only one of them"
        )
    unknown = sorted({*problem.dirichlet, *problem.neumann} - set(present))
    if unknown:
        raise OptionError(f"no boundary face has the tag {unknown[0]}; the boundary has the tags {present}")
    # 2. Split the boundary faces
    data = problem.dirichlet or problem.neumann
    dirichlet = outer & np.isin(tags, list(problem.dirichlet)) if data else outer
    natural = outer & ~dirichlet
    if data:
        held = np.isin(on_boundary, list(problem.dirichlet))
        free = np.setdiff1d(kinds.component, kinds.component[held])
        _require_unique(mesh, free, problem.reaction)
    return Boundary(tags, frozen_int(np.flatnonzero(dirichlet)), frozen_int(np.flatnonzero(natural)))


def _tags(mesh: Mesh, name: str) -> Int:
    """Return the values of the face tag ``name``, all 0 if the default tag is absent."""
    if name in mesh.face_tags:
        return mesh.face_tags[name]
    if name != Diffusion.boundary:
        known = ", ".join(mesh.face_tags) or "none"
        raise OptionError(f"the mesh has no face tag {name!r} for the boundary; it has: {known}")
    return frozen_int(np.zeros(mesh.n_faces))


def _require_unique(mesh: Mesh, free: Int, reaction: Field) -> None:
    """Raise OptionError if a component without Dirichlet faces has no reaction either.

    ``free`` components are given by their first cells.
    """
    if len(free):
        free = frozen_int(free[~_has_reaction(mesh, free, reaction)])
    if len(free):
        raise OptionError(
            f"the component of cell {free[0]} has no boundary face with Dirichlet data and no reaction, so "
            "the solution is determined only up to a constant there; give a Dirichlet value for one of its "
            "boundary tags (if only other tags have data, its faces are insulated)"
        )


def _has_reaction(mesh: Mesh, components: Int, reaction: Field) -> Mask:
    """Return True for components, given by their first cells, where the reaction is positive somewhere.

    On a piece of a distributed mesh, whose components are those of the whole, it must be positive in every
    cell of the piece.
    """
    if is_zero(reaction):
        return np.zeros(len(components), bool)
    cells = cell_means(mesh, nonnegative(mesh, reaction), "reaction") > 0
    if not mesh.boundary_kinds.whole:
        return np.full(len(components), cells.all())
    component = mesh.graph.components()
    return np.isin(component[components], component[cells])


def boundary_values(
    mesh: Mesh, boundary: Boundary, data: Mapping[int, Field], faces: Int, points: Float, name: str
) -> Float:
    """Evaluate boundary data ``(t, q)`` at ``points (t, q, d)`` on ``faces (t,)``, 0 without data."""
    values = np.zeros(points.shape[:2])
    for tag, field in data.items():
        on = boundary.tags[faces] == tag
        if callable(field):
            given = sample(field, points[on].reshape(-1, mesh.dim) + mesh.origin, f"{name} of tag {tag}")
            values[on] = given.reshape(-1, points.shape[1])
        else:
            cells = per_cell(field, mesh.n_cells, f"{name} of tag {tag}")
            values[on] = cells[mesh.face_cells[faces[on], 0], None]
    return values


def dirichlet_values(basis: Basis, problem: Diffusion, boundary: Boundary) -> Float:
    """Evaluate the Dirichlet data ``(t, q)`` at the quadrature points of :func:`rule_of` on their faces."""
    if not problem.dirichlet:
        return np.zeros((len(boundary.dirichlet), basis.degree + 2))
    rule = rule_of(basis, boundary.dirichlet)
    return boundary_values(basis.mesh, boundary, problem.dirichlet, rule.faces, rule.points, "dirichlet")


def require_consistent(mesh: Mesh, problem: Diffusion, degree: int) -> None:
    """Raise OptionError if the exact solution differs from the Dirichlet data at quadrature points.

    Data with one value per cell may be averages, and are not compared, and neither are fluxes.
    """
    if problem.exact is None:
        return
    # 1. Exact solution and data on the faces of the domain boundary
    boundary = boundary_faces(mesh, problem)
    tags = boundary.tags[boundary.dirichlet]
    by_cell = [tag for tag, field in problem.dirichlet.items() if not callable(field) and np.ndim(field)]
    faces = boundary.dirichlet[mesh.outer_faces[boundary.dirichlet] & ~np.isin(tags, by_cell)]
    if not len(faces):
        return
    rule = face_rule(mesh, faces, degree + 2)
    points = rule.points.reshape(-1, mesh.dim) + mesh.origin
    exact = sample(problem.exact, points, "exact")
    g = boundary_values(mesh, boundary, problem.dirichlet, rule.faces, rule.points, "dirichlet").ravel()
    # 2. Largest difference, relative to both, and to values inside where both nearly vanish
    worst = int(np.argmax(np.abs(exact - g)))
    gap = abs(exact[worst] - g[worst])
    if gap <= _ROUNDING * max(np.abs(exact).max(), np.abs(g).max()):
        return
    if gap > _ROUNDING * np.abs(sample(problem.exact, mesh.cell_centroids, "exact")).max():
        place = ", ".join(f"{x:g}" for x in points[worst])
        raise OptionError(
            f"exact contradicts the Dirichlet data: at the boundary point ({place}) it is {exact[worst]:g}, "
            f"the data are {g[worst]:g}; pass the exact values as Dirichlet data, or no exact solution"
        )


def rule_of(basis: Basis, faces: Int) -> FaceRule:
    """Return the quadrature rule for boundary data on some faces."""
    return face_rule(basis.mesh, faces, basis.degree + 2)


def data_offset(basis: Basis, problem: Diffusion, boundary: Boundary, kappa: Float) -> Float:
    """Return a constant to subtract from Dirichlet data and solution in each cell ``(n_cells,)``.

    In each domain component it is the number nearest to 0 between the minimum and maximum of the data: 0 if
    they change sign. Only faces with κ at least a hundredth of the largest count: they determine the
    rounding. A constant added to the data is added to the solution, for any κ, and alters nothing else.
    With a reaction that is not so, and the constant is 0.
    ``kappa (f, 1)`` or ``(t, q)`` is the coefficient in the owners of the Dirichlet faces.
    """
    # 1. Data, component and coefficient per face
    mesh = basis.mesh
    g, component = dirichlet_values(basis, problem, boundary), mesh.graph.components()
    if not (g.any() and is_zero(problem.reaction)):
        return np.zeros(mesh.n_cells)
    rule = rule_of(basis, boundary.dirichlet)
    of_face = component[mesh.face_cells[rule.faces, 0]]
    of_kappa = on_pieces(kappa, boundary.dirichlet, rule).max(axis=1)
    # 2. Data range per component, over faces with large κ
    n = int(component.max()) + 1
    largest, least, most = np.zeros(n), np.full(n, np.inf), np.full(n, -np.inf)
    np.maximum.at(largest, of_face, of_kappa)
    counts = of_kappa >= 0.01 * largest[of_face]
    np.minimum.at(least, of_face[counts], g[counts].min(axis=1))
    np.maximum.at(most, of_face[counts], g[counts].max(axis=1))
    return np.asarray(np.clip(0.0, least, most)[component])


def dirichlet_load(basis: Basis, boundary: Boundary, kappa: Float, sigma: Float) -> Callable[[Float], Float]:
    """Return the map from Dirichlet data g ``(t, q)`` to the right-hand side ``(n_cells, n_local)``.

    The right-hand side is ∫ σκ g v − κ g ∂v/∂n. The data come from :func:`dirichlet_values`;
    ``kappa (f, 1)`` or ``(t, q)`` is the coefficient in the owners of the Dirichlet faces,
    ``sigma (n_faces,)`` the penalty.
    """
    mesh, rule = basis.mesh, rule_of(basis, boundary.dirichlet)
    tests, faces = _traces(basis, rule), rule.faces
    cells = np.repeat(mesh.face_cells[faces, 0], rule.points.shape[1])
    slopes = basis.gradients(cells, rule.points.reshape(-1, mesh.dim))
    normals = np.repeat(rule.normals, rule.points.shape[1], axis=0)
    fluxes = np.einsum("qd,qdk->qk", normals, slopes).reshape(tests.shape)
    own = on_pieces(kappa, boundary.dirichlet, rule)
    tests = own[:, :, None] * (sigma[faces][:, None, None] * tests - fluxes)
    return lambda g: _sum_per_cell(basis, faces, rule.weights * g, tests)


def neumann_load(basis: Basis, problem: Diffusion, boundary: Boundary) -> Float:
    """Return the right-hand side ``(n_cells, n_local)`` for Neumann data: ∫ flux v."""
    rule = rule_of(basis, boundary.natural)
    g = boundary_values(basis.mesh, boundary, problem.neumann, rule.faces, rule.points, "neumann")
    return _sum_per_cell(basis, rule.faces, rule.weights * g, _traces(basis, rule))


def _traces(basis: Basis, rule: FaceRule) -> Float:
    """Evaluate the polynomials ``(t, q, n_local)`` of each face's owner cell at the quadrature points."""
    count, n, dim = rule.points.shape
    cells = np.repeat(basis.mesh.face_cells[rule.faces, 0], n)
    return basis.values(cells, rule.points.reshape(-1, dim)).reshape(count, n, basis.n_local)


def _sum_per_cell(basis: Basis, faces: Int, values: Float, tests: Float) -> Float:
    """Sum values (t, q) times test functions (t, q, k) over each cell's points and faces."""
    load = np.zeros((basis.mesh.n_cells, basis.n_local))
    np.add.at(load, basis.mesh.face_cells[faces, 0], np.einsum("tq,tqk->tk", values, tests))
    return load
