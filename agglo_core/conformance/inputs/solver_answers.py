"""Helpers for the laws of solvers: solve, convert matrices, evaluate solutions, find options by name."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from agglo_core.arrays import Float
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs.questions import answer, in_space, questions, select_accepted
from agglo_core.errors import AggloError
from agglo_core.hierarchy import Hierarchy
from agglo_core.problems import Diffusion, Linear, Problem, Solution


def solve(subject: Subject, case: Case, tool: Any = None) -> Solution:
    """Solve the problem of a test case with a newly built solver, or with ``tool`` if given."""
    solution = answer(subject, subject.build() if tool is None else tool, case)
    require(
        isinstance(solution, Solution), f"on {case.name}: it returned {solution!r:.60}, expected a Solution"
    )
    return solution  # type: ignore[no-any-return]


def solve_unless_refused(
    subject: Subject, name: str, problem: Problem, hierarchy: Hierarchy, tool: Any = None
) -> Solution | None:
    """Solve a problem, or return None if the solver refuses it with an AggloError."""
    try:
        return solve(subject, Case(name, (problem, hierarchy)), tool)
    except Broken as error:
        if isinstance(error.__cause__, AggloError):
            return None
        raise


def first_case(subject: Subject, sort: type[Diffusion] | type[Linear]) -> list[Case]:
    """Return the first Diffusion or Linear test case that the solver accepts, or an empty list."""
    return [case for case in questions(subject) if isinstance(case.given[0], sort)][:1]


def cases_with_3d(subject: Subject) -> list[Case]:
    """Return the standard test cases of a solver, with the 3-D cases if it promises 3-D."""
    return [*questions(subject), *select_accepted(subject, in_space(subject))]


def matrix_of(A: Any) -> Any:
    """Convert a sparse matrix, an array or a ``LinearOperator`` to a sparse matrix."""
    if not sparse.issparse(A) and not isinstance(A, np.ndarray):
        A = A @ np.eye(A.shape[1])
    return sparse.csc_array(A)


def direct(solution: Solution) -> Float:
    """Solve a Solution's linear system by a direct method.

    Returns ``(n,)``.
    """
    return np.atleast_1d(spsolve(matrix_of(solution.A), solution.b))


def gap(x: Float, wanted: Float) -> float:
    """Return the norm of the difference between two vectors, relative to the norm of the expected one."""
    return float(np.linalg.norm(x - wanted) / max(float(np.linalg.norm(wanted)), 1e-300))


def values(tool: Any, hierarchy: Hierarchy, x: Float, one: Float | None) -> tuple[Float, Float] | None:
    """Return points ``(q, d)`` inside the cells and the solution values ``(q,)`` there.

    With a discretisation, the values come from its ``evaluate``. Otherwise a single unknown per cell is
    taken as cell value, in units of ``one``, the unknowns of the constant 1 (or 1 if ``one`` is None).
    Return None if the meaning of x is unknown.
    """
    mesh, discretisation = hierarchy.fine, getattr(tool, "discretisation", None)
    assert mesh is not None
    points = mesh.cell_centroids
    if discretisation is not None:
        return points, np.asarray(discretisation.evaluate(mesh, x, points))
    unit = np.ones(mesh.n_cells) if one is None else one
    if len(x) == mesh.n_cells and np.abs(unit).min() > 0.0:
        return points, x / unit
    return None


def option_named(subject: Subject, *names: str) -> str | None:
    """Return the first of these names that is an option of the component, or None without one."""
    if not subject.takes_options:
        return None
    parameters = inspect.signature(subject.target).parameters
    return next((name for name in names if name in parameters), None)
