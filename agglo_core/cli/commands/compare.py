"""``agglo compare``: compare bisectors and methods on one mesh."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from agglo_core.agglomeration.keywords import METHODS
from agglo_core.cli.options.agglomeration import FILE, agglomeration_options
from agglo_core.cli.options.completion import meshes, names
from agglo_core.cli.options.shared import COMPONENT, metrics_option
from agglo_core.cli.options.specs import all_bisectors, as_typed, choice, load_mesh, refuse_duplicates
from agglo_core.cli.output.console import explain_compilation, number, print_json, quieten
from agglo_core.cli.output.files import (
    Outputs,
    check_outputs,
    check_picture,
    draw_runs,
    weigh_runs,
)
from agglo_core.cli.output.stdout import OwnCommand
from agglo_core.cli.runs import (
    attempt,
    data,
    refuse_all_failed,
    refuse_metrics,
    run_data,
    show,
    show_progress,
)
from agglo_core.cli.solving.choice import DEFAULT_SOLVER, build_solver, pose_problem
from agglo_core.cli.solving.runs import Solved, collect_reports, show_solved, solve_runs
from agglo_core.errors import PluginError
from agglo_core.progress import phase
from agglo_core.registry import default

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from agglo_core.measure.comparison import RunResult
    from agglo_core.mesh import Mesh
    from agglo_core.progress import Listener


@dataclass(frozen=True)
class _Plan:
    """Bisector and method (recursive or k-way) of one run to be compared.

    ``lacks`` is the reason if the bisector does not support the method, ``broken`` if it cannot be built.
    """

    name: str
    spec: str
    method: str
    lacks: str = ""
    broken: str = ""


@click.command(cls=OwnCommand, short_help="Compare bisectors and methods on a mesh.")
@click.argument("source", metavar="MESH|SAMPLE", shell_complete=meshes)
@agglomeration_options(bisector="several", method="several")
@metrics_option
@click.option(
    "--solve",
    "solver",
    is_flag=False,
    flag_value=DEFAULT_SOLVER,
    metavar=f"[{COMPONENT}]",
    shell_complete=names("solver"),
    help=f"Also solve with each hierarchy and show iterations (default {DEFAULT_SOLVER}).",
)
@click.option(
    "--problem",
    metavar="NAME[:opt=val,…]|FILE.toml",
    shell_complete=names("problem"),
    help="Problem for --solve (default constant).",
)
@click.option(
    "--pareto",
    type=FILE,
    help="Plot of roundness, evenness and seconds of the runs, with the Pareto front.",
)
@click.option("--report", type=FILE, help="One web page with all levels and runs (.html).")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
@click.option("--quiet", is_flag=True, help="Print nothing but errors (and JSON with --json).")
def compare(
    source: str,
    bisectors: Sequence[str],
    methods: Sequence[str],
    agglomeration: Mapping[str, Any],
    metrics: list[Any] | None,
    solver: str | None,
    problem: str | None,
    pareto: Path | None,
    report: Path | None,
    as_json: bool,
    quiet: bool,
) -> int:
    """Compare bisectors, in the order given (default: all), on a mesh file or a sample.

    A failed run has its own line and makes the exit code 3. A method that a bisector does not implement is
    marked. Targets are as in agglo run. With --solve, a second table shows iterations and CPU seconds of a
    solver with each hierarchy. A solver that does not converge makes the exit code 3, too.
    """
    if quiet:
        quieten()
    refuse_duplicates("--bisector", bisectors)
    refuse_duplicates("--method", methods)
    # Check all options before any work.
    plans = _plans(bisectors or all_bisectors(), methods or [_configured_method(agglomeration)])
    if problem is not None and solver is None:
        raise click.UsageError("--problem needs --solve: give --solve or leave --problem out")
    tool = None if solver is None else build_solver(solver, {}, "--solve")
    check_outputs(source, None, None, report, ())
    if pareto is not None:
        check_picture(pareto, "--pareto")
    with show_progress(quiet) as progress:
        # Read, run and solve.
        with phase(progress, "reading", source):
            mesh = load_mesh(source)
        refuse_metrics(mesh, metrics)
        trusted = bool(agglomeration.get("allow_code"))
        problem_name = problem or "constant"
        posed = None if solver is None else pose_problem(problem_name, mesh, tool, solver, allow_code=trusted)
        if not quiet:
            explain_compilation()
        runs = [_carry_out(mesh, plan, agglomeration, metrics, progress) for plan in plans]
        refuse_all_failed(runs)
        detailed = report is not None
        solved = (
            [] if posed is None else solve_runs(posed, tool, str(solver), runs, progress, detailed=detailed)
        )
    # Print results, then write pictures and report.
    if as_json:
        records = [run_data(run, plan.spec, plan.method) for plan, run in zip(plans, runs, strict=True)]
        solve_data = {"solver": solver, "problem": problem_name} if solver else {}
        print_json(data(mesh, source, _with_solutions(records, solved)) | solve_data)
    elif not quiet:
        title = f"{mesh.name or source}: {mesh.n_cells:,} cells, h0 = {number(mesh.h)}"
        show(title, runs)
        if solver is not None:
            show_solved(solver, problem_name, runs, solved)
    outputs = Outputs()
    if pareto is not None:
        weigh_runs(outputs, mesh, runs, pareto)
    with show_progress(quiet) as progress:
        draw_runs(outputs, mesh, runs, None, report, metrics, progress, collect_reports(runs, solved))
    any_failed = any(run.error and not plan.lacks for plan, run in zip(plans, runs, strict=True))
    any_unsolved = any(
        not solution.converged and not plan.lacks for plan, solution in zip(plans, solved, strict=False)
    )
    return outputs.finish(listed=not (as_json or quiet)) or (3 if any_failed or any_unsolved else 0)


def _with_solutions(runs: list[dict[str, Any]], solved: Sequence[Solved]) -> list[dict[str, Any]]:
    """Return the report data for the runs, and for their solutions if problems were solved."""
    return [run | {"solve": each.data()} for run, each in zip(runs, solved, strict=True)] if solved else runs


def _configured_method(options: Mapping[str, Any]) -> str:
    """Return the method (recursive or k-way) of the configuration file, or the default method."""
    if "config" not in options:
        return METHODS[0]
    from agglo_core.agglomeration import Pipeline

    return Pipeline.from_toml(options["config"]).method


def _plans(specs: Sequence[str], methods: Sequence[str]) -> list[_Plan]:
    """Return all combinations of bisectors and methods to run, bisector by bisector.

    Components are built once to check their options. A plugin that cannot be built does not stop the others.

    Raises
    ------
    PluginError
        For an unknown or unusable bisector.
    OptionError
        For an unknown option or an invalid value.
    """
    plans = []
    for spec in specs:
        default().record("bisector", as_typed(spec)[0])
        lacking, broken = {}, ""
        try:
            lacking = _unimplemented_methods(spec)
        except PluginError as error:
            broken = str(error)
        for method in methods:
            name = spec if len(methods) == 1 else f"{spec} {method}"
            plans.append(_Plan(name, spec, method, lacking.get(method, ""), broken))
    return plans


def _unimplemented_methods(spec: str) -> dict[str, str]:
    """Return the methods that a bisector does not implement, with reasons."""
    from agglo_core.protocols import Bisector, LevelBisector, Partitioner

    name, options = choice("bisector", spec)
    tool = default().build("bisector", name, **options)
    lacking = {}
    if not isinstance(tool, Bisector | LevelBisector):
        lacking["recursive"] = "not implemented: it cannot bisect"
    if not isinstance(tool, Partitioner):
        lacking["kway"] = "not implemented: it has no k-way partition"
    return lacking


def _carry_out(
    mesh: Mesh,
    plan: _Plan,
    arguments: Mapping[str, Any],
    metrics: list[Any] | None,
    progress: Listener | None,
) -> RunResult:
    from agglo_core.measure.comparison import RunResult

    if plan.lacks or plan.broken:
        return RunResult(plan.name, None, error=plan.lacks or plan.broken)
    selection = {"bisector": choice("bisector", plan.spec), "method": plan.method}
    return attempt(mesh, plan.name, {**arguments, **selection}, metrics, progress)
