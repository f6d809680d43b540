"""Laws of what a solver tells of its answer and of its preconditioner beyond ``converged``."""

from __future__ import annotations

import numpy as np

from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs.solver_answers import direct, everywhere, matrix_of, solve
from agglo_core.problems import Solution
from agglo_core.problems.iteration_history import TESTS
from agglo_core.problems.residuals.backward_error import LIMIT, backward_error

_FACTOR = 10.0  # by which an estimate of the error may be too small
_ROUNDING = 1e-10  # of the solution: below, its factorisation is no better


@law("solver")
def told_error_holds(subject: Subject) -> None:
    """The energy error, the tests and the outcome that it tells of x are those of x, where it tells any."""
    for case in everywhere(subject):
        it = solve(subject, case)
        require(
            set(it.tests) <= set(TESTS),
            f"on {case.name}: tests are {it.tests!r:.80}, expected some of {TESTS}",
        )
        if it.energy_error is not None and it.lifting is None:
            error = _energy_error(it)
            require(
                error <= _FACTOR * it.energy_error + _ROUNDING,
                f"on {case.name}: it tells an energy error of {it.energy_error:.1e}, x has {error:.1e}: "
                "estimate it from the residual of x, or leave it None",
            )
        if it.rounding_limited:
            _require_limit(case.name, it)


def _require_limit(name: str, it: Solution) -> None:
    rest, load = (it.x, it.b) if it.lifting is None else (it.lifting.rest, it.lifting.load)
    true = backward_error(matrix_of(it.A), rest, load)
    require(
        not it.converged and true is not None and true <= LIMIT,
        f"on {name}: it says that rounding allows no better, converged is {it.converged} and the backward "
        f"error {true}: that is for an x which misses the tolerance, with a backward error below {LIMIT:.0e}",
    )


def _energy_error(it: Solution) -> float:
    exact = direct(it)
    e = it.x - exact
    square, size = float(e @ (it.A @ e)), float(exact @ (it.A @ exact))
    return float(np.sqrt(max(square, 0.0) / size)) if size > 0.0 else 0.0


@law("solver", promise="symmetric", when=lambda subject: hasattr(subject.build(), "aspreconditioner"))
def preconditioner_linear(subject: Subject) -> None:
    """Its preconditioner is linear: M (2 u − 3 v) is 2 M u − 3 M v, whatever the sizes of u and v."""
    tool, rng = subject.build(), np.random.default_rng(5)
    for case in everywhere(subject):
        M = tool.aspreconditioner(*case.given)
        u, v = rng.standard_normal((2, M.shape[0]))
        v *= 1e3
        Mu, Mv, both = M @ u, M @ v, M @ (2.0 * u - 3.0 * v)
        bent = float(np.linalg.norm(both - 2.0 * Mu + 3.0 * Mv) / (np.linalg.norm(both) + np.linalg.norm(Mv)))
        require(
            bent <= 1e-8,
            f"on {case.name}: M (2 u − 3 v) is not 2 M u − 3 M v, by {bent:.1e}: no step length may depend "
            "on the residual, nor an inner iteration stop by a tolerance; or drop the promise symmetric",
        )
