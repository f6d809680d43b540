"""Laws for solvers that hold for any discretisation: solutions, histories, levels.

The laws only use the linear system that the solver returns.
"""

from __future__ import annotations

import numbers
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator

from agglo_core.arrays import Float
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.cases import cases, laplacian, with_problem
from agglo_core.conformance.inputs.questions import plain, select_accepted
from agglo_core.conformance.inputs.solver_answers import (
    cases_with_3d,
    direct,
    first_case,
    gap,
    matrix_of,
    option_named,
    solve,
    solve_unless_refused,
)
from agglo_core.conformance.inputs.solver_cases import (
    awkward_cases,
    definite,
    halves,
    ill_conditioned,
    plate,
    rising_residual_system,
    uneven,
    unlike_diffusion,
)
from agglo_core.errors import AggloError
from agglo_core.problems import Diffusion, Linear, Solution
from agglo_core.problems.iteration_history import TESTS
from agglo_core.problems.residuals.backward_error import LIMIT, backward_error

_CLOSE = 1e-4  # distinguishes wrong from unfinished: each solver stops at a tolerance of its own


@law("solver")
def solution_record(subject: Subject) -> None:
    """The Solution has x and b of equal length, a square A, and iterations + 1 residuals."""
    for case in cases_with_3d(subject):
        it = solve(subject, case)
        # Shapes, types and number of residuals, in this order.
        n = len(it.x)
        require(
            np.shape(it.A) == (n, n) and np.shape(it.b) == (n,),
            f"on {case.name}: x has {n} entries, A the shape {np.shape(it.A)}, b {np.shape(it.b)}",
        )
        require(
            isinstance(it.converged, bool | np.bool_) and isinstance(it.reason, str),
            f"on {case.name}: converged is {it.converged!r} and reason {it.reason!r}: expected bool and str",
        )
        require(
            isinstance(it.iterations, numbers.Integral) and len(it.residuals) == it.iterations + 1,
            f"on {case.name}: {len(it.residuals)} residuals for {it.iterations} iterations: expected the "
            "initial residual, then one for each iteration",
        )
        require(
            np.isfinite(it.residuals).all() and np.min(it.residuals) >= 0.0,
            f"on {case.name}: residuals are {np.asarray(it.residuals)[:4]}: norms must be finite and "
            "nonnegative",
        )
        require(
            all(isinstance(s, numbers.Real) and s >= 0.0 for s in it.seconds.values()),
            f"on {case.name}: seconds are {it.seconds!r:.60}, expected numbers by name",
        )


@law("solver")
def solves(subject: Subject) -> None:
    """Small problems converge to the direct solution of the returned system."""
    for case in cases_with_3d(subject):
        it = solve(subject, case)
        require(it.converged, f"on {case.name}: not converged ({it.reason}) on a tiny problem")
        error = gap(it.x, direct(it))
        require(
            error <= _CLOSE,
            f"on {case.name}: x differs from the direct solution of A x = b by {error:.1e}: check the "
            "preconditioner and the convergence test",
        )


@law("solver")
def own_system_kept(subject: Subject) -> None:
    """A linear system is solved as given: x, A and b of the Solution fit the given A and b."""
    for case in cases_with_3d(subject):
        problem = case.given[0]
        if isinstance(problem, Linear):
            it = solve(subject, case)
            x = it.x
            require(np.shape(x) == np.shape(problem.b), f"on {case.name}: x has shape {np.shape(x)}")
            residual = gap(problem.A @ x, problem.b)
            require(
                residual <= _CLOSE,
                f"on {case.name}: x leaves a residual of {residual:.1e} in the system given: undo any "
                "scaling or reordering before returning",
            )
            require(
                gap(it.b, problem.b) <= 1e-9 and gap(it.A @ x, problem.A @ x) <= 1e-9,
                f"on {case.name}: A and b of the Solution are not those of the system: undo scaling, "
                "because residuals and energy are computed from them",
            )


@law("solver", when=lambda subject: bool(first_case(subject, Linear)))
def columns_solved(subject: Subject) -> None:
    """Several right-hand sides, of unlike size, are each solved if converged is set, or else refused."""
    case = first_case(subject, Linear)[0]
    b = case.given[0].b
    columns = np.stack((b, 1e-6 * b[::-1]), axis=1)
    try:
        it = solve(subject, with_problem(case, b=columns))
    except Broken:
        return
    if it.converged:
        remainders = [
            gap(it.A @ x, column) for x, column in zip(np.atleast_2d(it.x.T), columns.T, strict=True)
        ]
        require(
            np.shape(it.x) == columns.shape and max(remainders) <= _CLOSE,
            f"with two right-hand sides, the second a million times smaller, it reports convergence, but "
            f"‖b − A x‖ / ‖b‖ is {remainders}: test each column by itself, or refuse more than one",
        )


