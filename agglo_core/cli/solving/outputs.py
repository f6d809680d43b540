"""Output of ``agglo solve``: convergence picture and report."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agglo_core.cli.output.files import Outputs, check_picture, check_report
from agglo_core.progress import Listener, phase

if TYPE_CHECKING:
    from agglo_core.measure.comparison import RunResult
    from agglo_core.mesh import Mesh
    from agglo_core.problems import Solution

_HIERARCHY = "hierarchy"


def check_more(history: Path | None, report: Path | None) -> None:
    """Raise FileError if picture or report can foreseeably not be written."""
    if history is not None:
        check_picture(history, "--plot-convergence")
    if report is not None:
        check_report(report)


def levelless_run(mesh: Mesh) -> RunResult:
    """Return a run without levels, for solvers that need none or build their own."""
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.measure.comparison import RunResult

    return RunResult("", Hierarchy(mesh, mesh.graph, [], [], nested=True))


def levels_run(mesh: Mesh, agglomeration: Mapping[str, Any], progress: Listener | None) -> RunResult:
    """Build the hierarchy and measure the time, without level metrics."""
    from agglo_core.agglomeration import agglomerate
    from agglo_core.measure.comparison import RunResult

    start, cpu_start = time.perf_counter(), time.process_time()
    hierarchy = agglomerate(mesh, **agglomeration, progress=progress)
    seconds, cpu_seconds = time.perf_counter() - start, time.process_time() - cpu_start
    return RunResult(hierarchy.statistics["bisector"], hierarchy, (), seconds, "", cpu_seconds)


def with_hierarchy(solution: Solution, made: RunResult) -> Solution:
    """Add the time to build the hierarchy to a solution, if it has levels."""
    if made.hierarchy is None or not made.hierarchy.levels:
        return solution
    return replace(
        solution,
        seconds={_HIERARCHY: made.seconds, **solution.seconds},
        cpu_seconds={_HIERARCHY: made.cpu_seconds, **solution.cpu_seconds} if solution.cpu_seconds else {},
    )


def draw_history(
    outputs: Outputs, path: Path, title: str, solutions: Mapping[str, Solution], progress: Listener | None
) -> None:
    """Draw residuals and energy errors against the iteration, and write the picture."""
    from agglo_core.draw.convergence import draw_convergence

    with phase(progress, "drawing", path.name):
        outputs.picture(path, lambda: draw_convergence(solutions, path, title))


def report_solution(
    outputs: Outputs,
    path: Path,
    mesh: Mesh,
    made: RunResult,
    note: str,
    solves: Mapping[str, Mapping[str, Any]],
    progress: Listener | None,
) -> None:
    """Write the report with the solution, and the levels if any were built."""
    from agglo_core.draw.webpage import write_page
    from agglo_core.measure.agglomerates import measure_levels

    def make() -> None:
        runs = []
        if made.hierarchy is not None and made.hierarchy.levels:
            runs = [replace(made, levels=measure_levels(mesh, made.hierarchy))]
        write_page(path, mesh, runs, note, solves=solves)

    with phase(progress, "writing", path.name):
        outputs.picture(path, make)
