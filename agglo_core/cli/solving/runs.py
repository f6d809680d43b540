"""Solutions with the hierarchy of each run in ``agglo compare --solve``, with their costs."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from agglo_core.cli.output.console import number
from agglo_core.cli.output.tables import print_lines, print_table
from agglo_core.cli.runs import format_ratio
from agglo_core.cli.solving.choice import Posed, solver_title
from agglo_core.cli.solving.outputs import with_hierarchy
from agglo_core.cli.stopping import find_interrupt
from agglo_core.errors import AggloError
from agglo_core.progress import Listener, Progress, labelled
from agglo_core.registry.attribution import Member, attributed

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.measure.comparison import RunResult
    from agglo_core.problems import Solution

_LAST_PHASE = "solving"
_COLUMNS = ("iterations", "converged", "contraction", "hierarchy s", "set-up s", "solve s")


@dataclass(frozen=True)
class Solved:
    """A solver's iterations, convergence and cost with one hierarchy, or its error message.

    ``contraction`` is the geometric mean of the factors by which an iteration reduces the residual's 2-norm.
    ``seconds`` are CPU seconds for the hierarchy, for everything before the iteration (assembly included,
    None if the solver does not report phases), and for the rest. ``details`` are data for a report, if
    requested.
    """

    iterations: int | None = None
    converged: bool = False
    contraction: float | None = None
    reason: str = ""
    seconds: Mapping[str, float | None] = field(default_factory=dict)
    error: str = ""
    details: Mapping[str, Any] = field(default_factory=dict)

    def data(self) -> dict[str, Any]:
        """Return the result in JSON types, as printed by ``--json``."""
        return {
            "iterations": self.iterations,
            "converged": self.converged,
            "contraction": self.contraction,
            "reason": self.reason or None,
            "seconds": dict(self.seconds),
            "error": self.error or None,
        }

    def cells(self) -> list[str]:
        """Return the texts of its row in the table."""
        if self.error:
            return ["–"] * len(_COLUMNS)
        state = [number(self.iterations), "yes" if self.converged else "no"]
        seconds = ["–" if s is None else f"{s:.2f}" for s in self.seconds.values()]
        return [*state, "–" if self.contraction is None else f"{self.contraction:.3g}", *seconds]

    @property
    def remark(self) -> str:
        """Remark below the table: the error or the reason for no convergence, else empty."""
        return self.error or ("" if self.converged else f"not converged: {self.reason}")


@dataclass
class _Clock:
    """Progress listener that measures the CPU time of the last phase, and forwards all reports."""

    listen: Listener | None
    seconds: float = 0.0
    seen: bool = False
    _since: float | None = None

    def __call__(self, now: Progress) -> None:
        if now.phase.startswith(_LAST_PHASE):
            if now.fraction >= 1.0 and self._since is not None:
                self.seconds += time.process_time() - self._since
                self._since = None
            elif self._since is None and now.fraction == 0.0:
                self._since, self.seen = time.process_time(), True
        if self.listen is not None:
            self.listen(now)


def solve_runs(
    posed: Posed,
    tool: Any,
    spec: str,
    runs: Sequence[RunResult],
    progress: Listener | None,
    *,
    detailed: bool = False,
) -> list[Solved]:
    """Solve a problem with the hierarchy of each run. Failures become results with their reason."""
    solver = Member(tool, solver_title(spec))
    _warm_up(solver, posed)
    return [_attempt(solver, posed, run, labelled(progress, run.name), detailed) for run in runs]


def collect_reports(runs: Sequence[RunResult], solved: Sequence[Solved]) -> dict[str, Mapping[str, Any]]:
    """Return the report data of the solution with each run, by run name."""
    pairs = zip(runs, solved, strict=False)
    return {run.name: result.details or {"error": result.error} for run, result in pairs if not run.error}


def _attempt(
    solver: Member, posed: Posed, run: RunResult, progress: Listener | None, detailed: bool
) -> Solved:
    from agglo_core.problems.solving import run_solver

    if run.hierarchy is None:
        return Solved(error=run.error)
    clock, start = _Clock(progress), time.process_time()
    try:
        solution = run_solver(solver, posed.problem, run.hierarchy, clock)
    except AggloError as error:
        if find_interrupt(error) is not None:
            raise
        return Solved(error=str(error))
    # Without progress reports, set-up and solve cannot be separated.
    total = time.process_time() - start
    has_phases = clock.seen and bool(getattr(solver.tool, "reports_progress", False))
    return Solved(
        iterations=int(solution.iterations),
        converged=bool(solution.converged),
        contraction=_contraction(solution),
        reason=solution.reason,
        seconds={
            "hierarchy": run.cpu_seconds,
            "setup": total - clock.seconds if has_phases else None,
            "solve": clock.seconds if has_phases else total,
        },
        details=_details(solver, posed, run, solution, progress) if detailed else {},
    )


def _details(
    solver: Member, posed: Posed, run: RunResult, solution: Solution, progress: Listener | None
) -> dict[str, Any]:
    from agglo_core.solvers.solution_report import report

    whole = with_hierarchy(solution, run)
    try:
        with attributed(solver.title, spare=(AggloError,)):  # the report calls the discretisation
            return report(posed.mesh, posed.problem, whole, posed.how, progress=progress)
    except AggloError as error:
        if find_interrupt(error) is not None:
            raise
        return {"error": str(error)}


def _contraction(solution: Solution) -> float | None:
    if not solution.iterations or not solution.residuals[0] > 0.0:
        return None
    return float((solution.residuals[-1] / solution.residuals[0]) ** (1.0 / solution.iterations))


def _warm_up(solver: Member, posed: Posed) -> None:
    """Solve tiny examples, to keep imports and compilation out of the first solution's time."""
    from agglo_core import samples
    from agglo_core.problems.solving import run_solver

    for small in (samples.squares(8), samples.voronoi(64)):  # recipes differ for squares and polygons
        try:
            run_solver(solver, type(posed.problem).example(small), _agglomerate_small_mesh(small))  # type: ignore[attr-defined]
        except (AggloError, AttributeError) as error:
            if isinstance(error, AggloError) and find_interrupt(error) is not None:
                raise
            # otherwise the solution itself reports the error


def _agglomerate_small_mesh(mesh: Any) -> Hierarchy:
    from agglo_core.agglomeration import agglomerate

    return agglomerate(mesh, n_parts=(16, 4))


def show_solved(spec: str, problem: str, runs: Sequence[RunResult], solved: Sequence[Solved]) -> None:
    """Print a table with cost and shape metrics per run, and the reasons for failures."""
    first_level = next(level for run in runs for level in run.levels)
    metrics = list(first_level.metrics)
    rows = []
    for run, solution in zip(runs, solved, strict=True):
        shapes = [format_ratio(run.levels[0].line[name]) if run.levels else "–" for name in metrics]
        rows.append([run.name, *shapes, *solution.cells()])
    print_table(
        f"{problem} solved by {spec}; CPU seconds, set-up includes assembly; metrics of the finest level",
        ["bisector", *metrics, *_COLUMNS],
        rows,
        spare=[*reversed(metrics), "contraction", "hierarchy s"],
        fold={"bisector": 8},
    )
    failures = [
        (run, solution)
        for run, solution in zip(runs, solved, strict=True)
        if solution.remark and not run.error
    ]
    print_lines("\n".join(f"{run.name}: {solution.remark}" for run, solution in failures))
