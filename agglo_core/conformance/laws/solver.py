"""Laws of solutions: facts about the solver's own system, so that they hold for any discretisation."""

from __future__ import annotations

import numbers

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.cases import cases, laplacian, with_problem
from agglo_core.conformance.inputs.questions import taken
from agglo_core.conformance.inputs.solver_answers import direct, everywhere, first_case, gap, solve as _solve
from agglo_core.errors import AggloError
from agglo_core.problems import Diffusion, Linear

_CLOSE = 1e-4  # solvers stop at a tolerance of their own; this tells wrong from unfinished


@law("solver")
def solution_record(subject: Subject) -> None:
    """It returns a Solution: x and b of one length, A square, a residual before and after each iteration."""
    for case in everywhere(subject):
        it = _solve(subject, case)
        n = len(it.x)
        require(
            np.shape(it.A) == (n, n) and np.shape(it.b) == (n,),
            f"on {case.name}: x has {n} entries, A the shape {np.shape(it.A)}, b {np.shape(it.b)}",
        )
        require(
            isinstance(it.converged, bool | np.bool_) and isinstance(it.reason, str),
            f"on {case.name}: converged is {it.converged!r} and reason {it.reason!r}: give bool and str",
        )
        require(
            isinstance(it.iterations, numbers.Integral) and len(it.residuals) == it.iterations + 1,
            f"on {case.name}: {len(it.residuals)} residuals of {it.iterations} iterations: the first is that "
            "of the start, then one for each iteration",
        )
        require(
            np.isfinite(it.residuals).all() and np.min(it.residuals) >= 0.0,
            f"on {case.name}: residuals are {np.asarray(it.residuals)[:4]}: norms are finite, not negative",
        )
        require(
            all(isinstance(each, numbers.Real) and each >= 0.0 for each in it.seconds.values()),
            f"on {case.name}: seconds are {it.seconds!r:.60}, expected numbers by name",
        )


@law("solver")
def solves(subject: Subject) -> None:
    """On small problems it converges to the direct solution of the same system."""
    for case in everywhere(subject):
        it = _solve(subject, case)
        require(it.converged, f"on {case.name}: not converged ({it.reason}) on a tiny problem")
        error = gap(it.x, direct(it))
        require(
            error <= _CLOSE,
            f"on {case.name}: x differs from the direct solution of A x = b by {error:.1e}: check the "
            "preconditioner and the test of convergence",
        )


@law("solver")
def own_system_kept(subject: Subject) -> None:
    """A linear system is solved as given: x, A and b of the Solution fit the A and b of the problem."""
    for case in everywhere(subject):
        problem = case.given[0]
        if isinstance(problem, Linear):
            it = _solve(subject, case)
            x = it.x
            require(np.shape(x) == np.shape(problem.b), f"on {case.name}: x has shape {np.shape(x)}")
            off = gap(problem.A @ x, problem.b)
            require(
                off <= _CLOSE,
                f"on {case.name}: x leaves a residual of {off:.1e} in the system given: undo any scaling or "
                "reordering before returning",
            )
            require(
                gap(it.b, problem.b) <= 1e-9 and gap(it.A @ x, problem.A @ x) <= 1e-9,
                f"on {case.name}: A and b of the Solution are not those of the system: undo scaling, for "
                "residuals and energy are taken from them",
            )


@law("solver")
def true_residual(subject: Subject) -> None:
    """The last residual reported is the 2-norm of b − A x."""
    for case in everywhere(subject):
        it = _solve(subject, case)
        size = float(np.linalg.norm(it.b))
        true = float(np.linalg.norm(it.b - it.A @ it.x))
        require(
            abs(it.residuals[-1] - true) <= 1e-8 * size + 0.01 * true,
            f"on {case.name}: reported {it.residuals[-1]:.3e}, b − A x has {true:.3e}: recompute it from x; "
            "the recursively updated residual and the preconditioned one are different numbers",
        )


@law("solver")
def failure_flagged(subject: Subject) -> None:
    """A problem without a solution is flagged (converged=False, a reason) or refused with an AggloError."""
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
            it = _solve(subject, Case(name, (problem, hierarchy)))
        except Broken as error:
            if isinstance(error.__cause__, AggloError):
                continue
            raise
        require(
            not it.converged and it.reason,
            f"on {name}: converged={it.converged}, reason {it.reason!r}: compare the true residual with the "
            "tolerance before saying so; NaN is smaller than nothing",
        )


@law("solver")
def operators_chain(subject: Subject) -> None:
    """Operators, if there are any, are (A, P) finest first: P leads from the next level, the last is None."""
    for case in everywhere(subject):
        it = _solve(subject, case)
        for level, (A, P) in enumerate(it.operators):
            rows = np.shape(A)[0]
            require(np.shape(A) == (rows, rows), f"on {case.name}: A of level {level} is {np.shape(A)}")
            if level + 1 < len(it.operators):
                wanted = (rows, np.shape(it.operators[level + 1][0])[0])
                require(
                    P is not None and np.shape(P) == wanted,
                    f"on {case.name}: P of level {level} has shape {P is not None and np.shape(P)}, "
                    f"expected {wanted}",
                )


@law("solver")
def field_forms_agree(subject: Subject) -> None:
    """A coefficient or source given as a number, one value per cell or a callable means the same."""
    for case in first_case(subject, Diffusion):
        n = case.given[1].graph.n
        wanted = _solve(subject, with_problem(case, kappa=2.0, source=3.0)).x
        for form, kappa, source in (
            ("arrays", np.full(n, 2.0), np.full(n, 3.0)),
            ("callables", lambda x: np.full(len(x), 2.0), lambda x: np.full(len(x), 3.0)),
        ):
            x = _solve(subject, with_problem(case, kappa=kappa, source=source)).x
            _require_close(
                x, wanted, f"kappa and source given as {form} give another solution than as numbers"
            )


@law("solver")
def linear_in_the_data(subject: Subject) -> None:
    """Twice the source or right-hand side gives twice the solution, twice the coefficient or matrix half."""
    for case in first_case(subject, Diffusion):
        once = _solve(subject, case).x
        _require_close(_solve(subject, with_problem(case, source=2.0)).x, 2 * once, "twice the source")
        _require_close(_solve(subject, with_problem(case, kappa=2.0)).x, once / 2, "twice the coefficient")
    for case in first_case(subject, Linear):
        once, (A, b) = _solve(subject, case).x, (case.given[0].A, case.given[0].b)
        _require_close(_solve(subject, with_problem(case, b=2 * b)).x, 2 * once, "twice the right-hand side")
        _require_close(_solve(subject, with_problem(case, A=2 * A)).x, once / 2, "twice the matrix")


@law("solver")
def disconnected_solved(subject: Subject) -> None:
    """A mesh of two components is solved too."""
    from agglo_core.hierarchy import Hierarchy

    mesh = small_meshes.apart()
    labels = mesh.graph.components()
    hierarchy = Hierarchy(mesh, mesh.graph, [labels], [{"n_parts": 2}], nested=True)
    asked = [Case("two components", (each, hierarchy)) for each in (Diffusion(), laplacian(mesh.graph, 1))]
    for case in taken(subject, asked):
        it = _solve(subject, case)
        require(it.converged, f"on two components: not converged ({it.reason})")


def _require_close(x: NDArray[np.float64], wanted: Float, where: str) -> None:
    error = gap(x, wanted)
    require(error <= _CLOSE, f"{where}: x is off by {error:.1e}: check where kappa and source enter")
