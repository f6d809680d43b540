"""``agglo solve``: agglomerate, solve a problem with any solver, report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from agglo_core.cli.options.agglomeration import FILE, agglomeration_options
from agglo_core.cli.options.completion import meshes, names
from agglo_core.cli.options.numbers import Number
from agglo_core.cli.options.shared import COMPONENT
from agglo_core.cli.options.specs import as_typed, load_mesh
from agglo_core.cli.output.console import explain_compilation, print_json
from agglo_core.cli.output.files import Outputs
from agglo_core.cli.output.stdout import OwnCommand, terminal_columns
from agglo_core.cli.output.tables import print_lines
from agglo_core.cli.ranks.launch import find_launch, refuse_files, refuse_on_ranks
from agglo_core.cli.ranks.solve import NOT_CONVERGED, solve_on_ranks, solves_across
from agglo_core.cli.runs import show_progress
from agglo_core.cli.solving.adaptation import AdaptRequest, refuse_goals, refuse_without_adaptation
from agglo_core.cli.solving.choice import DEFAULT_SOLVER, Posed, build_solver, pose_problem, solver_title
from agglo_core.cli.solving.outputs import (
    SolutionFiles,
    draw_history,
    levelless_run,
    levels_run,
    report_solution,
    with_hierarchy,
)
from agglo_core.errors import AggloError
from agglo_core.progress import Listener, phase
from agglo_core.registry.attribution import Member, attributed

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.measure.comparison import RunResult
    from agglo_core.mesh import Mesh
    from agglo_core.problems import Samples, Solution

_COLUMNS = 80  # maximum width of the text


@click.command(cls=OwnCommand, short_help="Solve a problem with multigrid on a hierarchy.")
@click.argument("source", metavar="MESH|SAMPLE", shell_complete=meshes)
@click.option(
    "--solver", default=DEFAULT_SOLVER, show_default=True, metavar=COMPONENT, shell_complete=names("solver")
)
@agglomeration_options(bisector="one")
@click.option("--levels", type=Number(int), help="Number of levels to use, the mesh included (default all).")
@click.option("--degree", type=Number(int), help="Polynomial degree (default: the solver's).")
@click.option(
    "--discretisation",
    metavar=COMPONENT,
    help="Discretisation, such as vem (default: the solver's).",
    shell_complete=names("discretisation"),
)
@click.option("--smoothing-steps", type=Number(int), help="Steps before and after each coarse correction.")
@click.option("--tol", "tolerance", type=float, help="Relative residual and energy error to reach.")
@click.option(
    "--problem",
    default="constant",
    show_default=True,
    metavar="NAME[:opt=val,…]|FILE.toml",
    shell_complete=names("problem"),
)
@click.option(
    "--cg/--no-cg",
    default=True,
    help="Also count the iterations of plain CG (default; slow on large meshes).",
)
@click.option("-o", "--output", type=FILE, help="Solution, sampled in every cell (.vtu; on ranks .pvtu).")
@click.option("--fluxes", type=FILE, help="Faces with the fluxes through them (.vtu); also reports the sums.")
@click.option("--plot", type=FILE, help="Picture of the solution (.png, .pdf, .svg).")
@click.option(
    "--plot-convergence",
    "history",
    type=FILE,
    help="Plot of residual and energy error by iteration (.png, .pdf, .svg).",
)
@click.option("--report", type=FILE, help="Web page with levels, costs and convergence (.html).")
@click.option(
    "--write-system",
    "system_file",
    type=FILE,
    help="A, b, near-null vectors and levels, for other solvers (.npz or .mtx).",
)
@click.option(
    "--adapt", is_flag=True, help="Refine agglomerates where the error is large, up to one of the two bounds."
)
@click.option("--tolerance", "accuracy", type=float, help="With --adapt: relative estimated error to reach.")
@click.option("--max-unknowns", type=Number(int, least=1), help="With --adapt: largest number of unknowns.")
@click.option(
    "--estimator",
    metavar=COMPONENT,
    shell_complete=names("estimator"),
    help="With --adapt: component that locates the error (default residual).",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
def solve(
    source: str,
    solver: str,
    agglomeration: Mapping[str, Any],
    levels: int | None,
    degree: int | None,
    discretisation: str | None,
    smoothing_steps: int | None,
    tolerance: float | None,
    problem: str,
    cg: bool,
    output: Path | None,
    fluxes: Path | None,
    plot: Path | None,
    history: Path | None,
    report: Path | None,
    system_file: Path | None,
    adapt: bool,
    accuracy: float | None,
    max_unknowns: int | None,
    estimator: str | None,
    as_json: bool,
) -> int:
    """Solve a problem on a mesh file or a sample: squares:n=64, voronoi:n=5000, paper:triangles, …

    The problem is −∇·(κ∇u) = f with u = 0 on the boundary: constant is f = 8, sine f = 2π² sin πx sin πy. A
    TOML file contains numbers by cell tag and boundary tag, or names the matrix of a linear system. Exit
    code 3: not converged, tolerance of --adapt not reached, or no picture.
    """
    goals = {"--tolerance": accuracy, "--max-unknowns": max_unknowns, "--estimator": estimator}
    refuse_goals(goals, adapt=adapt)
    options = {
        "levels": levels,
        "degree": degree,
        "discretisation": None if discretisation is None else as_typed(discretisation),
        "smoothing_steps": smoothing_steps,
        "tolerance": tolerance,
    }
    tool = build_solver(solver, {name: value for name, value in options.items() if value is not None})
    files = SolutionFiles(output, fluxes, plot, history, report, system_file)
    if adapt:
        refuse_without_adaptation({**files.by_option, "--levels": levels, "--no-cg": not cg or None})
        request = AdaptRequest(
            source, problem, tool, solver, agglomeration, accuracy, max_unknowns, estimator
        )
        return request.run(files, as_json=as_json)
    _refuse_one_process(tool, solver, files)
    if solves_across(tool):
        return solve_on_ranks(source, solver, tool, problem, agglomeration, output, as_json=as_json)
    files.check(source, solver, getattr(tool, "discretisation", None))
    explain_compilation()
    with show_progress() as progress:
        sampled_for = "-o, --fluxes and --plot are" if files.shows_solution else ""
        task = _task(source, problem, tool, solver, agglomeration, sampled_for, progress)
    return _solve_and_report(task, files, cg=cg, as_json=as_json)


@dataclass(frozen=True)
class _Task:
    """Problem on a mesh with a solver and the levels of a hierarchy, ready to be solved.

    Attributes
    ----------
    name : str
        Name of the mesh, or its source.
    problem, solver : str
        Problem and solver as typed.
    """

    name: str
    mesh: Mesh
    problem: str
    posed: Posed
    made: RunResult
    tool: Any
    solver: str

    @property
    def title(self) -> str:
        """Name of the solver for messages."""
        return solver_title(self.solver)

    @property
    def hierarchy(self) -> Hierarchy:
        """Hierarchy that supplies the levels."""
        assert self.made.hierarchy is not None
        return self.made.hierarchy

    def solution(self, progress: Listener | None) -> Solution:
        """Solve the problem with the levels of the hierarchy."""
        from agglo_core.problems.solving import run_solver

        solver = Member(self.tool, self.title)
        return with_hierarchy(run_solver(solver, self.posed.problem, self.hierarchy, progress), self.made)

    def report(self, solution: Solution, cg: bool, progress: Listener | None) -> dict[str, Any]:
        """Return the report data of a solution, on request compared with conjugate gradients (``cg``)."""
        from agglo_core.solvers import solution_report

        cg_tolerance = getattr(self.tool, "tolerance", 1e-6) if cg and not _is_plain_cg(self.tool) else None
        with attributed(self.title, spare=(AggloError,)):  # the report calls the discretisation
            return solution_report.report(
                self.mesh, self.posed.problem, solution, self.posed.how, cg_tolerance, progress
            )


def _task(
    source: str,
    problem: str,
    tool: Any,
    solver: str,
    agglomeration: Mapping[str, Any],
    sampled_for: str,
    progress: Listener | None,
) -> _Task:
    """Read the mesh, set up the problem and build the levels.

    ``sampled_for`` is the beginning of a message on options that need interpreted unknowns.
    """
    with phase(progress, "reading", source):
        mesh = load_mesh(source)
    trusted = bool(agglomeration.get("allow_code"))
    posed = pose_problem(problem, mesh, tool, solver, allow_code=trusted)
    if sampled_for:
        posed.refuse_without_meaning(sampled_for)
    # Solvers may not need levels, but requested levels are always built.
    needs_levels = getattr(tool, "needs_levels", True) and not _is_plain_cg(tool)
    levels = needs_levels or bool(agglomeration)
    result = levels_run(mesh, agglomeration, progress) if levels else levelless_run(mesh)
    return _Task(mesh.name or source, mesh, problem, posed, result, tool, solver)


def _solve_and_report(task: _Task, files: SolutionFiles, *, cg: bool, as_json: bool) -> int:
    """Solve, write the files, print the report, and return the exit code."""
    outputs = Outputs()
    with show_progress() as progress:
        if files.system is not None:
            _hand_over(outputs, files.system, task, progress)
        solution = task.solution(progress)
        sampled = _sampler(task, solution)
        if files.solution is not None:
            _write(outputs, files.solution, task.mesh, sampled, progress)
        data = task.report(solution, cg, progress)
        if files.fluxes is not None:
            data["boundary_fluxes"] = _write_fluxes(outputs, files.fluxes, task, solution, progress)
    if as_json and cg and _is_plain_cg(task.tool) and solution.converged:
        data["cg_iterations"] = solution.iterations
    _show(task, data, as_json=as_json)
    # Pictures come after the report: the user reads it while they are made.
    with show_progress() as progress:
        if files.plot is not None:
            _draw(outputs, files.plot, sampled, progress)
        if files.history is not None:
            title = f"{task.name}, {task.problem}"
            draw_history(outputs, files.history, title, {task.solver: solution}, progress)
        if files.report is not None:
            note, solves = f"problem {task.problem}", {task.solver: data}
            report_solution(outputs, files.report, task.mesh, task.made, note, solves, progress)
    return outputs.finish(listed=not as_json) or (0 if solution.converged else NOT_CONVERGED)


def _is_plain_cg(tool: object) -> bool:
    """Return True if a solver is the conjugate gradient method without multigrid levels."""
    return bool(getattr(tool, "plain_cg", False))


def _show(task: _Task, data: dict[str, Any], *, as_json: bool) -> None:
    """Print the report on a solution: costs per level and phase, and convergence."""
    if as_json:
        print_json(data)
        return
    from agglo_core.solvers import solution_report

    columns = min(_COLUMNS, terminal_columns() or _COLUMNS)
    print_lines(solution_report.text(f"{task.name}, {task.solver}", data, columns))


def _refuse_one_process(tool: object, solver: str, files: SolutionFiles) -> None:
    """Raise OptionError on several MPI ranks if the solver or a requested file needs a single process."""
    if find_launch() is None:
        return
    if getattr(tool, "ranks", "one") != "world" and not solves_across(tool):
        refuse_on_ranks(
            f"the solver {solver}", "use --solver petsc_mg, which distributes the mesh over processes"
        )
    single = files.by_option
    if solves_across(tool):
        del single["-o"]
    refuse_files(single, "solve in one process to get them")


def _sampler(task: _Task, solution: Solution) -> Callable[[], Samples]:
    """Return a function that evaluates the solution at sample points once, for file and picture."""

    @cache
    def sample_solution() -> Samples:
        with attributed(task.title, spare=(AggloError,)):
            return solution.samples()

    return sample_solution


def _write(
    outputs: Outputs, output: Path, mesh: Mesh, sampled: Callable[[], Samples], progress: Listener | None
) -> None:
    from agglo_core.io.vtk.solution import write_solution

    with phase(progress, "writing", output.name):
        outputs.result(output, lambda: write_solution(output, mesh, sampled()))


def _write_fluxes(
    outputs: Outputs, path: Path, task: _Task, solution: Solution, progress: Listener | None
) -> dict[int, Any]:
    """Write the fluxes through all faces, and return those out of the boundary, by boundary tag."""
    import numpy as np

    from agglo_core.io.vtk.solution import write_fluxes

    mesh = task.mesh
    with phase(progress, "writing", path.name):
        with attributed(task.title, spare=(AggloError,)):
            fluxes = solution.fluxes()
        outputs.result(path, lambda: write_fluxes(path, mesh, fluxes))
    tags = mesh.face_tags.get(getattr(task.posed.problem, "boundary", "boundary"))
    outer = np.flatnonzero(mesh.outer_faces)
    values = np.zeros(len(outer), int) if tags is None else tags[outer]
    return {int(value): fluxes[outer[values == value]].sum(axis=0).tolist() for value in np.unique(values)}


def _hand_over(outputs: Outputs, path: Path, task: _Task, progress: Listener | None) -> None:
    """Write the linear system before it is solved, so that the file exists even if the solver fails."""
    from agglo_core.io.system_files import write_system_and_levels

    with phase(progress, "writing", path.name):
        system = task.posed.system()
        outputs.result(path, lambda: write_system_and_levels(path, system, task.hierarchy.levels))


def _draw(outputs: Outputs, plot: Path, sampled: Callable[[], Samples], progress: Listener | None) -> None:
    from agglo_core.draw.solution import draw_solution

    with phase(progress, "drawing", plot.name):
        outputs.picture(plot, lambda: draw_solution(plot, sampled()))
