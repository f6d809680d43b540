"""Helpers for the laws of solvers: solve, convert matrices, evaluate solutions, find options by name."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from agglo_core.arrays import Float
from agglo_core.conformance.base import Case, Subject, require
from agglo_core.conformance.inputs.questions import REFUSED, answer, questions
from agglo_core.errors import AggloError
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion, Problem, Solution, System


def solve(subject: Subject, case: Case, tool: Any = None) -> Solution:
    """Solve the problem of a test case with a newly built solver, or with ``tool`` if given."""
    return _solution(answer(subject, case, subject.make(**case.options) if tool is None else tool))


def solve_unless_refused(subject: Subject, case: Case) -> Solution | None:
    """Solve the problem of a test case, or return None if the solver refuses it or the options."""
    try:
        tool = subject.make(**case.options)
    except (AggloError, TypeError, ValueError):
        return None
    solution = answer(subject, case, tool, refusal=REFUSED)
    return None if solution is REFUSED else _solution(solution)


def _solution(given: Any) -> Solution:
    require(isinstance(given, Solution), f"it returned {given!r:.60}, expected a Solution")
    return given  # type: ignore[no-any-return]


def assemble(tool: Any, problem: Diffusion, mesh: Mesh) -> System | None:
    """Return the system of a problem, or None if the discretisation refuses the problem."""
    try:
        return tool.assemble(problem, mesh)  # type: ignore[no-any-return]
    except AggloError:
        return None


def solve_assembled(tool: Any, problem: Diffusion, mesh: Mesh) -> Float | None:
    """Return the solution ``(n_cells,)`` at the centroids, or None for a refused problem."""
    system = assemble(tool, problem, mesh)
    if system is None:
        return None
    x = np.atleast_1d(spsolve(sparse.csc_array(system.A), system.b))
    return np.asarray(tool.evaluate(mesh, x, mesh.cell_centroids))


def takes(subject: Subject, kind: type[Problem]) -> bool:
    """Return True if the solver accepts problems of this class."""
    return any(isinstance(case.given[0], kind) for case in questions(subject))


def takes_diffusion(subject: Subject) -> bool:
    """Return True if a solver, discretisation or estimator accepts diffusion problems."""
    return takes(subject, Diffusion) if subject.kind == "solver" else "diffusion" in subject.build().accepts


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


def values(tool: Any, hierarchy: Hierarchy, x: Float, one: Float) -> Float | None:
    """Return the solution at the centroids of the cells, or None if the meaning of x is unknown.

    With a discretisation, the values come from its ``evaluate``. Otherwise a single unknown per cell is
    taken as cell value, in units of ``one``, the unknowns of the constant 1.
    """
    mesh, discretisation = hierarchy.fine, getattr(tool, "discretisation", None)
    assert mesh is not None
    if discretisation is not None:
        return np.asarray(discretisation.evaluate(mesh, x, mesh.cell_centroids))
    return x / one if len(x) == mesh.n_cells and np.abs(one).min() > 0.0 else None


def option_named(subject: Subject, *names: str) -> str | None:
    """Return the first of these names that is an option of the component, or None without one."""
    if not subject.takes_options:
        return None
    parameters = inspect.signature(subject.target).parameters
    return next((name for name in names if name in parameters), None)
