"""Boundary data: Dirichlet, Neumann and Robin faces, their right-hand sides, and the Robin matrix."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from agglo_core.authoring import (
    Diffusion,
    Float,
    Int,
    Mask,
    Mesh,
    OptionError,
    frozen_float,
    frozen_int,
)
from agglo_core.fields.boundary import (
    BoundaryParts,
    boundary_parts,
    boundary_values,
    natural_values,
    require_exact,
    robin_alpha,
    robin_data,
)
from agglo_core.fields.coefficients import is_zero, nonnegative
from agglo_polydg_mg.forms.coefficients import cell_means
from agglo_polydg_mg.forms.face_quadrature import FaceRule, OnFaces, face_rule, on_pieces
from agglo_polydg_mg.space.basis import Basis


def boundary_faces(mesh: Mesh, problem: Diffusion) -> BoundaryParts:
    """Return the :func:`~agglo_core.fields.boundary.boundary_parts`, with the floating components.

    Raises
    ------
    OptionError
        For an unknown face tag, or a value in two kinds of data or on no face; on a piece of a distributed
        mesh, for a floating component.
    """
    parts = boundary_parts(mesh, problem)
    if not (problem.dirichlet or problem.neumann or problem.robin):
        return parts
    # Components without Dirichlet faces
    kinds = mesh.boundary_kinds
    on_boundary = kinds.tags.get(problem.boundary, np.zeros_like(kinds.component))
    held = np.isin(on_boundary, list(problem.dirichlet))
    free = np.setdiff1d(kinds.component, kinds.component[held])
    if not len(free):
        return parts
    free = free[~_are_held(mesh, frozen_int(free), problem, parts)]
    if len(free) and not kinds.whole:
        raise OptionError(
            f"the component of cell {free[0]} has no boundary face with Dirichlet data, no reaction and no "
            "Robin data with positive alpha, so the solution is determined only up to a constant there; on a "
            "distributed mesh, give a Dirichlet value for one of its boundary tags (if only other tags have "
            "data, its faces are insulated)"
        )
    return parts._replace(floating=frozen_int(free))


def _are_held(mesh: Mesh, components: Int, problem: Diffusion, boundary: BoundaryParts) -> Mask:
    """Return True for components, given by their first cells, with reaction or a positive α somewhere.

    On a piece of a distributed mesh, whose components are those of the whole, only a number α counts, and a
    reaction that is positive in every cell of the piece.
    """
    kinds = mesh.boundary_kinds
    if kinds.whole:
        cells = cell_means(mesh, nonnegative(mesh, problem.reaction), "reaction") > 0
        rule = face_rule(mesh, boundary.natural, 3)
        alpha = robin_alpha(mesh, boundary.tags, problem, rule.faces, rule.points)
        cells[mesh.face_cells[rule.faces[(alpha > 0).any(axis=1)], 0]] = True
        component = mesh.graph.components()
        return np.isin(component[components], component[cells])
    on_boundary = kinds.tags.get(problem.boundary, np.zeros_like(kinds.component))
    firm = [tag for tag, (alpha, _) in problem.robin.items() if not callable(alpha) and np.all(alpha)]
    held = np.isin(components, kinds.component[np.isin(on_boundary, firm)])
    everywhere = bool((cell_means(mesh, nonnegative(mesh, problem.reaction), "reaction") > 0).all())
    return held | everywhere


def dirichlet_values(basis: Basis, problem: Diffusion, boundary: BoundaryParts) -> Float:
    """Evaluate the Dirichlet data ``(t, q)`` at the quadrature points of :func:`rule_of` on their faces."""
    if not problem.dirichlet:
        return np.zeros((len(boundary.dirichlet), basis.degree + 2))
    rule = rule_of(basis, boundary.dirichlet)
    return boundary_values(basis.mesh, boundary.tags, problem.dirichlet, rule.faces, rule.points, "dirichlet")


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
    g = boundary_values(mesh, boundary.tags, problem.dirichlet, rule.faces, rule.points, "dirichlet")
    require_exact(mesh, problem.exact, rule.points.reshape(-1, mesh.dim), g.ravel())


def rule_of(basis: Basis, faces: Int) -> FaceRule:
    """Return the quadrature rule for boundary data on some faces."""
    return face_rule(basis.mesh, faces, basis.degree + 2)


def data_offset(basis: Basis, problem: Diffusion, boundary: BoundaryParts, kappa: Float) -> Float:
    """Return a constant to subtract from Dirichlet data and solution in each cell ``(n_cells,)``.

    In each domain component with data it is the number nearest to 0 between their minimum and maximum: 0 if
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
    return np.asarray(np.where(least <= most, np.clip(0.0, least, most), 0.0)[component])


