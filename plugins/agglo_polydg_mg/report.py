"""What ``agglo solve`` says of a solution, as plain data and as text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from agglo_core.arrays import Float
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion, Solution
from agglo_polydg_mg.assembly import load
from agglo_polydg_mg.cycle import conjugate_gradients
from agglo_polydg_mg.gauge import Gauge
from agglo_polydg_mg.norms import errors
from agglo_polydg_mg.operators import Discretisation

__all__ = ["operator_complexity", "report", "text"]


def report(
    mesh: Mesh,
    problem: Diffusion,
    solution: Solution,
    how: Discretisation | None = None,
    cg_tolerance: float | None = None,
) -> dict[str, Any]:
    """Plain data of a solution.

    Parameters
    ----------
    how : Discretisation, optional
        Without it, or without an exact solution, the errors are None.
    cg_tolerance : float, optional
        If given, the iterations of plain conjugate gradients from 0 to this tolerance, with the same test;
        None if 10,000 do not suffice.

    Returns
    -------
    dict
        ``energy`` is fᵀu, the work of source and fluxes (bᵀx if there is no ``how`` to tell them from
        Dirichlet data); ``relative_residual`` is what :class:`~agglo_polydg_mg.gauge.Gauge` says of
        b − A x; ``error_l2`` and ``error_dg`` are norms, not relative; ``operator_complexity`` is the number
        of matrix entries of all levels over those of the finest.
    """
    dofs = [A.shape[0] for A, _ in solution.operators]
    gauge = how.gauge(mesh, problem, solution.b) if how else Gauge(solution.b)
    found = (
        errors(how.basis(mesh), solution.x, problem, penalty=how.penalty) if how and problem.exact else None
    )
    return {
        "dofs": dofs[0],
        "levels": [{"cells": n * mesh.n_cells // dofs[0], "dofs": n} for n in dofs],
        "iterations": solution.iterations,
        "converged": bool(solution.converged),
        "reason": solution.reason,
        "relative_residual": gauge(solution.b - solution.A @ solution.x),
        "residuals": np.asarray(solution.residuals).tolist(),
        "error_l2": found.l2 if found else None,
        "error_dg": found.dg if found else None,
        "energy": float(_load(mesh, problem, solution, how) @ solution.x),
        "operator_complexity": operator_complexity(solution),
        "cg_iterations": _plain_cg(solution, cg_tolerance, gauge),
        "seconds": dict(solution.seconds),
    }


def operator_complexity(solution: Solution) -> float:
    """Matrix entries of all levels over those of the finest."""
    entries = [A.nnz for A, _ in solution.operators]
    return float(sum(entries) / entries[0])


def _load(mesh: Mesh, problem: Diffusion, solution: Solution, how: Discretisation | None) -> Float:
    """Right-hand side without what Dirichlet data put there."""
    return load(how.basis(mesh), problem) if how and problem.dirichlet else solution.b


def _plain_cg(solution: Solution, tolerance: float | None, gauge: Gauge) -> int | None:
    if tolerance is None:
        return None
    history = conjugate_gradients(solution.A, solution.b, tolerance, gauge=gauge)
    return history.iterations if history.converged else None


def text(title: str, data: Mapping[str, Any]) -> str:
    """A few lines for people."""
    levels = " → ".join(f"{level['cells']:,}" for level in data["levels"])
    state = f"converged after {data['iterations']} iterations ({data['reason']})"
    if not data["converged"]:
        state = f"NOT CONVERGED: {data['reason']}; the solution is that of iteration {data['iterations']}"
    lines = [
        f"{title}: {data['dofs']:,} unknowns, cells {levels}",
        f"{state}, relative residual {data['relative_residual']:.2e}",
        f"energy fᵀu {data['energy']:.8g}, operator complexity {data['operator_complexity']:.2f}",
    ]
    if data["cg_iterations"] is not None:
        lines.insert(2, f"plain conjugate gradients: {data['cg_iterations']} iterations")
    if data["error_l2"] is not None:
        lines.append(f"error: L2 {data['error_l2']:.3e}, DG {data['error_dg']:.3e}")
    lines.append(", ".join(f"{name} {value:.2f} s" for name, value in data["seconds"].items()))
    return "\n".join(lines)
