"""Evolution in time: implicit steps of diffusion and elasticity, with explicit nonlinear reactions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from copy import copy
from dataclasses import replace
from numbers import Real
from typing import Any, Literal, NamedTuple

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.errors import AggloError, OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh
from agglo_core.problems.choosing import discretisation_for
from agglo_core.problems.diffusion import Diffusion
from agglo_core.problems.discretisation import Discretisation, Field, Quadrature
from agglo_core.problems.elasticity import Elasticity, VectorField
from agglo_core.problems.solution import Solution
from agglo_core.problems.solving import hierarchy_of, initial_unknowns, solver_member
from agglo_core.registry import Registry
from agglo_core.registry.attribution import Member, attributed
from agglo_core.registry.containment import shown
from agglo_core.suggestions import suggest_keywords

Scheme = Literal["be", "cn", "bdf2", "newmark"]
"""Backward Euler, Crank–Nicolson, backward differentiation of order 2, or Newmark for ∂²u/∂t²."""
Evolving = Diffusion | Elasticity
"""Problem with a reaction, to which steps add the mass matrix."""
Reaction = Callable[[float, Float, Float], Float]
"""Function of time, points ``(q, d)`` and values ``(q,)`` of u, with values ``(q,)``."""

_SCHEMES = ("be", "cn", "bdf2", "newmark")
_ROUNDING = 1e-9  # of the number of steps


@suggest_keywords()
def evolve(
    on: Mesh | Hierarchy,
    problem: Evolving | Callable[[float], Evolving],
    u0: Field | VectorField | Solution,
    t_end: float,
    step: float,
    scheme: Scheme = "cn",
    *,
    reaction: Reaction | None = None,
    velocity: Field | VectorField | None = None,
    solver: str | tuple[str, Mapping[str, Any]] | Any = "polydg_mg",
    registry: Registry | None = None,
    **options: Any,
) -> Iterator[tuple[float, Solution]]:
    """Solve ∂u/∂t − ∇·(κ∇u) + c u = f + r(t, x, u) by implicit steps from t = 0, explicit in r.

    With an Elasticity −div σ(u) takes the place of −∇·(κ∇u). The scheme "newmark" solves equations with
    ∂²u/∂t² instead of ∂u/∂t: waves, and elastodynamics with density 1 (divide data by a constant density).

    Matrix, multigrid levels or factors, and earlier solutions are reused. Each step solves the problem with
    a larger reaction c, which is the mass matrix.

    Parameters
    ----------
    on : Mesh or Hierarchy
    problem : Diffusion or Elasticity, or function of t that returns one
        A problem must not change in time. With a function of t, the matrix is reused if only source and
        boundary values change, and coefficients are numbers or cell values.
    u0 : Field, VectorField or Solution
        Initial values.
    t_end : float
    step : float
        Largest step. It is reduced so that equal steps end at ``t_end``.
    scheme : "be", "cn", "bdf2" or "newmark"
        Backward Euler (order 1); Crank–Nicolson (order 2), as a midpoint rule, which does not damp jumps
        between initial and boundary values; BDF2 (order 2), which damps, with a first step by "be"; or
        Newmark's method with constant mean acceleration (order 2), which preserves energy.
    reaction : callable, optional
        r(t, points, u), called once per step with u at the start of the step at all quadrature points,
        always in the same order. It may therefore keep further variables for each point, such as the gates
        of an ionic model. Schemes of order 2 extrapolate r. Steps must be short enough for an explicit
        method applied to r alone. Not for Elasticity.
    velocity : Field or VectorField, optional
        Initial ∂u/∂t, for "newmark"; 0 by default.
    solver, registry, **options
        As for :func:`solve`. The solver must have ``repeated(hierarchy)``, as ``polydg_mg`` and ``direct``
        have. ``tolerance`` holds for each step, and errors of steps add up.

    Yields
    ------
    (float, Solution)
        Time and solution after each step. ``A``, ``b`` and the report belong to the system of the step; for
        "cn" its unknown is the mean of u at both ends.

    Raises
    ------
    OptionError
        For invalid arguments, a problem or solver that does not fit, or a step that does not converge.

    Examples
    --------
    >>> import numpy as np
    >>> mesh, heat = agglo.samples.squares(8), agglo.Diffusion(source=0.0)
    >>> sine = lambda x: np.sin(np.pi * x).prod(axis=1)
    >>> states = agglo.evolve(mesh, heat, sine, t_end=0.1, step=0.01, degree=2)
    >>> sizes = {round(t, 2): round(solution.integral(), 2) for t, solution in states}
    >>> sizes[0.01], sizes[0.1]  # 4/π² exp(−2π² t)
    (0.33, 0.06)
    """
    # 1. Check the arguments
    if scheme not in _SCHEMES:
        raise OptionError(f"scheme must be one of {', '.join(_SCHEMES)}; given {scheme!r}")
    for name, value in (("t_end", t_end), ("step", step)):
        if not (isinstance(value, Real) and np.isfinite(value) and value > 0.0):
            raise OptionError(f"{name} must be a positive number, given {value!r}")
    if scheme != "newmark" and velocity is not None:
        raise OptionError(f"velocity is for the scheme newmark, not for {scheme!r}")
    hierarchy = hierarchy_of(on, "evolve")
    member = solver_member(solver, options, registry, evolve)
    if not hasattr(member.tool, "repeated"):
        raise OptionError(f"{member.title} has no method repeated(hierarchy), which time steps require")
    mesh, how = hierarchy.fine, getattr(member.tool, "discretisation", None)
    how = discretisation_for(how, _evolving(problem, 0.0))
    missing = ["mass"] if reaction is None else ["mass", "quadrature"]
    missing = [name for name in missing if not hasattr(how, name)]
    if how is None or mesh is None or missing:
        raise OptionError(f"{member.title} has no discretisation with {' and '.join(missing) or 'a mesh'}")
    # 2. Set up
    count = max(1, math.ceil(t_end / step - _ROUNDING))
    steps = _Steps(member, hierarchy, how, mesh, problem, reaction)
    start = initial_unknowns(u0, how, mesh, steps.mass.shape[0])
    speed = how.project(mesh, 0.0 if velocity is None else velocity) if scheme == "newmark" else None
    return _states(steps, start, speed, t_end / count, count, scheme)


class _Formula(NamedTuple):
    """One step: (rate M + A) v = M w + load(at), explicit terms added, where u = v, or 2v − u if ``middle``.

    ``history`` and ``explicit`` are the weights of the latest and the previous u and r. For "newmark" w has
    the velocity instead of the previous u.
    """

    rate: float
    history: tuple[float, float]
    explicit: tuple[float, float]
    at: float
    middle: bool = False


def _formula(scheme: Scheme, k: int, step: float) -> _Formula:
    """Return the formula of step k, counted from 0."""
    latest = (1.0, 0.0) if k == 0 else (1.5, -0.5)
    if scheme == "cn":
        return _Formula(2.0 / step, (2.0 / step, 0.0), latest, (k + 0.5) * step, middle=True)
    if scheme == "newmark":
        return _Formula(4.0 / step**2, (4.0 / step**2, 2.0 / step), latest, (k + 0.5) * step, middle=True)
    if scheme == "be" or k == 0:
        return _Formula(1.0 / step, (1.0 / step, 0.0), (1.0, 0.0), (k + 1) * step)
    return _Formula(1.5 / step, (2.0 / step, -0.5 / step), (2.0, -1.0), (k + 1) * step)


def _states(
    steps: _Steps, u: Float, velocity: Float | None, step: float, count: int, scheme: Scheme
) -> Iterator[tuple[float, Solution]]:
    before = u if velocity is None else velocity
    force = force_before = steps.force(0.0, u)
    for k in range(count):
        formula, t = _formula(scheme, k, step), (k + 1) * step
        load = steps.mass @ (formula.history[0] * u + formula.history[1] * before)
        if force is not None and force_before is not None:
            load += formula.explicit[0] * force + formula.explicit[1] * force_before
        solution = steps.solve(formula, load)
        if not (solution.converged or solution.rounding_limited):
            raise OptionError(
                f"step {k + 1}, to t = {t:g}, did not converge: {solution.reason}; choose a larger tolerance "
                "or more iterations"
            )
        following = 2.0 * solution.x - u if formula.middle else solution.x
        before = u if velocity is None else 2.0 / step * (following - u) - before
        u = following
        yield t, steps.labelled(solution, u, t)
        if k + 1 < count:
            force_before, force = force, steps.force(t, u)


class _Steps:
    """Problem and solver of an evolution, with the parts that all steps share."""

    def __init__(
        self,
        member: Member,
        hierarchy: Hierarchy,
        how: Discretisation,
        mesh: Mesh,
        problem: Evolving | Callable[[float], Evolving],
        reaction: Reaction | None,
    ) -> None:
        self._title, self._problem, self._reaction = member.title, problem, reaction
        self.mesh, self.how = mesh, how
        with self._attributed():
            self._solver = member.tool.repeated(hierarchy)
            self.mass = how.mass(mesh)  # type: ignore[attr-defined]
            self._rule: Quadrature | None = None if reaction is None else how.quadrature(mesh)  # type: ignore[attr-defined]
        self._solved: tuple[Evolving, float] | None = None

    def _attributed(self) -> Any:
        return attributed(self._title, spare=(AggloError,))

    def problem(self, t: float) -> Evolving:
        """Return the problem at a time."""
        return _evolving(self._problem, t)

    def force(self, t: float, u: Float) -> Float | None:
        """Return the load ``(n,)`` of the explicit reaction, None without one."""
        if self._reaction is None or self._rule is None:
            return None
        points, weights, values = self._rule
        at_points = np.asarray(self._reaction(t, points, frozen_float(values @ u)), float)
        if at_points.shape not in ((), weights.shape) or not np.isfinite(at_points).all():
            raise OptionError(
                f"reaction must return {weights.shape} finite numbers, one per point; at t = {t:g} it "
                f"returned {shown(at_points)}"
            )
        return np.asarray(values.T @ (weights * at_points))

    def solve(self, formula: _Formula, load: Float) -> Solution:
        """Solve the system of a step."""
        problem = self.problem(formula.at)
        with self._attributed():
            if self._solved == (problem, formula.rate) and not callable(self._problem):
                solution: Solution = self._solver.solve_again(load)
            else:
                self._solved = problem, formula.rate
                solution = self._solver.solve(_with_rate(problem, formula.rate), load=load)
        return solution

    def labelled(self, solution: Solution, u: Float, t: float) -> Solution:
        """Return the solution of a step with the unknowns u and the problem at time t."""
        state = copy(solution)  # dataclasses.replace would compute the deferred fields
        meaning = {"problem": self.problem(t), "discretisation": self.how, "mesh": self.mesh}
        vars(state).update(meaning, x=frozen_float(u), lifting=None)
        return state


def _evolving(problem: Any, t: float) -> Evolving:
    """Return the problem at a time, or raise OptionError if it has no reaction."""
    now = problem(t) if callable(problem) else problem
    if not isinstance(now, Evolving):
        raise OptionError(
            "problem must be a Diffusion or an Elasticity, or a function of t that returns one; given "
            f"{shown(now)}"
        )
    return now


def _with_rate(problem: Evolving, rate: float) -> Evolving:
    """Return the problem with ``rate`` added to the reaction, and without exact solution."""
    given = problem.reaction
    if callable(given) and isinstance(problem, Diffusion):
        return replace(problem, reaction=lambda points: rate + np.asarray(given(points)), exact=None)
    total = rate + np.asarray(given, float)
    return replace(problem, reaction=total if total.ndim else float(total), exact=None)