@law("solver")
def true_residual(subject: Subject) -> None:
    """The last residual is the 2-norm of b − A x."""
    for case in cases_with_3d(subject):
        it = solve(subject, case)
        size = float(np.linalg.norm(it.b))
        true = float(np.linalg.norm(it.b - it.A @ it.x))
        require(
            abs(it.residuals[-1] - true) <= 1e-8 * size + 0.01 * true,
            f"on {case.name}: reported {it.residuals[-1]:.3e}, b − A x has {true:.3e}: recompute it from x; "
            "the recursively updated residual and the preconditioned one are different numbers",
        )


@law("solver")
def failure_flagged(subject: Subject) -> None:
    """A problem without solution is flagged (converged=False with a reason) or refused with an AggloError."""
    _, hierarchy = cases("solver")[0].given
    graph = hierarchy.graph
    hopeless = {
        "a singular system without a solution": laplacian(graph, 1, shift=0.0),
        "a right-hand side with NaN": Linear(
            laplacian(graph, 1).A, np.full(graph.n, np.nan), np.arange(graph.n + 1)
        ),
        "a source of NaN": Diffusion(source=np.nan),
    }
    for name, problem in hopeless.items():
        try:
            it = solve(subject, Case(name, (problem, hierarchy)))
        except Broken as error:
            if isinstance(error.__cause__, AggloError):
                continue
            raise
        require(
            not it.converged and it.reason,
            f"on {name}: converged={it.converged}, reason {it.reason!r}: compare the true residual with the "
            "tolerance first; a comparison with NaN must not pass",
        )


@law("solver")
def operators_chain(subject: Subject) -> None:
    """Operators, if any, are pairs (A, P), finest first: P prolongs from the next level (last: None)."""
    for case in cases_with_3d(subject):
        it = solve(subject, case)
        for level, (A, P) in enumerate(it.operators):
            rows = np.shape(A)[0]
            require(
                np.shape(A) == (rows, rows),
                f"on {case.name}: A of level {level} has shape {np.shape(A)}, expected a square matrix",
            )
            if level + 1 < len(it.operators):
                shape = (rows, np.shape(it.operators[level + 1][0])[0])
                require(
                    P is not None and np.shape(P) == shape,
                    f"on {case.name}: P of level {level} has shape {P is not None and np.shape(P)}, "
                    f"expected {shape}",
                )


@law("solver")
def field_forms_agree(subject: Subject) -> None:
    """A coefficient or source has the same effect as a number, as one value per cell or as a function."""
    for case in first_case(subject, Diffusion):
        n = case.given[1].graph.n
        expected = solve(subject, with_problem(case, kappa=2.0, source=3.0)).x
        for form, kappa, source in (
            ("arrays", np.full(n, 2.0), np.full(n, 3.0)),
            ("callables", lambda x: np.full(len(x), 2.0), lambda x: np.full(len(x), 3.0)),
        ):
            x = solve(subject, with_problem(case, kappa=kappa, source=source)).x
            _require_close(
                x, expected, f"kappa and source given as {form} give a different solution than as numbers"
            )


@law("solver")
def linear_in_the_data(subject: Subject) -> None:
    """The solution is proportional to source or right-hand side, and inversely to coefficient or matrix."""
    for case in first_case(subject, Diffusion):
        x = solve(subject, case).x
        _require_close(solve(subject, with_problem(case, source=2.0)).x, 2 * x, "twice the source")
        _require_close(solve(subject, with_problem(case, kappa=2.0)).x, x / 2, "twice the coefficient")
    for case in first_case(subject, Linear):
        x, (A, b) = solve(subject, case).x, (case.given[0].A, case.given[0].b)
        _require_close(solve(subject, with_problem(case, b=2 * b)).x, 2 * x, "twice the right-hand side")
        _require_close(solve(subject, with_problem(case, A=2 * A)).x, x / 2, "twice the matrix")


