"""``agglo solve --adapt``: refine agglomerates where an estimator locates the error, and report the steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agglo_core.cli.options.specs import as_typed, load_mesh
from agglo_core.cli.output.console import explain_compilation, number, print_json
from agglo_core.cli.output.files import Outputs
from agglo_core.cli.output.tables import print_lines, print_table
from agglo_core.cli.ranks.launch import find_launch, refuse_on_ranks
from agglo_core.cli.ranks.solve import NOT_CONVERGED
from agglo_core.cli.runs import show_progress
from agglo_core.cli.solving.choice import pose_problem
from agglo_core.cli.solving.outputs import SolutionFiles, levels_run
from agglo_core.errors import OptionError
from agglo_core.progress import Listener, phase

if TYPE_CHECKING:
    from agglo_core.adaptivity import Adaptation, AdaptationStep
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh
    from agglo_core.problems import Problem, Solution

_MORE = 10
"""Uniform levels in the report have at most this many times the parts of the adapted mesh."""
_ENDS = {
    "tolerance": "the tolerance is reached",
    "max_unknowns": "the largest number of unknowns is reached",
    "fine mesh": "the mesh has no finer parts where the error is",
    "solver": "the solver did not converge",
}


@dataclass(frozen=True)
class AdaptRequest:
    """Arguments of ``agglo solve --adapt``.

    Attributes
    ----------
    source, problem, solver : str
        Mesh, problem and solver as typed.
    tool : object
        The solver.
    agglomeration : mapping
        Options of the levels; without any, :func:`agglo_core.adapt` makes its own.
    tolerance, max_unknowns : number, optional
    estimator : str, optional
        Estimator as typed.
    """

    source: str
    problem: str
    tool: Any
    solver: str
    agglomeration: Mapping[str, Any]
    tolerance: float | None
    max_unknowns: int | None
    estimator: str | None

    def run(self, files: SolutionFiles, *, as_json: bool) -> int:
        """Adapt, write the solution, print the report, and return the exit code."""
        if find_launch() is not None:
            refuse_on_ranks("--adapt", "run it in one process")
        files.check(self.source, self.solver, getattr(self.tool, "discretisation", None))
        explain_compilation()
        with show_progress() as progress:
            on, problem = self._posed(progress)
            adaptation = self._adapted(on, problem, self.tolerance, self.max_unknowns, progress)
        mesh, shown = _samplable(adaptation)
        outputs, samples = Outputs(), cache(shown.samples)
        if (output := files.solution) is not None:
            from agglo_core.io.vtk.solution import write_solution

            outputs.result(output, lambda: write_solution(output, mesh, samples()))
        self._show(adaptation, as_json=as_json)
        if (plot := files.plot) is not None:
            from agglo_core.draw.solution import draw_solution

            outputs.picture(plot, lambda: draw_solution(plot, samples()))
        if (report := files.report) is not None:
            outputs.picture(report, lambda: self._report(report, adaptation, problem))
        code = outputs.finish(listed=not as_json)
        wanted = "max_unknowns" if self.tolerance is None else "tolerance"
        return code or (0 if adaptation.reason in (wanted, "tolerance") else NOT_CONVERGED)

    def _posed(self, progress: Listener | None) -> tuple[Mesh | Hierarchy, Problem]:
        """Read the mesh and the problem, and agglomerate if there are options of the levels."""
        with phase(progress, "reading", self.source):
            mesh = load_mesh(self.source)
        trusted = bool(self.agglomeration.get("allow_code"))
        posed = pose_problem(self.problem, mesh, self.tool, self.solver, allow_code=trusted)
        levels = levels_run(mesh, self.agglomeration, progress).hierarchy if self.agglomeration else None
        return mesh if levels is None else levels, posed.problem

    def _adapted(
        self,
        on: Mesh | Hierarchy,
        problem: Problem,
        tolerance: float | None,
        max_unknowns: int | None,
        progress: Listener | None = None,
    ) -> Adaptation:
        from agglo_core.adaptivity import adapt

        return adapt(
            on,
            problem,  # type: ignore[arg-type]  # adapt checks the kind
            tolerance=tolerance,
            max_unknowns=max_unknowns,
            estimator="residual" if self.estimator is None else as_typed(self.estimator),
            solver=self.tool,
            progress=progress,
        )

    def _report(self, path: Path, adaptation: Adaptation, problem: Problem) -> None:
        """Write a web page with the adapted mesh, its indicators, and estimates on uniform levels."""
        from agglo_core.draw.webpage import write_page
        from agglo_core.hierarchy import Hierarchy
        from agglo_core.measure.agglomerates import measure_levels
        from agglo_core.measure.comparison import RunResult
        from agglo_core.solvers import solution_report

        cut, solution = adaptation.cut, adaptation.solution
        mesh = adaptation.hierarchy.fine
        assert mesh is not None
        one = Hierarchy(mesh, mesh.graph, [cut.labels], [{"n_parts": cut.n_parts}], nested=True)
        (level,) = measure_levels(mesh, one)
        values = {"estimate": adaptation.indicators, **level.values}
        level = replace(level, values=values, metrics=("estimate", *level.metrics))
        assert solution.problem is not None
        data = solution_report.report(cut.mesh, solution.problem, solution, solution.discretisation)
        curves = {"adapted": adaptation.steps, "uniform levels": self._uniform_steps(adaptation, problem)}
        write_page(
            path,
            mesh,
            [RunResult("adapted mesh", one, [level])],
            f"problem {self.problem}",
            solves={self.solver: data},
            estimates={
                name: [(step.unknowns, step.estimate) for step in steps]
                for name, steps in curves.items()
                if steps
            },
        )

    def _uniform_steps(self, adaptation: Adaptation, problem: Problem) -> list[AdaptationStep]:
        """Solve on each level that has at most ``_MORE`` times the parts of the adapted mesh."""
        from agglo_core.hierarchy import Hierarchy

        hierarchy = adaptation.hierarchy
        steps: list[AdaptationStep] = []
        for labels, target in list(zip(hierarchy.levels, hierarchy.targets, strict=True))[::-1]:
            if labels.max() < _MORE * adaptation.cut.n_parts:
                level = Hierarchy(hierarchy.fine, hierarchy.graph, [labels], [target], nested=True)
                steps += self._adapted(level, problem, None, 1).steps
        return steps

    def _show(self, adaptation: Adaptation, *, as_json: bool) -> None:
        if as_json:
            steps = [_data(step) for step in adaptation.steps]
            print_json({"mesh": self.source, "reason": adaptation.reason, "steps": steps})
            return
        title = f"{self.source}, {self.solver}: adapted mesh"
        steps = [_data(step) for step in adaptation.steps]
        names = [name for name in steps[0]["errors"] if name in ("dg", "energy", "l2")]
        rows = [
            [
                *(f"{step[name]:,}" for name in ("parts", "unknowns")),
                *(number(step[name]) for name in ("estimate", "relative")),
                *(number(step["errors"][name]) for name in names),
                str(step["iterations"]),
            ]
            for step in steps
        ]
        errors = [f"error {name.upper()}" for name in names]
        print_table(title, ["parts", "unknowns", "estimate", "relative", *errors, "iterations"], rows)
        print_lines(f"ended after {len(steps)} step{'s' * (len(steps) > 1)}: {_ENDS[adaptation.reason]}")


def _samplable(adaptation: Adaptation) -> tuple[Mesh, Solution]:
    """Return mesh and solution, in 3-D on the cells: agglomerates of polyhedra are seldom star-shaped."""
    solution, cut = adaptation.solution, adaptation.cut
    if cut.mesh.dim == 2 or not hasattr(solution.discretisation, "transfer"):
        return cut.mesh, solution
    cells = adaptation.hierarchy.cut_at(-1)
    return cells.mesh, solution.transfer(cut, cells)


def refuse_goals(goals: Mapping[str, Any], *, adapt: bool) -> None:
    """Raise OptionError for options of ``--adapt`` without it, or for ``--adapt`` without a bound."""
    given = [name for name, value in goals.items() if value is not None]
    if given and not adapt:
        raise OptionError(f"{given[0]} is an option of --adapt; the solver's tolerance is --tol")
    if adapt and not {"--tolerance", "--max-unknowns"} & set(given):
        raise OptionError("--adapt needs a bound: give --tolerance, --max-unknowns or both")


def refuse_without_adaptation(options: Mapping[str, Any]) -> None:
    """Raise OptionError for the first given option that ``--adapt`` does not support."""
    given = [
        name
        for name, value in options.items()
        if value is not None and name not in ("-o", "--plot", "--report")
    ]
    if given:
        raise OptionError(f"{given[0]} is not available with --adapt")


def _data(step: AdaptationStep) -> dict[str, Any]:
    names = ("parts", "unknowns", "estimate", "relative", "oscillation", "iterations", "converged", "seconds")
    return {name: getattr(step, name) for name in names} | {"errors": dict(step.errors)}
