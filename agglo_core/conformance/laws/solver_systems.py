"""Laws of solvers of linear systems unlike those of diffusion: solve what is given, or say no."""

from __future__ import annotations

import numpy as np

from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs.solver_answers import first_case, gap, solve_unless_refused
from agglo_core.conformance.inputs.system_cases import unlike_diffusion
from agglo_core.problems import Linear, Solution

_CLOSE = 1e-4
_SAME = 1e-9


@law("solver", when=lambda subject: bool(first_case(subject, Linear)))
def given_matrix_used(subject: Subject) -> None:
    """A system that is not symmetric, not definite or of unequal cells is solved as given, or it says no."""
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
            f"on {case.name}: A and b of the Solution are not those given: use the whole matrix, or refuse "
            "what the method cannot solve by an AggloError",
        )
        _require_own_residual(case.name, it)
        if it.converged:
            left = gap(problem.A @ it.x, problem.b)
            require(
                left <= _CLOSE,
                f"on {case.name}: it says converged, and x leaves a residual of {left:.1e} in the system "
                "given: compare b − A x of that very matrix with the tolerance, or refuse the system",
            )


def _require_own_residual(name: str, it: Solution) -> None:
    """The last residual is that of x, unless the method broke down."""
    if np.isfinite(it.x).all() and len(it.residuals):
        size, true = (float(np.linalg.norm(each)) for each in (it.b, it.b - it.A @ it.x))
        require(
            abs(it.residuals[-1] - true) <= 1e-8 * size + 0.01 * true,
            f"on {name}: the last residual is {it.residuals[-1]:.3e}, b − A x has {true:.3e}: take it from x "
            "and the matrix given",
        )
