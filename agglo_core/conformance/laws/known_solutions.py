"""Laws for solvers and discretisations of diffusion: known solutions, superposition, and convergence.

A solver may refuse boundary data with an AggloError. Values are compared if the meaning of the unknowns is
known: from the solver's discretisation, or because there is one unknown per cell.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from agglo_core.arrays import Float
from agglo_core.conformance.base import Case, Subject, law, require, require_close
from agglo_core.conformance.inputs.problem_strategies import plates, solver_cases
from agglo_core.conformance.inputs.solver_answers import (
    gap,
    solve_assembled,
    solve_unless_refused,
    takes_diffusion,
    values,
)
from agglo_core.conformance.inputs.solver_cases import boundary_tags, on_levels, smooth_plate
from agglo_core.hierarchy import Hierarchy
from agglo_core.problems import Diffusion

_EXAMPLES = 15  # drawn problems for each law
_CLOSE = 1e-3  # relative to the largest value; solvers stop at a tolerance of their own
_ROUNDING = 1e-5  # the same for discretisations, whose systems are solved by elimination


def _tagged_meshes(subject: Subject) -> Any:
    """Draw diffusion problems on connected meshes with up to three values of the face tag ``boundary``."""
    return solver_cases(subject, ("diffusion",), tags=(("boundary", "gmsh"),))


def _unknowns(subject: Subject, problem: Diffusion, hierarchy: Hierarchy) -> Float | None:
    it = solve_unless_refused(subject, Case("a mesh with boundary tags", (problem, hierarchy)))
    return None if it is None else it.x


def _found(subject: Subject, problem: Diffusion, hierarchy: Hierarchy) -> Float | None:
    """Return the solution at the cell centroids, or None if it is refused or cannot be evaluated."""
    assert hierarchy.fine is not None
    if subject.kind == "discretisation":
        return solve_assembled(subject.build(), problem, hierarchy.fine)
    tags = boundary_tags(hierarchy.fine, problem.boundary)
    constant = replace(problem, source=0.0, dirichlet=dict.fromkeys(tags, 1.0), neumann={})
    one, x = (_unknowns(subject, each, hierarchy) for each in (constant, problem))
    require(
        one is None or np.any(one != 0.0),
        f"boundary value 1 everywhere (face tag {problem.boundary!r}) gives x = 0: check that boundary data "
        "are read",
    )
    return None if x is None or one is None else values(subject.build(), hierarchy, x, one)


@law("solver", draw=_tagged_meshes, examples=_EXAMPLES, when=takes_diffusion)
def constant_found(subject: Subject, case: Case) -> None:
    """Without source and with boundary value 1 wherever given, the solution is 1 for any κ, on any mesh."""
    problem, hierarchy = case.given
    first, *others = boundary_tags(hierarchy.fine)
    partly = Diffusion(
        problem.kappa, 0.0, {first: 1.0}, dict.fromkeys(others[:1], 0.0)
    )  # the last is insulated
    everywhere = replace(partly, dirichlet=dict.fromkeys([first, *others], 1.0), neumann={})
    one, x = (_unknowns(subject, each, hierarchy) for each in (everywhere, partly))
    if one is None or x is None:
        return
    error = gap(x, one)
    require(
        error <= _CLOSE,
        f"boundary value 1 on the faces of tag {first} gives an x that is off by {error:.1e} from that with "
        "value 1 on the whole boundary: faces whose tag is in neither dirichlet nor neumann are insulated, "
        "and κ must not scale boundary values",
    )
    samples = values(subject.build(), hierarchy, one, one)
    error = 0.0 if samples is None else float(np.abs(samples - 1.0).max())
    require(error <= _CLOSE, f"boundary value 1 gives a solution that is off by {error:.1e} from 1")


@law("solver", draw=_tagged_meshes, examples=_EXAMPLES, when=takes_diffusion)
def data_superposed(subject: Subject, case: Case) -> None:
    """Source, boundary values and fluxes add up, and have the same effect as numbers, arrays or functions."""
    problem, hierarchy = case.given
    first, *others = boundary_tags(hierarchy.fine)
    kappa, n = problem.kappa, hierarchy.graph.n
    single = (
        Diffusion(kappa, 2.0, {first: 0.0}),
        Diffusion(kappa, 0.0, {first: 3.0}),
        Diffusion(kappa, 0.0, {first: 0.0}, dict.fromkeys(others[:1], 5.0)),
    )
    together = Diffusion(
        np.full(n, kappa) if isinstance(kappa, float) else kappa,
        np.full(n, 2.0) if callable(kappa) else lambda points: np.full(len(points), 2.0),
        {first: lambda points: np.full(len(points), 3.0)},
        {tag: lambda points: np.full(len(points), 5.0) for tag in others[:1]},
    )
    x = _unknowns(subject, together, hierarchy)
    parts = [part for each in single if (part := _unknowns(subject, each, hierarchy)) is not None]
    if x is None or len(parts) < len(single):
        return
    error = gap(x, np.sum(parts, axis=0))
    require(
        error <= _CLOSE,
        "source, boundary value and flux together, as functions or arrays, give an x that differs by "
        f"{error:.1e} from the sum of the single solutions for numbers: check whether one disables another",
    )


@law("solver", draw=_tagged_meshes, examples=_EXAMPLES, when=takes_diffusion)
def further_terms_kept(subject: Subject, case: Case) -> None:
    """Reaction, Robin data, tensors and convection enter the solution, or the problem is refused."""
    problem, hierarchy = case.given
    mesh = hierarchy.fine
    assert mesh is not None
    tags, size = boundary_tags(mesh), float(np.ptp(mesh.points, axis=0).max())
    everywhere = dict.fromkeys(tags, 1.0)
    one = _unknowns(subject, Diffusion(problem.kappa, 0.0, everywhere), hierarchy)
    plain = _unknowns(subject, Diffusion(), hierarchy)
    if one is None or plain is None:
        return
    # Two problems with the solution 1, and two with another solution than −Δu = 1.
    c, alpha = 10.0 / size**2, 10.0 / size
    flow, tensor = np.full(mesh.dim, alpha), np.diag([5.0, 3.0, 4.0][: mesh.dim])
    for name, given, is_one in (
        ("reaction", Diffusion(problem.kappa, c, everywhere, reaction=c), True),
        ("robin", Diffusion(problem.kappa, 0.0, robin=dict.fromkeys(tags, (alpha, alpha))), True),
        ("a tensor kappa", Diffusion(tensor), False),
        ("convection", Diffusion(convection=flow), False),
    ):
        x = _unknowns(subject, given, hierarchy)
        # The solution 0 has no unknown apart from Dirichlet data, and so does not change.
        if x is None or not (is_one or plain.any()):
            continue
        require(
            (gap(x, one if is_one else plain) <= _CLOSE) == is_one,
            f"a problem with {name} {'whose solution is 1 has another' if is_one else 'has that of −Δu = 1'}"
            ": add the term, or refuse such problems with an OptionError",
        )


@law("solver", "discretisation", draw=plates, examples=3 * _EXAMPLES, when=takes_diffusion)
def linear_found(subject: Subject, case: Case) -> None:
    """Boundary values and fluxes give a linear solution exactly, even at a jump of κ, on rectangles."""
    problem, hierarchy, exact = case.given[0].posed
    u = _found(subject, problem, hierarchy)
    if u is not None:
        assert hierarchy.fine is not None
        remedy = (
            "Neumann data are κ ∂u/∂n, outward, and enter as their integral over a face; a cell may have "
            "several faces on the boundary; between two cells resistances (distance over κ) add up: take the "
            "harmonic mean of κ; take areas and distances from the mesh, whose local_points keep digits far "
            "from 0"
        )
        close = _ROUNDING if subject.kind == "discretisation" else _CLOSE
        require_close(u, exact(hierarchy.fine.cell_centroids), close, "at a centroid the solution", remedy)


@law("solver", "discretisation", draw=plates, examples=6, when=takes_diffusion)
def finer_is_closer(subject: Subject, case: Case) -> None:
    """For a smooth solution with a source, halving the cell size divides the error by 2.5 or more."""
    errors = []
    for cells in (36, 144):
        problem, mesh, exact = smooth_plate(case.given[0], cells)
        u = _found(subject, problem, on_levels(mesh, np.arange(cells) // 4))
        if u is None:
            return
        errors.append(float(np.abs(u - exact(mesh.cell_centroids)).max()))
    require(
        errors[1] <= max(0.4 * errors[0], 1e-4) and errors[0] < 0.5,
        f"for u = sin(πx) sin(πy) the largest error is {errors[0]:.2e} with 6 by 6 cells and "
        f"{errors[1]:.2e} with 12 by 12: the source is integrated over cells, at their centroids or by "
        "quadrature, and fluxes over faces",
    )
