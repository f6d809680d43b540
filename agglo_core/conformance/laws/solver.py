"""Laws for solvers that hold for any discretisation: solutions, histories, levels, preconditioners.

The laws only use the linear system that the solver returns.
"""

from __future__ import annotations

import numbers
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float
from agglo_core.conformance.base import Broken, Case, Subject, law, require
from agglo_core.conformance.inputs.cases import with_problem
from agglo_core.conformance.inputs.drawn import DrawnMesh
from agglo_core.conformance.inputs.problem_strategies import linear_cases, solver_cases
from agglo_core.conformance.inputs.solver_answers import (
    direct,
    gap,
    matrix_of,
    option_named,
    solve,
    solve_unless_refused,
    takes,
)
from agglo_core.conformance.inputs.solver_cases import (
    DEFINITE,
    ORDINARY,
    UNDEFINED,
    UNLIKE_DIFFUSION,
    DrawnProblem,
    times,
)
from agglo_core.conformance.laws.multigrid_parts import require_linear_and_symmetric
from agglo_core.errors import AggloError
from agglo_core.problems import Diffusion, Linear, Solution
from agglo_core.problems.iteration_history import TESTS
from agglo_core.problems.residuals.backward_error import LIMIT, backward_error

_EXAMPLES = 15  # drawn problems for each law
_CLOSE = 1e-4  # distinguishes wrong from unfinished: each solver stops at a tolerance of its own
_TOLERANCE = ("tolerance", "tol", "rtol", "relative_tolerance")
_MOST = ("max_iterations", "maxiter", "max_iter", "iterations", "most", "max_cycles", "cycles")


def _settings(subject: Subject) -> list[Mapping[str, Any]]:
    """Return the options for which a solver stops early or late, besides the defaults."""
    tolerance, most = option_named(subject, *_TOLERANCE), option_named(subject, *_MOST)
    settings: list[Mapping[str, Any]] = [{tolerance: value} for value in (1e-4, 1e-10) if tolerance]
    return settings + [{most: value} for value in (1, 2, 3, 5) if most]


def _any_problems(subject: Subject) -> Any:
    """Draw any problems, with default options in half of the cases."""
    sorts = (*ORDINARY, *DEFINITE, *UNLIKE_DIFFUSION, *UNDEFINED)
    settings = _settings(subject)
    return solver_cases(subject, sorts, [{}] * max(len(settings), 1) + settings)


def _fixed(subject: Subject) -> list[Case]:
    """Return a singular system where factorisations succeed by rounding, and large systems."""
    large = DrawnProblem(DrawnMesh(cells=1024), "slightly nonsymmetric", "grown", 64, levels=2)
    singular = DrawnProblem(DrawnMesh(cells=64), "singular", "grown", 16)
    return [singular.case, large.case, replace(large, sort="uneven").case]


@law("solver", draw=solver_cases, examples=_EXAMPLES)
def solution_record(subject: Subject, case: Case) -> None:
    """The Solution has x and b of equal length, a square A, iterations + 1 residuals and linked levels."""
    it = solve(subject, case)
    n = len(it.x)
    shapes = np.shape(it.A), np.shape(it.b)
    require(shapes == ((n, n), (n,)), f"x has {n} entries, A and b the shapes {shapes}")
    require(
        isinstance(it.converged, bool | np.bool_) and isinstance(it.reason, str),
        f"converged is {it.converged!r} and reason {it.reason!r}: expected bool and str",
    )
    require(
        isinstance(it.iterations, numbers.Integral) and len(it.residuals) == it.iterations + 1,
        f"{len(it.residuals)} residuals for {it.iterations} iterations: expected the initial residual, then "
        "one for each iteration",
    )
    require(
        np.isfinite(it.residuals).all() and np.min(it.residuals) >= 0.0,
        f"residuals are {np.asarray(it.residuals)[:4]}: norms must be finite and nonnegative",
    )
    require(
        all(isinstance(s, numbers.Real) and s >= 0.0 for s in it.seconds.values()),
        f"seconds are {it.seconds!r:.60}, expected numbers by name",
    )
    # Operators are pairs (A, P), finest first; P prolongs from the next level.
    for level, ((A, P), (coarse, _)) in enumerate(pairwise(it.operators)):
        shape = np.shape(A)[0], np.shape(coarse)[0]
        require(
            np.shape(A) == (shape[0], shape[0]) and np.shape(P) == shape,
            f"level {level} has A of shape {np.shape(A)} and P of shape {np.shape(P)}, expected a square "
            f"matrix and {shape}",
        )