@law("solver")
def disconnected_solved(subject: Subject) -> None:
    """A problem on a mesh with two connected components is solved."""
    from agglo_core.hierarchy import Hierarchy

    mesh = small_meshes.two_grids()
    labels = mesh.graph.components()
    hierarchy = Hierarchy(mesh, mesh.graph, [labels], [{"n_parts": 2}], nested=True)
    test_cases = [
        Case("two components", (problem, hierarchy)) for problem in (Diffusion(), laplacian(mesh.graph, 1))
    ]
    for case in select_accepted(subject, test_cases):
        it = solve(subject, case)
        require(it.converged, f"on two components: not converged ({it.reason})")


def _require_close(x: NDArray[np.float64], expected: Float, description: str) -> None:
    error = gap(x, expected)
    require(error <= _CLOSE, f"{description}: x is off by {error:.1e}: check where kappa and source enter")


_SAME = 1e-9


@law("solver", when=lambda subject: bool(first_case(subject, Linear)))
def given_matrix_used(subject: Subject) -> None:
    """Nonsymmetric, indefinite or unequal-block systems are solved as given, or refused."""
    for case in unlike_diffusion():
        problem = case.given[0]
        it = solve_unless_refused(subject, case.name, *case.given)
        if it is None:
            continue
        probe = np.cos(np.arange(len(problem.b)))
        require(
            np.shape(it.x) == np.shape(problem.b)
            and gap(it.A @ probe, problem.A @ probe) <= _SAME
            and gap(it.b, problem.b) <= _SAME,
            f"on {case.name}: A and b of the Solution are not those given: use the whole matrix, or raise "
            "an AggloError if the method cannot solve it",
        )
        _require_own_residual(case.name, it)
        if it.converged:
            residual = gap(problem.A @ it.x, problem.b)
            require(
                residual <= _CLOSE,
                f"on {case.name}: it reports convergence, but x leaves a residual of {residual:.1e} in the "
                "given system: compare b − A x of this matrix with the tolerance, or refuse the system",
            )


def _require_own_residual(name: str, it: Solution) -> None:
    """Require that the last residual is the norm of b − A x, unless the method broke down."""
    if np.isfinite(it.x).all() and len(it.residuals):
        size, true = (float(np.linalg.norm(v)) for v in (it.b, it.b - it.A @ it.x))
        require(
            abs(it.residuals[-1] - true) <= 1e-8 * size + 0.01 * true,
            f"on {name}: the last residual is {it.residuals[-1]:.3e}, b − A x has {true:.3e}: compute it "
            "from x and the given matrix",
        )


_TOLERANCE = ("tolerance", "tol", "rtol", "relative_tolerance")
_MOST = ("max_iterations", "maxiter", "max_iter", "iterations", "most", "max_cycles", "cycles")
_FEW = (1, 2, 3, 5)
_WRONG = 1e-2  # looser than any sensible tolerance
_NOISE = 1e-9  # relative to the first residual; rounding dominates below


def _basic_cases(subject: Subject) -> list[Case]:
    """Return a diffusion problem and a linear system with random couplings, if the solver accepts them."""
    test_cases = first_case(subject, Diffusion)
    for case in first_case(subject, Linear):
        hierarchy = case.given[1]
        width = len(case.given[0].b) // hierarchy.graph.n
        test_cases.append(Case("an uneven linear system", (uneven(hierarchy.graph, width), hierarchy)))
    return test_cases


def _hard_cases(subject: Subject) -> list[Case]:
    """Return linear systems whose residual first increases, or cannot become small."""
    hard = {
        "unknowns in different units": rising_residual_system,
        "an ill-conditioned matrix": ill_conditioned,
    }
    return [
        Case(name, (make(case.given[1]), case.given[1]))
        for case in first_case(subject, Linear)
        for name, make in hard.items()
        if case.sort == "linear"
    ]


def _scale_system(case: Case, matrix: float, data: float) -> Case:
    """Multiply matrix and right-hand side in a test case by constants."""
    problem = case.given[0]
    if isinstance(problem, Linear):
        return with_problem(case, A=matrix * problem.A, b=data * problem.b)
    return with_problem(case, kappa=matrix, source=data)


