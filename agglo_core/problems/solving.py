"""Solve a problem with a registered solver or a given solver object."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from inspect import signature
from typing import Any

import numpy as np

from agglo_core.arrays import Float
from agglo_core.errors import AggloError, OptionError, PluginError
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh
from agglo_core.problems.choosing import discretisation_of, require_accepted
from agglo_core.problems.diffusion import Diffusion
from agglo_core.problems.discretisation import Problem
from agglo_core.problems.linear import Linear
from agglo_core.problems.solution import Solution
from agglo_core.progress import Listener, followed, phase, unwrapped
from agglo_core.registry import Registry, default, describe
from agglo_core.registry.attribution import Member, attributed
from agglo_core.registry.construct import check_options, resolve
from agglo_core.registry.containment import shown
from agglo_core.registry.options import is_named, name_and_options
from agglo_core.suggestions import did_you_mean, suggest_keywords


@suggest_keywords()
def solve(
    on: Mesh | Hierarchy,
    problem: Problem | None = None,
    solver: str | tuple[str, Mapping[str, Any]] | Any = "polydg_mg",
    *,
    registry: Registry | None = None,
    progress: Listener | None = None,
    verbose: bool = False,
    **options: Any,
) -> Solution:
    """Solve a problem on a mesh or on the levels of a hierarchy.

    Parameters
    ----------
    on : Mesh or Hierarchy
        On a mesh, the solver builds levels if it can.
    problem : Problem, optional
        Default: ``Diffusion()``, that is −Δu = 1 with u = 0 on the boundary.
    solver : str, tuple or object
        Solver name, name with options, or an object with ``solve(problem, hierarchy)``.
    registry : Registry, optional
        Registry of names. Default: the installed plugins.
    progress, verbose : optional
        As in :func:`agglo_core.agglomerate`.
    **options
        Solver options, such as ``degree=2`` or ``tolerance=1e-8``.

    Returns
    -------
    Solution
        Check ``converged`` and ``reason``: a solver that stops early raises no error.

    Raises
    ------
    OptionError
        If the solver does not accept the problem or an option, or needs a hierarchy instead of a mesh.
    PluginError
        If the solver cannot be used, or fails.

    Examples
    --------
    >>> mesh = agglo.samples.voronoi(120, seed=1)
    >>> solution = agglo.solve(mesh, agglo.Diffusion(source=8.0), degree=1)
    >>> solution.converged, solution.x.shape
    (True, (360,))
    >>> solution.levels
    level  unknowns  entries
        0       360     6822
        1       155     2667
    """
    hierarchy = hierarchy_of(on, "solve")
    problem = Diffusion() if problem is None else problem
    if isinstance(problem, type) or not hasattr(problem, "kind"):
        raise OptionError(
            "a problem must be an object such as Diffusion(source=1.0) or Linear(A, b), given "
            f"{shown(problem)}"
        )
    member = solver_member(solver, options, registry, solve)
    require_accepted(member.tool, problem, member.title)
    if hierarchy is not on and getattr(member.tool, "needs_levels", True):
        raise OptionError(
            f"{member.title} requires levels: give agglo.agglomerate(mesh, n_parts=…) instead of the mesh"
        )
    with followed(progress, verbose) as listen:
        return run_solver(member, problem, hierarchy, listen)


def hierarchy_of(on: Any, caller: str) -> Hierarchy:
    """Return a hierarchy as it is, or a hierarchy without levels for a mesh."""
    if isinstance(on, Hierarchy):
        return on
    if not isinstance(on, Mesh):
        given = shown(on)
        if hasattr(on, "tocsr"):
            given = "a sparse matrix: write build_levels(A).solve(b)"
        elif isinstance(on, Linear):
            given = "a linear system: without a mesh write build_levels(A).solve(b)"
        elif isinstance(on, tuple | list | np.ndarray):
            given = type(on).__name__
        raise OptionError(f"{caller} expects a Mesh or a Hierarchy first, given {given}")
    return Hierarchy(on, on.graph, [], [], nested=True)


def solver_member(
    solver: Any, options: Mapping[str, Any], registry: Registry | None, caller: Callable[..., Any]
) -> Member:
    """Return a solver built by name, or a given object after a check for its method ``solve``.

    Error messages also suggest the keywords of the ``caller``.
    """
    keywords = signature(caller).parameters
    if is_named(solver):
        name, spec_options = name_and_options("solver", solver)
        source = default() if registry is None else registry
        record = source.record("solver", name)
        checked = check_options(record, resolve(record), {**spec_options, **options}, also=keywords)
        return Member(source.assemble(record, checked), describe(record))
    if isinstance(solver, type) or not callable(getattr(solver, "solve", None)):
        raise OptionError(f"{solver!r} is not a solver: expected a name or an object with solve")
    if options:
        given = ", ".join(name + did_you_mean(name, keywords) for name in options)
        raise OptionError(f"options apply only to solvers given by name; given {given} with a solver object")
    return Member(solver, f"solver {type(solver).__name__}")


def initial_unknowns(u0: Any, how: Any, mesh: Mesh, n: int) -> Float:
    """Return the unknowns ``(n,)`` of initial values, projected unless they are a solution on the mesh.

    Raises
    ------
    OptionError
        If the solution has another mesh or degree.
    """
    if not isinstance(u0, Solution):
        return np.asarray(how.project(mesh, u0), float)
    other = u0.mesh
    is_same = other is mesh or (
        other is not None
        and np.array_equal(other.points, mesh.points)
        and np.array_equal(other.face_cells, mesh.face_cells)
    )
    if not is_same or u0.x.shape != (n,):
        raise OptionError(
            f"u0 has {len(u0.x)} unknowns on {other}, expected {n} on {mesh}; Solution.transfer projects a "
            "solution onto another cut"
        )
    return u0.x


def run_solver(
    solver: Member,
    problem: Problem,
    hierarchy: Hierarchy,
    progress: Listener | None = None,
    start: Float | None = None,
) -> Solution:
    """Run a solver, with progress reports if it supports them (``reports_progress``).

    The initial guess ``start (n,)`` is passed to solvers with ``takes_start``, and otherwise ignored.

    Problem, discretisation and mesh are added to the solution where the solver leaves them out.

    Raises
    ------
    AggloError
        Errors that the solver raises on purpose.
    PluginError
        For any other exception, or a result other than a Solution.
    """
    how = discretisation_of(solver.tool, problem)
    with unwrapped(progress) as listen, attributed(solver.title, spare=(AggloError,)):
        guess = {"start": start} if start is not None and getattr(solver.tool, "takes_start", False) else {}
        if getattr(solver.tool, "reports_progress", False):
            solution = solver.tool.solve(problem, hierarchy, progress=listen, **guess)
        else:
            with phase(listen, "solving"):
                solution = solver.tool.solve(problem, hierarchy, **guess)
    if not isinstance(solution, Solution):
        raise PluginError(f"{solver.title}: solve returned {shown(solution)}, expected a Solution")
    meaning = {"problem": problem, "discretisation": how, "mesh": None if how is None else hierarchy.fine}
    missing = {name: value for name, value in meaning.items() if getattr(solution, name) is None}
    interpreted = copy(solution)  # dataclasses.replace would compute the deferred fields
    vars(interpreted).update(missing)
    return interpreted
