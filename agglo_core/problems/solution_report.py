"""What ``agglo solve`` says of a solution, as plain data and as text."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from agglo_core.arrays import Float
from agglo_core.mesh import Mesh
from agglo_core.problems.conjugate_gradients import conjugate_gradients, relative_to
from agglo_core.problems.discretisation import Discretisation
from agglo_core.problems.problem import Problem
from agglo_core.problems.solution import Solution

__all__ = ["operator_complexity", "report", "text"]

_USUAL_ERRORS = ("error_l2", "error_dg")


def report(
    mesh: Mesh,
    problem: Problem,
    solution: Solution,
    how: Discretisation | None = None,
    cg_tolerance: float | None = None,
) -> dict[str, Any]:
    """Plain data of a solution.

    Parameters
    ----------
    how : Discretisation, optional
        Gives error norms, loads and the size of residuals. Without it there are no errors, the energy is
        bᵀx, and residuals are measured by their 2-norm.
    cg_tolerance : float, optional
        If given, the iterations of plain conjugate gradients from 0 to this tolerance, with the same test;
        None if 10,000 do not suffice.

    Returns
    -------
    dict
        ``energy`` is fᵀu, the work of source and fluxes; ``relative_residual`` is the measure of b − A x;
        ``error_l2``, ``error_dg`` and others of the discretisation are norms, not relative, and None if
        unknown; ``operator_complexity`` is the number of matrix entries of all levels over those of the
        finest.
    """
    dofs = [A.shape[0] for A in _matrices(solution)]
    measure = how.residual_measure(problem, mesh, solution.b) if how else relative_to(solution.b)
    norms = how.errors(problem, mesh, solution.x) if how else {}
    load = how.load(problem, mesh, solution.b) if how else solution.b
    return {
        "dofs": dofs[0],
        "levels": [{"cells": n * mesh.n_cells // dofs[0], "dofs": n} for n in dofs],
        "iterations": solution.iterations,
        "converged": bool(solution.converged),
        "reason": solution.reason,
        "relative_residual": measure(solution.b - solution.A @ solution.x),
        "residuals": np.asarray(solution.residuals).tolist(),
        **dict.fromkeys(_USUAL_ERRORS),
        **{f"error_{name}": float(value) for name, value in norms.items()},
        "energy": float(load @ solution.x),
        "operator_complexity": operator_complexity(solution),
        "cg_iterations": _plain_cg(solution, cg_tolerance, measure),
        "seconds": dict(solution.seconds),
    }


def operator_complexity(solution: Solution) -> float | None:
    """Matrix entries of all levels over those of the finest; None where one is not known entry by entry."""
    entries = [_entries(A) for A in _matrices(solution)]
    known = [count for count in entries if count is not None]
    return float(sum(known) / known[0]) if len(known) == len(entries) else None


def _entries(A: Any) -> int | None:
    return int(np.count_nonzero(A)) if isinstance(A, np.ndarray) else getattr(A, "nnz", None)


def _matrices(solution: Solution) -> list[Any]:
    """That of each level, finest first; of a solver that names no levels, that of the system."""
    return [A for A, _ in solution.operators] or [solution.A]


def _plain_cg(solution: Solution, tolerance: float | None, measure: Callable[[Float], float]) -> int | None:
    if tolerance is None:
        return None
    history = conjugate_gradients(solution.A, solution.b, tolerance, measure=measure)
    return history.iterations if history.converged else None


def text(title: str, data: Mapping[str, Any]) -> str:
    """A few lines for people to read."""
    levels = " → ".join(f"{level['cells']:,}" for level in data["levels"])
    state = f"converged after {data['iterations']} iterations ({data['reason']})"
    if not data["converged"]:
        state = f"NOT CONVERGED: {data['reason']}; the solution is that of iteration {data['iterations']}"
    complexity = data["operator_complexity"]
    lines = [
        f"{title}: {data['dofs']:,} unknowns, cells {levels}",
        f"{state}, relative residual {data['relative_residual']:.2e}",
        f"energy fᵀu {data['energy']:.8g}, operator complexity "
        + ("unknown" if complexity is None else f"{complexity:.2f}"),
    ]
    if data["cg_iterations"] is not None:
        lines.insert(2, f"plain conjugate gradients: {data['cg_iterations']} iterations")
    errors = {name.removeprefix("error_").upper(): each for name, each in data.items() if "error_" in name}
    known = [f"{name} {value:.3e}" for name, value in errors.items() if value is not None]
    if known:
        lines.append(f"error: {', '.join(known)}")
    lines.append(", ".join(f"{name} {value:.2f} s" for name, value in data["seconds"].items()))
    return "\n".join(lines)