@law("solver")
def scales_with_the_system(subject: Subject) -> None:
    """Scaling the data by a power of two scales the solution and every residual of the history."""
    for case in _basic_cases(subject):
        unscaled = solve(subject, case)
        for matrix, data in ((1.0, 2.0**20), (1.0, 2.0**-20), (2.0**8, 2.0**8)):
            it = solve(subject, _scale_system(case, matrix, data))
            description = (
                f"on {case.name} with the matrix times {matrix:g}, the right-hand side times {data:g}"
            )
            error = gap(it.x * matrix / data, unscaled.x)
            require(
                it.converged == unscaled.converged and error <= _CLOSE,
                f"{description}: converged is {it.converged}, x is off by {error:.1e}: compare the residual "
                "with the tolerance times that of the right-hand side, not with a fixed number",
            )
            _require_same_history(it.residuals / data, unscaled.residuals, description)


def _require_same_history(residuals: Any, expected: Any, description: str) -> None:
    n_common = min(len(residuals), len(expected))
    residuals, expected = np.asarray(residuals)[:n_common], np.asarray(expected)[:n_common]
    clear = expected > _NOISE * expected[0]
    clear[0] = True
    require(
        np.allclose(residuals[clear], expected[clear], rtol=1e-2),
        f"{description}: the residuals divided by that factor are {residuals[:3]}, expected {expected[:3]}: "
        "report the 2-norm of b − A x, not a relative, preconditioned or estimated one",
    )


@law("solver")
def zero_from_zero(subject: Subject) -> None:
    """Zero data give the solution 0 with converged=True."""
    for case in _basic_cases(subject):
        problem = case.given[0]
        none = {"b": 0 * problem.b} if isinstance(problem, Linear) else {"source": 0.0}
        it = solve(subject, with_problem(case, **none))
        require(
            np.all(it.x == 0.0) and it.converged,
            f"on {case.name} with a right-hand side of zeros: converged is {it.converged} ({it.reason}), x "
            f"{it.x[:3]}: divide by the norm of b only if it is nonzero",
        )


@law("solver", when=lambda subject: option_named(subject, *_TOLERANCE) is not None)
def tolerance_met(subject: Subject) -> None:
    """A tolerance of 1e-4 or 1e-10 is met by every converged solution, and the residual histories agree."""
    name = str(option_named(subject, *_TOLERANCE))
    for case in [*_basic_cases(subject), *_hard_cases(subject)]:
        runs = {tolerance: _with_option(subject, case, name, tolerance) for tolerance in (1e-4, 1e-10)}
        for tolerance, it in runs.items():
            if it is not None and it.converged:
                residual = gap(it.A @ it.x, it.b)
                require(
                    residual <= 100.0 * tolerance,
                    f"on {case.name} with {name}={tolerance:g}: it reports convergence, but ‖b − A x‖ / ‖b‖ "
                    f"is {residual:.1e}: pass the option to the iteration, and compare b − A x itself",
                )
        loose, tight = runs.values()
        if loose is not None and tight is not None:
            n_common = min(len(loose.residuals) - 1, len(tight.residuals) - 1, 2)  # without the last
            require(
                np.allclose(loose.residuals[:n_common], tight.residuals[:n_common], rtol=0.5),
                f"on {case.name}: the history begins with {loose.residuals[:2]} for {name}=1e-4 and with "
                f"{tight.residuals[:2]} for 1e-10: record the residuals during the iteration",
            )


@law("solver", when=lambda subject: option_named(subject, *_MOST) is not None)
def too_few_iterations_said(subject: Subject) -> None:
    """After 1 to 5 iterations convergence is not claimed falsely, and the residual of x is reported."""
    name = str(option_named(subject, *_MOST))
    for most in _FEW:
        for case in [*_basic_cases(subject), *_hard_cases(subject)]:
            it = _with_option(subject, case, name, most)
            if it is not None:
                _require_honest(f"{case.name} with {name}={most}", it, most)


def _require_honest(name: str, it: Solution, most: int) -> None:
    _require_true_claim(name, it)
    require(
        most > 1 or it.converged or it.iterations == 1 or not np.any(it.x),
        f"on {name}: it reports {it.iterations} iterations: the initial residual does not count as an "
        "iteration",
    )
    size, true = (float(np.linalg.norm(v)) for v in (it.b, it.b - it.A @ it.x))
    require(
        abs(it.residuals[-1] - true) <= 1e-8 * size + 0.01 * true,
        f"on {name}: the last residual is {it.residuals[-1]:.3e}, that of x is {true:.3e}: report the "
        "residual of the returned x, not of the best iterate so far or of x before a final smoothing",
    )


