"""Laws of what a solver says of its own work: residuals, tolerance, convergence; and of its memory."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs.cases import with_problem
from agglo_core.conformance.inputs.solver_answers import (
    direct,
    first_case,
    gap,
    option_named,
    solve,
    solve_unless_refused,
)
from agglo_core.conformance.inputs.solver_cases import awkward, halves, plate, uneven
from agglo_core.conformance.inputs.system_cases import ill_conditioned, rising
from agglo_core.errors import AggloError
from agglo_core.problems import Diffusion, Linear, Solution

_TOLERANCE = ("tolerance", "tol", "rtol", "relative_tolerance")
_MOST = ("max_iterations", "maxiter", "max_iter", "iterations", "most", "max_cycles", "cycles")
_FEW = (1, 2, 3, 5)
_CLOSE = 1e-4
_WRONG = 1e-2  # nobody's tolerance: what is called converged is nearer than that
_NOISE = 1e-9  # of the first residual; below, rounding decides


def _asked(subject: Subject) -> list[Case]:
    """A diffusion problem and an uneven linear system, of those that it takes."""
    asked = first_case(subject, Diffusion)
    for case in first_case(subject, Linear):
        hierarchy = case.given[1]
        width = len(case.given[0].b) // hierarchy.graph.n
        asked.append(Case("an uneven linear system", (uneven(hierarchy.graph, width), hierarchy)))
    return asked


def _hard(subject: Subject) -> list[Case]:
    """Systems whose residual goes up before it goes down, and cannot become small."""
    hard = {"unknowns in different units": rising, "an ill-conditioned matrix": ill_conditioned}
    return [
        Case(name, (make(case.given[1]), case.given[1]))
        for case in first_case(subject, Linear)
        for name, make in hard.items()
        if case.sort == "linear"
    ]


def _multiplied(case: Case, matrix: float, data: float) -> Case:
    """The question with matrix and right-hand side multiplied."""
    problem = case.given[0]
    if isinstance(problem, Linear):
        return with_problem(case, A=matrix * problem.A, b=data * problem.b)
    return with_problem(case, kappa=matrix, source=data)


@law("solver")
def scales_with_the_system(subject: Subject) -> None:
    """Data multiplied by any power of two multiply the solution and every residual of the history."""
    for case in _asked(subject):
        once = solve(subject, case)
        for matrix, data in ((1.0, 2.0**20), (1.0, 2.0**-20), (2.0**8, 2.0**8)):
            it = solve(subject, _multiplied(case, matrix, data))
            how = f"on {case.name} with the matrix times {matrix:g}, the right-hand side times {data:g}"
            off = gap(it.x * matrix / data, once.x)
            require(
                it.converged == once.converged and off <= _CLOSE,
                f"{how}: converged is {it.converged}, x is off by {off:.1e}: compare the residual with the "
                "tolerance times that of the right-hand side, not with a fixed number",
            )
            _require_same_history(it.residuals / data, once.residuals, how)


def _require_same_history(one: Any, other: Any, how: str) -> None:
    both = min(len(one), len(other))
    one, other = np.asarray(one)[:both], np.asarray(other)[:both]
    clear = other > _NOISE * other[0]
    clear[0] = True
    require(
        np.allclose(one[clear], other[clear], rtol=1e-2),
        f"{how}: the residuals {one[:3]} (divided by that) were {other[:3]}: each is the 2-norm of b − A x, "
        "neither relative nor preconditioned nor made up",
    )


@law("solver")
def zero_from_zero(subject: Subject) -> None:
    """Without data the solution is 0, and that is called converged."""
    for case in _asked(subject):
        problem = case.given[0]
        none = {"b": 0 * problem.b} if isinstance(problem, Linear) else {"source": 0.0}
        it = solve(subject, with_problem(case, **none))
        require(
            np.all(it.x == 0.0) and it.converged,
            f"on {case.name} with a right-hand side of zeros: converged is {it.converged} ({it.reason}), x "
            f"{it.x[:3]}: divide by the norm of b only where there is one",
        )


@law("solver", when=lambda subject: option_named(subject, *_TOLERANCE) is not None)
def tolerance_met(subject: Subject) -> None:
    """A tolerance of 1e-4 or 1e-10 is met wherever it says converged, on one and the same way."""
    name = str(option_named(subject, *_TOLERANCE))
    for case in [*_asked(subject), *_hard(subject)]:
        runs = {tolerance: _with_option(subject, case, name, tolerance) for tolerance in (1e-4, 1e-10)}
        for tolerance, it in runs.items():
            if it is not None and it.converged:
                left = gap(it.A @ it.x, it.b)
                require(
                    left <= 100.0 * tolerance,
                    f"on {case.name} with {name}={tolerance:g}: it says converged, and ‖b − A x‖ / ‖b‖ is "
                    f"{left:.1e}: does the option reach the iteration? Compare b − A x itself",
                )
        loose, tight = runs.values()
        if loose is not None and tight is not None:
            same = min(len(loose.residuals) - 1, len(tight.residuals) - 1, 2)  # the last one ends the run
            require(
                np.allclose(loose.residuals[:same], tight.residuals[:same], rtol=0.5),
                f"on {case.name}: the history begins with {loose.residuals[:2]} for {name}=1e-4 and with "
                f"{tight.residuals[:2]} for 1e-10: residuals are measured, not made up afterwards",
            )


@law("solver", when=lambda subject: option_named(subject, *_MOST) is not None)
def too_few_iterations_said(subject: Subject) -> None:
    """Stopped after 1 to 5 iterations it does not claim to have converged, and tells the residual of x."""
    name = str(option_named(subject, *_MOST))
    for most in _FEW:
        for case in [*_asked(subject), *_hard(subject)]:
            it = _with_option(subject, case, name, most)
            if it is not None:
                _require_honest(f"{case.name} with {name}={most}", it, most)


def _require_honest(name: str, it: Solution, most: int) -> None:
    _require_true_claim(name, it)
    require(
        most > 1 or it.converged or it.iterations == 1 or not np.any(it.x),
        f"on {name}: it reports {it.iterations} iterations: the first residual is that before any",
    )
    size, true = (float(np.linalg.norm(each)) for each in (it.b, it.b - it.A @ it.x))
    require(
        abs(it.residuals[-1] - true) <= 1e-8 * size + 0.01 * true,
        f"on {name}: the last residual is {it.residuals[-1]:.3e}, that of x is {true:.3e}: they belong to "
        "the same iterate, neither the least so far nor one to be made smooth",
    )


@law("solver")
def claims_hold(subject: Subject) -> None:
    """Where coefficients jump, on one part, three levels or loose parts, what it calls converged is right."""
    for case in awkward():
        plain_sort = not isinstance(case.given[0], Linear) or case.sort == "linear"
        if plain_sort or first_case(subject, Linear):
            it = solve_unless_refused(subject, case.name, *case.given)
            if it is not None:
                _require_true_claim(case.name, it)


@law("solver")
def each_solve_alone(subject: Subject) -> None:
    """What it solved before, on the same hierarchy too, changes nothing."""
    asked = [*_asked(subject)]
    for case in first_case(subject, Diffusion):
        hierarchy = plate()
        for kappa in (halves(hierarchy, 1.0, 9.0), halves(hierarchy, 9.0, 1.0)):
            asked.append(replace(case, name="a plate", given=(Diffusion(kappa), hierarchy)))
    asked += [_multiplied(case, 3.0, 2.0) for case in asked[:2]] + asked[:1]
    tool = subject.build()
    for case in asked:
        fresh = solve_unless_refused(subject, case.name, *case.given)
        off = 0.0 if fresh is None else gap(solve(subject, case, tool).x, fresh.x)
        require(
            off <= 1e-6,
            f"on {case.name}, after other problems: x differs by {off:.1e} from that of a fresh solver: keep "
            "no matrix, factorisation or first guess from the solve before",
        )


def _with_option(subject: Subject, case: Case, name: str, value: float) -> Solution | None:
    """The solution with an option set; None if the solver does not take that value, or refuses."""
    try:
        tool = subject.make(**{name: value})
    except (AggloError, TypeError, ValueError):
        return None
    problem, hierarchy = case.given
    return solve_unless_refused(subject, case.name, problem, hierarchy, tool)


def _require_true_claim(name: str, it: Solution) -> None:
    if it.converged:
        off = gap(it.x, direct(it))
        require(
            off <= _WRONG,
            f"on {name}: it says converged, and x differs from the direct solution of A x = b by {off:.1e}: "
            "compare b − A x with the tolerance after the last iteration",
        )
    else:
        require(isinstance(it.reason, str) and it.reason, f"on {name}: not converged, and no reason is given")
