"""Laws of the levels of a solver: coarse matrices, and the preconditioner it promises."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator

from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs.questions import plain
from agglo_core.conformance.inputs.solver_answers import everywhere, matrix_of, solve_unless_refused
from agglo_core.conformance.inputs.solver_cases import awkward
from agglo_core.conformance.inputs.system_cases import definite, unlike_diffusion
from agglo_core.errors import AggloError

_ROUNDING = 1e-8


@law("solver", when=lambda subject: getattr(subject.build(), "galerkin", True))
def coarse_operators_inherited(subject: Subject) -> None:
    """The matrix of each coarser level is Pᵀ A P, small entries too, unless it says galerkin = False."""
    for case in [*everywhere(subject), *awkward(), *unlike_diffusion()]:
        it = solve_unless_refused(subject, case.name, *case.given)
        for level, ((A, P), (coarse, _)) in enumerate(pairwise([] if it is None else it.operators)):
            off = _off(matrix_of(A), matrix_of(P), matrix_of(coarse))
            require(
                off <= _ROUNDING,
                f"on {case.name}: the matrix of level {level + 1} is not Pᵀ A P, off by {off:.1e}: "
                "is P the one that was used, and is no small entry left out? Where levels are discretised "
                "anew, say galerkin = False",
            )


def _off(A: Any, P: Any, coarse: Any) -> float:
    """Largest difference of an entry from Pᵀ A P, relative to the diagonals in its row and column."""
    wanted, sizes = P.T @ A @ P, abs(P).T @ abs(A) @ abs(P)
    unit = np.sqrt(np.maximum(sizes.diagonal(), 1e-300))
    apart = np.abs((wanted - coarse).toarray())
    return float((apart / unit / unit[:, None]).max(initial=0.0))


@law("solver", promise="symmetric")
def symmetric(subject: Subject) -> None:
    """Its preconditioner M, aspreconditioner(problem, hierarchy), is symmetric and positive definite."""
    tool = subject.build()
    require(
        callable(getattr(tool, "aspreconditioner", None)),
        "it promises symmetric but has no method aspreconditioner(problem, hierarchy) that returns a "
        "scipy.sparse.linalg.LinearOperator",
    )
    rng = np.random.default_rng(0)
    for case in everywhere(subject):
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
    """That of a system; None if it is refused."""
    try:
        return tool.aspreconditioner(*case.given)
    except AggloError:
        return None


def _require_definite(case: Case, operator: LinearOperator | None) -> None:
    """Broken unless M, in units in which A has ones on its diagonal, has positive eigenvalues only."""
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
        f"on {case.name}, which is positive definite: M has the eigenvalue {least:.1e} of its largest entry: "
        "a step of Jacobi is safe only below 2 / λ_max(D⁻¹A), which may be more than 2; damp it by that",
    )
