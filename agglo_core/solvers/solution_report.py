"""Report of ``agglo solve`` about a solution, as plain data and as text."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from agglo_core.arrays import Float
from agglo_core.mesh import Mesh
from agglo_core.multigrid.krylov.look_ahead import conjugate_gradients
from agglo_core.problems.discretisation import Discretisation, Problem
from agglo_core.problems.residuals.row_scales import row_measure
from agglo_core.problems.solution import Solution
from agglo_core.progress import Listener, phase
from agglo_core.solvers.fine_system import may_be_nonsymmetric

_COLUMNS = 80  # default width of the text, in characters
_TIE = "\N{NO-BREAK SPACE}"
_USUAL_ERRORS = ("error_l2", "error_dg")


def report(
    mesh: Mesh,
    problem: Problem,
    solution: Solution,
    how: Discretisation | None = None,
    cg_tolerance: float | None = None,
    progress: Listener | None = None,
) -> dict[str, Any]:
    """Return the report on a solution as a dictionary of plain data.

    Parameters
    ----------
    how : Discretisation, optional
        Provides error norms, loads and the residual measure. Without a discretisation there are no
        errors, the energy is bᵀx, and residuals are measured in the 2-norm.
    cg_tolerance : float, optional
        Tolerance for plain conjugate gradients from 0 with an equal stopping test. The report then
        contains their iteration count, or None if 10,000 do not suffice.
    progress : callable, optional
        Receives the phases. Plain conjugate gradients take most of the time.

    Returns
    -------
    dict
        - ``cells`` of a level: agglomerate count, None if unknowns belong to none;
        - ``nonzeros`` of a level: number of stored matrix entries, None if unavailable;
        - ``energy``: fᵀu, the work of source and fluxes;
        - ``relative_residual``: measure of b − A x, without an offset that the solver subtracted;
        - ``energy_error``, ``energy_errors``, ``tests_met``, ``tolerance``, ``outcome``,
          ``backward_error``: attributes of the solution;
        - ``error_l2``, ``error_dg`` and further norms of the discretisation: absolute, None if unknown;
        - ``operator_complexity``: matrix entries of all levels divided by finest entries;
        - ``grid_complexity``: unknowns of all levels divided by finest unknowns;
        - ``contraction``, ``asymptotic_contraction``: mean residual reduction factor per iteration,
          over all iterations and over the second half;
        - ``integral``: integral of u over the mesh, a list for vectors, None if the discretisation has none;
        - ``memory``, ``cpu_seconds``, ``choice``, ``advice``: as reported by the solver, or None or
          empty.
    """
    # Unknowns, entries and agglomerates per level.
    matrices = _matrices(solution)
    dofs = [A.shape[0] for A in matrices]
    sizes = zip(_parts(mesh, solution, dofs), dofs, map(_entries, matrices), strict=True)
    # Residual measure, errors and energy, from the discretisation if available.
    x_rest, b = _solved_system(solution)
    measure = how.residual_measure(problem, mesh, b) if how else row_measure(solution.A, b)
    with phase(progress, "measuring", "errors"):
        norms = how.errors(problem, mesh, solution.x) if how else {}
        load = how.load(problem, mesh, solution.b) if how else solution.b
    with np.errstate(over="ignore", invalid="ignore"):
        energy = float(np.vdot(load, solution.x))
    return {
        "dofs": dofs[0],
        "levels": [{"cells": k, "dofs": n, "nonzeros": entries} for k, n, entries in sizes],
        "iterations": solution.iterations,
        "converged": bool(solution.converged),
        "reason": solution.reason,
        "relative_residual": measure(b - solution.A @ x_rest),
        "energy_error": solution.energy_error,
        "tests_met": list(solution.tests),
        "residuals": np.asarray(solution.residuals).tolist(),
        **error_entries(norms),
        "energy": energy,
        "operator_complexity": _prefer_reported(solution.operator_complexity, operator_complexity(solution)),
        "cg_iterations": _plain_cg(solution, cg_tolerance, measure, progress),
        "seconds": dict(solution.seconds),
        "cpu_seconds": dict(solution.cpu_seconds),
        "grid_complexity": _prefer_reported(solution.grid_complexity, float(sum(dofs) / dofs[0])),
        "contraction": solution.contraction,
        "asymptotic_contraction": solution.asymptotic_contraction,
        "memory": solution.memory,
        "choice": solution.choice,
        "advice": solution.advice,
        "tolerance": solution.tolerance,
        "energy_errors": np.asarray(solution.energy_errors).tolist(),
        "outcome": solution.outcome,
        "backward_error": solution.backward_error,
        "integral": _integral(mesh, solution, how),
    }


def _integral(mesh: Mesh, solution: Solution, how: Discretisation | None) -> Any:
    if how is None or not hasattr(how, "integrals"):
        return None
    return how.integrals(mesh, solution.x).sum(axis=0).tolist()


def _numbers(value: float | list[float]) -> str:
    """Format a number, or a vector in parentheses."""
    return f"({', '.join(f'{each:.8g}' for each in value)})" if isinstance(value, list) else f"{value:.8g}"


def error_entries(norms: Mapping[str, float]) -> dict[str, float | None]:
    """Return error norms as report entries, with None for usual norms that are unknown."""
    known = {f"error_{name}": float(value) for name, value in norms.items()}
    return {**dict.fromkeys(_USUAL_ERRORS), **known}


def operator_complexity(solution: Solution) -> float | None:
    """Return the matrix entries of all levels divided by those of the finest, or None if unavailable."""
    entries = [_entries(A) for A in _matrices(solution)]
    known = [count for count in entries if count is not None]
    return float(sum(known) / known[0]) if len(known) == len(entries) else None


def _parts(mesh: Mesh, solution: Solution, dofs: list[int]) -> list[int | None]:
    """Return the agglomerate count per level, as reported or computed from the unknowns per cell.

    The number is None where the unknowns are not divisible.
    """
    if solution.parts:
        return list(solution.parts)
    counts = [divmod(n * mesh.n_cells, dofs[0]) for n in dofs]
    return [None if rest else count for count, rest in counts]


def _prefer_reported(reported: float | None, computed: float | None) -> float | None:
    return computed if reported is None else reported


def _entries(A: Any) -> int | None:
    return int(np.count_nonzero(A)) if isinstance(A, np.ndarray) else getattr(A, "nnz", None)


def _matrices(solution: Solution) -> list[Any]:
    """Return the level matrices, finest first, or the system matrix for solvers without levels."""
    return [A for A, _ in solution.operators] or [solution.A]


def _solved_system(solution: Solution) -> tuple[Float, Float]:
    """Return unknowns and right-hand side of the system that was solved, without an offset."""
    lifting = solution.lifting
    return (solution.x, solution.b) if lifting is None else (lifting.rest, lifting.load)


def _plain_cg(
    solution: Solution,
    tolerance: float | None,
    measure: Callable[[Float], float],
    progress: Listener | None,
) -> int | None:
    if tolerance is None or may_be_nonsymmetric(solution.problem):
        return None
    b, energy = _solved_system(solution)[1], getattr(measure, "energy", None)
    with phase(progress, "counting iterations of plain CG") as notify:
        history = conjugate_gradients(solution.A, b, tolerance, measure=measure, energy=energy, notify=notify)
    return history.iterations if history.converged else None


def _state(data: Mapping[str, Any]) -> str:
    """Describe the outcome, with residual and energy error."""
    met = f" by {' and '.join(data['tests_met'])}" if data["tests_met"] else ""
    state = f"converged after {data['iterations']} iterations ({data['reason']}{met})"
    if not data["converged"]:
        last = f"the solution is from iteration {data['iterations']}"
        state = f"{data['outcome'].upper()}: {data['reason']}; {last}"
    state = f"{state}, relative residual {data['relative_residual']:.2e}"
    return state if data["energy_error"] is None else f"{state}, energy error {data['energy_error']:.2e}"


def text(title: str, data: Mapping[str, Any], columns: int = _COLUMNS) -> str:
    """Format the report as text with at most ``columns`` columns."""
    lines = [f"{title}: {_levels(data['levels'])}"]
    lines += [f"solver: {data['choice']}"] if data["choice"] else []
    lines.append(_state(data))
    if data["cg_iterations"] is not None:
        lines.append(f"plain conjugate gradients: {data['cg_iterations']} iterations")
    integral = "" if data.get("integral") is None else f", integral of u {_numbers(data['integral'])}"
    lines += [f"energy fᵀu {data['energy']:.8g}{integral}"]
    outflow = [f"{tag}: {_numbers(flux)}" for tag, flux in data.get("boundary_fluxes", {}).items()]
    vectors = any(isinstance(flux, list) for flux in data.get("boundary_fluxes", {}).values())
    title = "force on the boundary" if vectors else "flux out of the boundary"
    lines += [f"{title} with tag {', '.join(outflow)}"] if outflow else []
    lines.append(_costs(data))
    errors = {
        name.removeprefix("error_").upper(): each for name, each in data.items() if name.startswith("error_")
    }
    known = [f"{name} {value:.3e}" for name, value in errors.items() if value is not None]
    if known:
        lines.append(f"error: {', '.join(known)}")
    lines += [
        f"{name}: {_seconds(data[key])}"
        for name, key in (("clock", "seconds"), ("processor", "cpu_seconds"))
        if data[key]
    ]
    lines += [f"advice: {data['advice']}"] if data["advice"] else []
    return "\n".join(_wrap_line(line, columns) for line in lines)


def _levels(levels: Sequence[Mapping[str, Any]]) -> str:
    """Format the number of agglomerates per level, or of unknowns if a level has no agglomerates."""
    cells, dofs = ([level[name] for level in levels] for name in ("cells", "dofs"))
    if None not in cells:
        return f"{dofs[0]:,} unknowns, cells {_chain(cells)}"
    return f"{'' if cells[0] is None else f'cells {cells[0]:,}, '}unknowns {_chain(dofs)}"


def _chain(counts: Sequence[int]) -> str:
    return " → ".join(f"{n:,}" for n in counts)


def _costs(data: Mapping[str, Any]) -> str:
    complexity, contraction = data["operator_complexity"], data["contraction"]
    costs = ["operator complexity " + ("unknown" if complexity is None else f"{complexity:.2f}")]
    costs.append(f"grid complexity {data['grid_complexity']:.2f}")
    if contraction is not None:
        costs.append(f"contraction {contraction:.3g}")
    if data["memory"] is not None:
        costs.append(f"memory {data['memory'] / 1e6:.1f}{_TIE}MB")
    return ", ".join(each.replace(" ", _TIE) for each in costs)


def _seconds(seconds: Mapping[str, float]) -> str:
    return ", ".join(f"{name}{_TIE}{value:.2f}{_TIE}s" for name, value in seconds.items())


def _wrap_line(line: str, columns: int) -> str:
    folded = textwrap.fill(
        line, columns, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )
    return folded.replace(_TIE, " ")
