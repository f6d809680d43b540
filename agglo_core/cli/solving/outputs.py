"""Output of ``agglo solve``: files, convergence picture and report."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agglo_core.cli.output.files import Outputs, check_picture, check_report, refuse_input
from agglo_core.errors import OptionError
from agglo_core.progress import Listener, phase

if TYPE_CHECKING:
    from agglo_core.measure.comparison import RunResult
    from agglo_core.mesh import Mesh
    from agglo_core.problems import Solution

_HIERARCHY = "hierarchy"


@dataclass(frozen=True)
class SolutionFiles:
    """Files that ``agglo solve`` writes, each optional.

    Attributes
    ----------
    solution, fluxes : Path
        Samples of the solution in the cells, and fluxes through the faces (.vtu).
    plot, history : Path
        Pictures of the solution, and of the convergence.
    report : Path
        Web page.
    system : Path
        Linear system and levels.
    """

    solution: Path | None = None
    fluxes: Path | None = None
    plot: Path | None = None
    history: Path | None = None
    report: Path | None = None
    system: Path | None = None

    @property
    def by_option(self) -> dict[str, Path | None]:
        """Files by the option of the command."""
        return {
            "-o": self.solution,
            "--fluxes": self.fluxes,
            "--plot": self.plot,
            "--plot-convergence": self.history,
            "--report": self.report,
            "--write-system": self.system,
        }

    @property
    def shows_solution(self) -> bool:
        """True if a file needs the meaning of the unknowns."""
        return any((self.solution, self.fluxes, self.plot))

    def check(self, source: str, solver: str, discretisation: object) -> None:
        """Check before the computation that all files can be written.

        Raises
        ------
        FileError
            If a file can foreseeably not be written, or is the input file ``source``.
        OptionError
            For a wrong suffix, or a discretisation that cannot supply the content.
        """
        if self.shows_solution and discretisation is None:
            raise OptionError(
                f"{solver} has no discretisation to interpret its unknowns: -o, --fluxes and --plot are not "
                "available"
            )
        if self.fluxes is not None and not hasattr(discretisation, "fluxes"):
            raise OptionError(f"the discretisation of {solver} has no fluxes: --fluxes is not available")
        for path, content in ((self.solution, "solutions"), (self.fluxes, "fluxes")):
            if path is not None:
                from agglo_core.io import check_writable

                if path.suffix.lower() != ".vtu":
                    raise OptionError(f"{path}: {content} are written as .vtu")
                check_writable(path)
        if self.plot is not None:
            check_picture(self.plot)
        if self.system is not None:
            from agglo_core.io.system_files import check_system_file

            check_system_file(self.system)
        refuse_input(source, self.solution, self.fluxes, self.system)
        if self.history is not None:
            check_picture(self.history, "--plot-convergence")
        if self.report is not None:
            check_report(self.report)


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
