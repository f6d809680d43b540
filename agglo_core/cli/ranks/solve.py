"""``agglo solve`` on several MPI ranks: each rank solves on its own cells, and rank 0 reports.

A distributed solver has a method ``solve_across(problem, hierarchy, progress)`` for a distributed
hierarchy. ``x`` in its result holds the own cells' unknowns by increasing global id.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agglo_core.cli.output.console import print_json
from agglo_core.cli.output.files import Outputs, refuse_input
from agglo_core.cli.output.stdout import terminal_columns
from agglo_core.cli.output.tables import print_lines
from agglo_core.cli.ranks.launch import find_launch
from agglo_core.cli.ranks.run import agglomerate_on_ranks, read_shared_mesh, warm_up_in_turn
from agglo_core.cli.runs import show_progress
from agglo_core.cli.solving.choice import pose_problem, solver_title
from agglo_core.errors import AggloError, OptionError
from agglo_core.progress import phase
from agglo_core.registry.attribution import attributed

if TYPE_CHECKING:
    from agglo_core.distributed import DistributedHierarchy

NOT_CONVERGED = 3  # exit code
_COLUMNS = 80  # maximum width of the text


def solves_across(tool: object) -> bool:
    """Return True if there are several MPI ranks and the solver supports distributed meshes."""
    shares = hasattr(tool, "solve_across") and getattr(tool, "ranks", "one") == "one"
    return find_launch() is not None and shares


def solve_on_ranks(
    source: str,
    solver: str,
    tool: Any,
    problem: str,
    agglomeration: Mapping[str, Any],
    output: Path | None = None,
    *,
    as_json: bool,
) -> int:
    """Distribute a mesh, agglomerate, solve and report, with the options of ``agglo solve``.

    Raises
    ------
    AggloError
        On all ranks.
    """
    from agglo_core.distributed import Ranks, error_norms, with_second_layer, write_solution
    from agglo_core.distributed.files.writing import check_parallel_target

    if not agglomeration:
        raise OptionError("runs on several ranks need a target: give --parts, --cells-per-part, …")
    ranks, title = Ranks(), solver_title(solver)
    # Refuse bad output paths before any work.
    with ranks.together():
        if output is not None:
            check_parallel_target(output)
            refuse_input(source, output)
    first, outputs = ranks.rank == 0, Outputs()
    # Read, pose the problem, agglomerate, solve, write and measure on all ranks.
    with show_progress(not first) as progress:
        with phase(progress, "reading", source):
            mesh = read_shared_mesh(source, ranks)
        # Rows are assembled on the mesh with a second layer, so cell values refer to it.
        assembly_mesh, _ = with_second_layer(mesh)
        trusted = bool(agglomeration.get("allow_code"))
        with ranks.together():
            posed = pose_problem(problem, assembly_mesh, tool, solver, allow_code=trusted)
            if output is not None:
                posed.refuse_without_meaning("-o is")
        warm_up_in_turn(agglomeration, ranks)
        hierarchy, seconds, _ = agglomerate_on_ranks(mesh, agglomeration, False, progress)
        with attributed(title, spare=(AggloError,)):
            solution = tool.solve_across(posed.problem, hierarchy, progress if first else None)
        if output is not None:
            with phase(progress, "writing", output.name), attributed(title, spare=(AggloError,)):
                discretisation = posed.how
                assert discretisation is not None  # checked before
                outputs.result(output, lambda: write_solution(output, mesh, discretisation, solution.x))
        with phase(progress, "measuring", "errors"), attributed(title, spare=(AggloError,)):
            norms = error_norms(mesh, posed.problem, posed.how, solution.x) if posed.how is not None else {}
    if first:
        data = _report(solution, norms, hierarchy, seconds)
        if as_json:
            print_json(data | {"ranks": ranks.size})
        else:
            from agglo_core.solvers import solution_report

            columns = min(_COLUMNS, terminal_columns() or _COLUMNS)
            name = mesh.local.name or source
            print_lines(solution_report.text(f"{name} on {ranks.size} ranks, {solver}", data, columns))
    return outputs.finish(listed=not as_json) or (0 if solution.converged else NOT_CONVERGED)


def _report(
    solution: Any, norms: Mapping[str, float], hierarchy: DistributedHierarchy, seconds: float
) -> dict[str, Any]:
    """Return a distributed solution's report data, with the same keys as without ranks.

    They are those of :func:`agglo_core.solvers.solution_report.report`.
    """
    from agglo_core.solvers.solution_report import error_entries

    cells = [hierarchy.mesh.n_cells, *hierarchy.parts]
    residuals, (n, entries) = solution.residuals, solution.sizes[0]
    fell = residuals[-1] / residuals[0] if solution.iterations and residuals[0] > 0.0 else None
    return {
        "dofs": n,
        "levels": [
            {"cells": count, "dofs": dofs, "nonzeros": k}
            for count, (dofs, k) in zip(cells, solution.sizes, strict=False)
        ],
        "iterations": solution.iterations,
        "converged": solution.converged,
        "reason": solution.reason,
        "relative_residual": solution.relative_residual,
        "energy_error": solution.energy_error,
        "tests_met": list(solution.tests),
        "residuals": residuals.tolist(),
        **error_entries(norms),
        "energy": solution.energy,
        "operator_complexity": sum(k for _, k in solution.sizes) / entries,
        "grid_complexity": sum(k for k, _ in solution.sizes) / n,
        "cg_iterations": None,
        "seconds": {"hierarchy": seconds, **solution.seconds},
        "cpu_seconds": {},
        "contraction": None if fell is None else float(fell ** (1.0 / solution.iterations)),
        "memory": solution.memory,
        "choice": solution.choice,
        "advice": "",
        "outcome": "converged" if solution.converged else "not converged",
    }