@law("solver", draw=solver_cases, examples=_EXAMPLES)
def solves(subject: Subject, case: Case) -> None:
    """Ordinary problems, also on disconnected meshes, converge to the solution of the returned system."""
    it = solve(subject, case)
    require(it.converged, f"not converged ({it.reason}) on a tiny problem")
    error = gap(it.x, direct(it))
    require(
        error <= _CLOSE,
        f"x differs from the direct solution of A x = b by {error:.1e}: check the preconditioner and the "
        "convergence test",
    )


@law(
    "solver",
    draw=linear_cases,
    fixed=_fixed,
    examples=2 * _EXAMPLES,
    when=lambda subject: takes(subject, Linear),
)
def given_system_kept(subject: Subject, case: Case) -> None:
    """A linear system, even nonsymmetric, indefinite or of unequal blocks, is solved as given, or refused."""
    problem = case.given[0]
    it = solve_unless_refused(subject, case) if isinstance(problem, Linear) else None
    if it is None:
        return
    probe = np.cos(np.arange(len(problem.b)))
    require(
        np.shape(it.x) == np.shape(problem.b)
        and gap(it.A @ probe, problem.A @ probe) <= 1e-9
        and gap(it.b, problem.b) <= 1e-9,
        "A and b of the Solution are not those given: use the whole matrix and undo scaling, or raise an "
        "AggloError if the method cannot solve it",
    )


@law("solver", draw=_any_problems, fixed=_fixed, examples=5 * _EXAMPLES)
def claims_hold(subject: Subject, case: Case) -> None:
    """The last residual is that of x, and claimed convergence is true, even on hard problems."""
    try:
        it = solve_unless_refused(subject, case)
    except Broken as fault:
        if fault.__cause__ is None:
            raise
        return  # an exception claims nothing; other laws forbid it on ordinary problems
    if it is None:
        return
    last = it.residuals[-1] if len(it.residuals) else np.inf
    size, true = (float(np.linalg.norm(v)) for v in (it.b, it.b - it.A @ it.x))
    A = case.given[0].A if isinstance(case.given[0], Linear) else it.A
    terms = np.linalg.norm(abs(A) @ np.abs(it.x)) if sparse.issparse(A) else 0.0
    rounding = 1e-8 * size + 1e-14 * terms  # residuals depend on the order of their sums
    require(
        not np.isfinite(true) or abs(last - true) <= rounding + 0.01 * true,
        f"the last residual is {last:.3e}, b − A x has {true:.3e}: recompute it from the returned x and the "
        "given matrix; the recursively updated residual, the preconditioned one and that of the best "
        "iterate are different numbers",
    )
    if not it.converged:
        require(isinstance(it.reason, str) and it.reason, "not converged, but the reason is empty")
        return
    tolerance = next((value for value in case.options.values() if value < 1.0), None)
    if tolerance is not None or isinstance(case.given[0], Linear):
        error, most = true / max(size, 1e-300), 100.0 * (tolerance or 1e-6)
        what = "‖b − A x‖ / ‖b‖ is"
    else:
        error, most = gap(it.x, direct(it)), 1e-2  # looser than any sensible tolerance
        what = "x differs from the direct solution of A x = b by"
    require(
        error <= most,
        f"it reports convergence, but {what} {error:.1e}: compare b − A x itself with the tolerance after "
        "the last iteration; a comparison with NaN must not pass",
    )