def dirichlet_load(
    basis: Basis, boundary: BoundaryParts, on_faces: OnFaces, sigma: Float
) -> Callable[[Float], Float]:
    """Return the map from Dirichlet data g ``(t, q)`` to the right-hand side ``(n_cells, n_local)``.

    The right-hand side is ∫ σκ g v − κ g ∂v/∂n, for a tensor with n·κn and κn·∇v. The data come from
    :func:`dirichlet_values`, ``on_faces`` is the coefficient on the Dirichlet faces, and
    ``sigma (n_faces,)`` the penalty.
    """
    mesh, rule = basis.mesh, rule_of(basis, boundary.dirichlet)
    cells = mesh.face_cells[rule.faces, 0]
    tests, slopes = basis.values(cells, rule.points), basis.gradients(cells, rule.points)
    directions = rule.normals[:, None]
    if len(on_faces.directions):
        directions = on_pieces(on_faces.directions, boundary.dirichlet, rule)[:, 0]
    fluxes = np.einsum("tqd,tqdk->tqk", np.broadcast_to(directions, rule.points.shape), slopes)
    kappa = on_pieces(frozen_float(on_faces.kappa[:, 0]), boundary.dirichlet, rule)
    tests = kappa[:, :, None] * (sigma[rule.faces][:, None, None] * tests - fluxes)
    return lambda g: sum_per_cell(basis, cells, rule.weights * g, tests)


def natural_load(basis: Basis, problem: Diffusion, boundary: BoundaryParts) -> Float:
    """Return the right-hand side ``(n_cells, n_local)`` for Neumann and Robin data: ∫ g v."""
    rule = rule_of(basis, boundary.natural)
    g = natural_values(basis.mesh, boundary.tags, problem, rule.faces, rule.points)
    cells = basis.mesh.face_cells[rule.faces, 0]
    return sum_per_cell(basis, cells, rule.weights * g, basis.values(cells, rule.points))


def natural_sizes(basis: Basis, problem: Diffusion, boundary: BoundaryParts) -> Float:
    """Return the integral of |g| over the Neumann and Robin faces of each cell ``(n_cells,)``."""
    mesh, rule = basis.mesh, rule_of(basis, boundary.natural)
    sizes = np.abs(rule.weights * natural_values(mesh, boundary.tags, problem, rule.faces, rule.points)).sum(
        axis=1
    )
    return frozen_float(np.bincount(mesh.face_cells[rule.faces, 0], sizes, mesh.n_cells))


def largest_alpha(mesh: Mesh, problem: Diffusion) -> Float:
    """Return the largest α on the faces of each cell ``(n_cells,)``, 0 without Robin data."""
    boundary, largest = boundary_faces(mesh, problem), np.zeros(mesh.n_cells)
    rule = face_rule(mesh, boundary.natural, 2)
    alpha = robin_alpha(mesh, boundary.tags, problem, rule.faces, rule.points)
    np.maximum.at(largest, mesh.face_cells[rule.faces, 0], alpha.max(axis=1, initial=0.0))
    return largest


class RobinTerms(NamedTuple):
    """Robin terms ∫ α u v − ∫ g v at quadrature points on boundary face pieces.

    Attributes
    ----------
    cells : (t,) int
    tests : (t, q, n_local) float
        Polynomials of each piece's cell.
    weights : (t, q) float
        Quadrature weights times α.
    targets : (t, q) float
        g / α, or 0 where α = 0.
    """

    cells: Int
    tests: Float
    weights: Float
    targets: Float

    def add_to(self, blocks: Float, places: Int) -> None:
        """Add ∫ α φ_i φ_j to matrix ``blocks``, with the diagonal block of cell c at ``places[c]``."""
        own = np.einsum("tq,tqi,tqj->tij", self.weights, self.tests, self.tests, optimize=True)
        np.add.at(blocks, places[self.cells], own)

    def energy(self, u: Float) -> float:
        """Return ∫ α (u − g/α)² for coefficients ``u (n_cells, n_local)``."""
        values = np.einsum("tqi,ti->tq", self.tests, u[self.cells])
        return float((self.weights * (values - self.targets) ** 2).sum())


def robin_terms(basis: Basis, problem: Diffusion, boundary: BoundaryParts) -> RobinTerms | None:
    """Return the terms of Robin data, or None without any."""
    if not problem.robin:
        return None
    mesh = basis.mesh
    faces = frozen_int(boundary.natural[np.isin(boundary.tags[boundary.natural], list(problem.robin))])
    rule = rule_of(basis, faces)
    alpha = robin_alpha(mesh, boundary.tags, problem, rule.faces, rule.points)
    g = boundary_values(mesh, boundary.tags, robin_data(problem, 1), rule.faces, rule.points, "robin")
    targets = np.divide(g, alpha, out=np.zeros_like(g), where=alpha > 0)
    cells = frozen_int(mesh.face_cells[rule.faces, 0])
    return RobinTerms(cells, basis.values(cells, rule.points), rule.weights * alpha, targets)


def sum_per_cell(basis: Basis, cells: Int, values: Float, tests: Float) -> Float:
    """Sum values ``(t, q)`` times test functions ``(t, q, k)`` of ``cells (t,)`` by cell."""
    load = np.zeros((basis.mesh.n_cells, basis.n_local))
    np.add.at(load, cells, np.einsum("tq,tqk->tk", values, tests))
    return load