@law("solver")
def claims_hold(subject: Subject) -> None:
    """Claimed convergence is true for rough coefficients, one part, three levels or disconnected parts."""
    for case in awkward_cases():
        plain_sort = not isinstance(case.given[0], Linear) or case.sort == "linear"
        if plain_sort or first_case(subject, Linear):
            it = solve_unless_refused(subject, case.name, *case.given)
            if it is not None:
                _require_true_claim(case.name, it)


@law("solver")
def each_solve_alone(subject: Subject) -> None:
    """Earlier solves do not change the result, even on the same hierarchy."""
    test_cases = [*_basic_cases(subject)]
    for case in first_case(subject, Diffusion):
        hierarchy = plate()
        for kappa in (halves(hierarchy, 1.0, 9.0), halves(hierarchy, 9.0, 1.0)):
            test_cases.append(replace(case, name="a plate", given=(Diffusion(kappa), hierarchy)))
    test_cases += [_scale_system(case, 3.0, 2.0) for case in test_cases[:2]] + test_cases[:1]
    tool = subject.build()
    for case in test_cases:
        fresh_solution = solve_unless_refused(subject, case.name, *case.given)
        difference = 0.0 if fresh_solution is None else gap(solve(subject, case, tool).x, fresh_solution.x)
        require(
            difference <= 1e-6,
            f"on {case.name}, after other problems: x differs by {difference:.1e} from that of a fresh "
            "solver: keep no matrix, factorisation or initial guess from the previous solve",
        )


def _with_option(subject: Subject, case: Case, name: str, value: float) -> Solution | None:
    """Solve with an option set, or return None if the solver refuses the value or the problem."""
    try:
        tool = subject.make(**{name: value})
    except (AggloError, TypeError, ValueError):
        return None
    problem, hierarchy = case.given
    return solve_unless_refused(subject, case.name, problem, hierarchy, tool)


def _require_true_claim(name: str, it: Solution) -> None:
    if it.converged:
        error = gap(it.x, direct(it))
        require(
            error <= _WRONG,
            f"on {name}: it reports convergence, but x differs from the direct solution of A x = b by "
            f"{error:.1e}: compare b − A x with the tolerance after the last iteration",
        )
    else:
        require(
            isinstance(it.reason, str) and it.reason, (f"on {name}: not converged, but the reason is empty")
        )


_FACTOR = 10.0  # largest factor by which an error estimate may be too small
_ROUNDING = 1e-10  # relative to the solution; the direct solution is no more accurate


@law("solver")
def told_error_holds(subject: Subject) -> None:
    """Reported energy errors and rounding limits are true for the returned x, and tests have known names."""
    for case in cases_with_3d(subject):
        it = solve(subject, case)
        require(
            set(it.tests) <= set(TESTS),
            f"on {case.name}: tests are {it.tests!r:.80}, expected some of {TESTS}",
        )
        if it.energy_error is not None and it.lifting is None:
            error = _energy_error(it)
            require(
                error <= _FACTOR * it.energy_error + _ROUNDING,
                f"on {case.name}: it reports an energy error of {it.energy_error:.1e}, that of x is "
                f"{error:.1e}: estimate it from the residual of x, or leave it None",
            )
        if it.rounding_limited:
            _require_limit(case.name, it)


def _require_limit(name: str, it: Solution) -> None:
    x, load = (it.x, it.b) if it.lifting is None else (it.lifting.rest, it.lifting.load)
    true = backward_error(matrix_of(it.A), x, load)
    require(
        not it.converged and true is not None and true <= LIMIT,
        f"on {name}: rounding_limited is set, converged is {it.converged} and the backward error {true}: "
        f"set it only if x misses the tolerance with a backward error below {LIMIT:.0e}",
    )


def _energy_error(it: Solution) -> float:
    exact = direct(it)
    e = it.x - exact
    square, size = float(e @ (it.A @ e)), float(exact @ (it.A @ exact))
    return float(np.sqrt(max(square, 0.0) / size)) if size > 0.0 else 0.0