@law(
    "solver",
    draw=lambda subject: solver_cases(subject, options=_settings(subject)),
    examples=_EXAMPLES,
    when=lambda subject: bool(_settings(subject)),
)
def history_recorded(subject: Subject, case: Case) -> None:
    """Runs that stop early or late have the same residual history, with an entry per iteration."""
    usual, other = solve(subject, replace(case, options={})), solve_unless_refused(subject, case)
    if other is None:
        return
    require(
        1 not in case.options.values() or other.converged or other.iterations == 1 or not np.any(other.x),
        f"it reports {other.iterations} iterations: the initial residual does not count as an iteration",
    )
    common = min(len(usual.residuals) - 1, len(other.residuals) - 1, 2)  # without the last one
    require(
        np.allclose(usual.residuals[:common], other.residuals[:common], rtol=0.5),
        f"the history begins with {other.residuals[:2]}, without the option with {usual.residuals[:2]}: "
        "record the residuals during the iteration",
    )


@law("solver", draw=solver_cases, examples=_EXAMPLES // 2)
def scales_with_the_data(subject: Subject, case: Case) -> None:
    """Factors of matrix and data scale the solution and the residual history, and zero data give 0."""
    if not isinstance(case.given[0], Diffusion | Linear):
        return
    unscaled = solve(subject, case)
    for matrix, data in ((1.0, 2.0**20), (2.0**-8, 2.0**-20), (2.0, 1.0), (1.0, 0.0)):
        it = solve(subject, _scaled(case, matrix, data))
        description = f"on {case.name} with the matrix times {matrix:g}, the right-hand side times {data:g}"
        error = gap(it.x * matrix, unscaled.x * data)
        require(
            it.converged and error <= _CLOSE,
            f"{description}: converged is {it.converged} ({it.reason}), x is off by {error:.1e}: compare "
            "the residual with the tolerance times the norm of b, not with a fixed number, and divide by "
            "this norm only if it is nonzero",
        )
        common = min(len(it.residuals), len(unscaled.residuals))
        residuals, expected = (
            factor * np.asarray(each.residuals[:common]) for factor, each in ((1.0, it), (data, unscaled))
        )
        clear = expected >= 1e-9 * expected[0]  # rounding dominates below
        require(
            np.allclose(residuals[clear], expected[clear], rtol=1e-2),
            f"{description}: the residuals are {residuals[:3]}, expected {expected[:3]}: report the 2-norm "
            "of b − A x, not a relative, preconditioned or estimated one",
        )


def _scaled(case: Case, matrix: float, data: float) -> Case:
    """Multiply matrix and right-hand side of the problem in a test case by constants."""
    problem = case.given[0]
    if isinstance(problem, Linear):
        return with_problem(case, A=matrix * problem.A, b=data * problem.b)
    return with_problem(case, kappa=times(problem.kappa, matrix), source=times(problem.source, data))


@law(
    "solver",
    draw=lambda subject: solver_cases(subject, ORDINARY[1:]),
    examples=5,
    when=lambda subject: takes(subject, Linear),
)
def columns_solved(subject: Subject, case: Case) -> None:
    """Several right-hand sides, of unlike size, are each solved if converged is set, or else refused."""
    if not isinstance(case.given[0], Linear):
        return
    b = case.given[0].b
    columns = np.stack((b, 1e-6 * b[::-1]), axis=1)
    try:
        it = solve(subject, with_problem(case, b=columns))
    except Broken:
        return
    if it.converged:
        left = [gap(it.A @ x, column) for x, column in zip(np.atleast_2d(it.x.T), columns.T, strict=True)]
        require(
            np.shape(it.x) == columns.shape and max(left) <= _CLOSE,
            f"on {case.name} with two right-hand sides, the second a million times smaller, it reports "
            f"convergence, but ‖b − A x‖ / ‖b‖ is {left}: test each column by itself, or refuse more than "
            "one",
        )


@law("solver", draw=solver_cases, examples=_EXAMPLES)
def told_error_holds(subject: Subject, case: Case) -> None:
    """Reported energy errors and rounding limits are true for the returned x, and tests have known names."""
    it = solve(subject, case)
    require(set(it.tests) <= set(TESTS), f"tests are {it.tests!r:.80}, expected some of {TESTS}")
    if it.energy_error is not None and it.lifting is None:
        error = _energy_error(it)
        require(
            error <= 10.0 * it.energy_error + 1e-10,  # an estimate; the direct solution is no more accurate
            f"it reports an energy error of {it.energy_error:.1e}, that of x is {error:.1e}: estimate it "
            "from the residual of x, or leave it None",
        )
    if it.rounding_limited:
        x, load = (it.x, it.b) if it.lifting is None else (it.lifting.rest, it.lifting.load)
        true = backward_error(matrix_of(it.A), x, load)
        require(
            not it.converged and true is not None and true <= LIMIT,
            f"rounding_limited is set, converged is {it.converged} and the backward error {true}: set it "
            f"only if x misses the tolerance with a backward error below {LIMIT:.0e}",
        )


def _energy_error(it: Solution) -> float:
    exact = direct(it)
    e = it.x - exact
    square, size = float(e @ (it.A @ e)), float(exact @ (it.A @ exact))
    return float(np.sqrt(max(square, 0.0) / size)) if size > 0.0 else 0.0


@law(
    "solver",
    draw=lambda subject: solver_cases(subject, (*ORDINARY, *DEFINITE, *UNLIKE_DIFFUSION)),
    examples=2 * _EXAMPLES,
    when=lambda subject: getattr(subject.build(), "galerkin", True),
)
def coarse_operators_inherited(subject: Subject, case: Case) -> None:
    """The matrix of each coarser level is Pᵀ A P, including small entries, unless galerkin = False."""
    it = solve_unless_refused(subject, case)
    for level, ((A, P), (coarse, _)) in enumerate(pairwise([] if it is None else it.operators)):
        A, P, coarse = matrix_of(A), matrix_of(P), matrix_of(coarse)
        # Relative to the sizes of the terms in the diagonal entries.
        unit = np.sqrt(np.maximum((abs(P).T @ abs(A) @ abs(P)).diagonal(), 1e-300))
        error = float((np.abs((P.T @ A @ P - coarse).toarray()) / unit / unit[:, None]).max(initial=0.0))
        require(
            error <= 1e-8,
            f"the matrix of level {level + 1} is not Pᵀ A P, off by {error:.1e}: return the P that was "
            "used, and drop no small entries; set galerkin = False if levels are rediscretised",
        )


@law(
    "solver",
    draw=lambda subject: solver_cases(subject, (*ORDINARY, *DEFINITE)),
    examples=_EXAMPLES,
    promise="symmetric",
)
def symmetric(subject: Subject, case: Case) -> None:
    """The preconditioner from aspreconditioner(problem, hierarchy) is linear, symmetric and definite."""
    tool, it = subject.build(), solve_unless_refused(subject, case)
    require(
        callable(getattr(tool, "aspreconditioner", None)),
        "it promises symmetric but has no method aspreconditioner(problem, hierarchy) that returns a "
        "scipy.sparse.linalg.LinearOperator",
    )
    if it is None:
        return
    try:
        operator = tool.aspreconditioner(*case.given)
    except AggloError:
        return
    # Scaled so that A has a unit diagonal.
    unit = np.sqrt(np.abs(matrix_of(it.A).diagonal()))

    def scaled(v: Float) -> Float:
        return np.asarray(unit * np.ravel(operator @ (unit * v)))

    remedy = (
        "use no step length that depends on the residual and no inner iteration that stops by a tolerance, "
        "or drop the promise symmetric"
    )
    require_linear_and_symmetric(len(unit), scaled, remedy, rounding=1e-6)
    M = np.stack([scaled(column) for column in np.eye(len(unit))], axis=1)
    least = float(np.linalg.eigvalsh((M + M.T) / 2)[0] / np.abs(M).max())
    require(
        least > -1e-9,
        f"M is not positive definite, its smallest eigenvalue is {least:.1e} times its largest entry: damp "
        "a Jacobi step by a factor below 2 / λ_max(D⁻¹A); λ_max may exceed 2",
    )
