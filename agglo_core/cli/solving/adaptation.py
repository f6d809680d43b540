"""``agglo solve --adapt``: refine agglomerates where an estimator locates the error, and report the steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agglo_core.cli.options.specs import as_typed, load_mesh
from agglo_core.cli.output.console import explain_compilation, number, print_json
from agglo_core.cli.output.files import Outputs, check_picture, refuse_input
from agglo_core.cli.output.tables import print_lines, print_table
from agglo_core.cli.ranks.launch import find_launch, refuse_on_ranks
from agglo_core.cli.ranks.solve import NOT_CONVERGED
from agglo_core.cli.runs import show_progress
from agglo_core.cli.solving.choice import pose_problem
from agglo_core.cli.solving.outputs import levels_run
from agglo_core.errors import OptionError
from agglo_core.progress import phase

if TYPE_CHECKING:
    from agglo_core.adaptivity import Adaptation, AdaptationStep

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

    def run(self, output: Path | None, plot: Path | None, *, as_json: bool) -> int:
        """Adapt, write the solution, print the report, and return the exit code."""
        if find_launch() is not None:
            refuse_on_ranks("--adapt", "run it in one process")
        if output is not None and output.suffix.lower() != ".vtu":
            raise OptionError(f"{output}: solutions are written as .vtu")
        if plot is not None:
            check_picture(plot)
        refuse_input(self.source, output)
        explain_compilation()
        adaptation = self._adapt()
        outputs, samples = Outputs(), cache(adaptation.solution.samples)
        if output is not None:
            from agglo_core.io.vtk.solution import write_solution

            outputs.result(output, lambda: write_solution(output, adaptation.cut.mesh, samples()))
        self._show(adaptation, as_json=as_json)
        if plot is not None:
            from agglo_core.draw.solution import draw_solution

            outputs.picture(plot, lambda: draw_solution(plot, samples()))
        code = outputs.finish(listed=not as_json)
        wanted = "max_unknowns" if self.tolerance is None else "tolerance"
        return code or (0 if adaptation.reason in (wanted, "tolerance") else NOT_CONVERGED)

    def _adapt(self) -> Adaptation:
        from agglo_core.adaptivity import adapt

        with show_progress() as progress:
            with phase(progress, "reading", self.source):
                mesh = load_mesh(self.source)
            trusted = bool(self.agglomeration.get("allow_code"))
            posed = pose_problem(self.problem, mesh, self.tool, self.solver, allow_code=trusted)
            levels = levels_run(mesh, self.agglomeration, progress).hierarchy if self.agglomeration else None
            return adapt(
                mesh if levels is None else levels,
                posed.problem,  # type: ignore[arg-type]  # adapt checks the kind
                tolerance=self.tolerance,
                max_unknowns=self.max_unknowns,
                estimator="residual" if self.estimator is None else as_typed(self.estimator),
                solver=self.tool,
                progress=progress,
            )

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
        print_lines(f"ended after {len(steps)} steps: {_ENDS[adaptation.reason]}")


def refuse_goals(goals: Mapping[str, Any], *, adapt: bool) -> None:
    """Raise OptionError for options of ``--adapt`` without it, or for ``--adapt`` without a bound."""
    given = [name for name, value in goals.items() if value is not None]
    if given and not adapt:
        raise OptionError(f"{given[0]} is an option of --adapt; the solver's tolerance is --tol")
    if adapt and not {"--tolerance", "--max-unknowns"} & set(given):
        raise OptionError("--adapt needs a bound: give --tolerance, --max-unknowns or both")


def refuse_without_adaptation(options: Mapping[str, Any]) -> None:
    """Raise OptionError for the first given option that ``--adapt`` does not support."""
    given = [name for name, value in options.items() if value is not None and name != "--plot"]
    if given:
        raise OptionError(f"{given[0]} is not available with --adapt")


def _data(step: AdaptationStep) -> dict[str, Any]:
    names = ("parts", "unknowns", "estimate", "relative", "oscillation", "iterations", "converged", "seconds")
    return {name: getattr(step, name) for name in names} | {"errors": dict(step.errors)}