@law("solver", promise="symmetric", when=lambda subject: hasattr(subject.build(), "aspreconditioner"))
def preconditioner_linear(subject: Subject) -> None:
    """The preconditioner M is linear: M (2 u − 3 v) = 2 M u − 3 M v, whatever the sizes of u and v."""
    tool, rng = subject.build(), np.random.default_rng(5)
    for case in cases_with_3d(subject):
        M = tool.aspreconditioner(*case.given)
        u, v = rng.standard_normal((2, M.shape[0]))
        v *= 1e3
        Mu, Mv, combined = M @ u, M @ v, M @ (2.0 * u - 3.0 * v)
        nonlinearity = float(
            np.linalg.norm(combined - 2.0 * Mu + 3.0 * Mv) / (np.linalg.norm(combined) + np.linalg.norm(Mv))
        )
        require(
            nonlinearity <= 1e-8,
            f"on {case.name}: M (2 u − 3 v) differs from 2 M u − 3 M v by {nonlinearity:.1e}: use no step "
            "length that depends on the residual and no inner iteration that stops by a tolerance, or drop "
            "the promise symmetric",
        )


_LEVEL_ROUNDING = 1e-8


@law("solver", when=lambda subject: getattr(subject.build(), "galerkin", True))
def coarse_operators_inherited(subject: Subject) -> None:
    """The matrix of each coarser level is Pᵀ A P, including small entries, unless galerkin = False."""
    for case in [*cases_with_3d(subject), *awkward_cases(), *unlike_diffusion()]:
        it = solve_unless_refused(subject, case.name, *case.given)
        for level, ((A, P), (coarse, _)) in enumerate(pairwise([] if it is None else it.operators)):
            error = _galerkin_error(matrix_of(A), matrix_of(P), matrix_of(coarse))
            require(
                error <= _LEVEL_ROUNDING,
                f"on {case.name}: the matrix of level {level + 1} is not Pᵀ A P, off by {error:.1e}: return "
                "the P that was used, and drop no small entries; set galerkin = False if levels are "
                "rediscretised",
            )


def _galerkin_error(A: Any, P: Any, coarse: Any) -> float:
    """Return the largest entry of Pᵀ A P minus the coarse matrix, relative to the diagonal entries."""
    galerkin, sizes = P.T @ A @ P, abs(P).T @ abs(A) @ abs(P)
    unit = np.sqrt(np.maximum(sizes.diagonal(), 1e-300))
    error = np.abs((galerkin - coarse).toarray())
    return float((error / unit / unit[:, None]).max(initial=0.0))


@law("solver", promise="symmetric")
def symmetric(subject: Subject) -> None:
    """The preconditioner M, aspreconditioner(problem, hierarchy), is symmetric and positive definite."""
    tool = subject.build()
    require(
        callable(getattr(tool, "aspreconditioner", None)),
        "it promises symmetric but has no method aspreconditioner(problem, hierarchy) that returns a "
        "scipy.sparse.linalg.LinearOperator",
    )
    rng = np.random.default_rng(0)
    for case in cases_with_3d(subject):
        n = len(plain(subject, tool, case))
        operator = tool.aspreconditioner(*case.given)
        u, v = rng.standard_normal((2, n))
        Mu, Mv = operator @ u, operator @ v
        gap = abs(v @ Mu - u @ Mv) / (np.linalg.norm(u) * np.linalg.norm(Mv))
        require(
            gap < 1e-8, f"on {case.name}: u·Mv and v·Mu differ by {gap:.1e}: mirror pre- and post-smoothing"
        )
        require(u @ Mu > 0, f"on {case.name}: u·Mu is {u @ Mu:.2e}, not positive")
    for case in definite():
        _require_definite(case, _preconditioner(tool, case))


def _preconditioner(tool: Any, case: Case) -> LinearOperator | None:
    """Return the preconditioner for a system, or None if the solver refuses the system."""
    try:
        return tool.aspreconditioner(*case.given)
    except AggloError:
        return None


def _require_definite(case: Case, operator: LinearOperator | None) -> None:
    """Require that the preconditioner M is symmetric and definite, scaled so that A has a unit diagonal."""
    if operator is None:
        return
    unit = np.sqrt(case.given[0].A.diagonal())
    M = unit[:, None] * np.stack([np.ravel(operator @ column) for column in np.diag(unit)], axis=1)
    size = np.abs(M).max()
    skew = np.abs(M - M.T).max() / size
    require(skew < 1e-6, f"on {case.name}: M and its transpose differ by {skew:.1e}: mirror the smoothing")
    least = float(np.linalg.eigvalsh((M + M.T) / 2)[0] / size)
    require(
        least > -1e-9,
        f"on {case.name}, which is positive definite: the smallest eigenvalue of M is {least:.1e} times its "
        "largest entry: damp a Jacobi step by a factor below 2 / λ_max(D⁻¹A); λ_max may exceed 2",
    )
