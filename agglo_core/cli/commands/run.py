"""``agglo run``: agglomerate a mesh with one or several bisectors, measure, draw, write."""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from agglo_core.cli.options.agglomeration import FILE, agglomeration_options
from agglo_core.cli.options.completion import meshes
from agglo_core.cli.options.numbers import Number
from agglo_core.cli.options.shared import metrics_option
from agglo_core.cli.options.specs import choice, load_mesh
from agglo_core.cli.output.console import explain_compilation, number, print_json, quieten
from agglo_core.cli.output.files import Outputs, check_outputs, draw_runs
from agglo_core.cli.output.stdout import OwnCommand
from agglo_core.cli.ranks.launch import refuse_files
from agglo_core.cli.ranks.run import is_of_ranks, run_on_ranks
from agglo_core.cli.runs import data, execute, level_data, refuse_metrics, show, show_progress
from agglo_core.progress import phase

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from agglo_core.hierarchy import Hierarchy
    from agglo_core.measure import Level, RunResult
    from agglo_core.mesh import Mesh
    from agglo_core.progress import Listener

_log = logging.getLogger("agglo")


@click.command(cls=OwnCommand, short_help="Agglomerate a mesh: measure, plot, write.")
@click.argument("source", metavar="MESH|SAMPLE", shell_complete=meshes)
@agglomeration_options(bisector="several")
@metrics_option
@click.option("-o", "--output", type=FILE, help="Mesh and levels (.vtu, .npz, …); one file per bisector.")
@click.option("--compress", is_flag=True, help="Compress the arrays of -o: smaller, but slower to write.")
@click.option("--plot", type=FILE, help="Picture of mesh and levels (.png, .pdf, .svg).")
@click.option(
    "--explode",
    type=Number(float, least=0.0, most=10.0),
    help="3-D only: distance by which --plot moves parts apart (default 0.35).",
)
@click.option("--report", type=FILE, help="One web page with all levels and runs (.html).")
@click.option(
    "--independent-of-ranks",
    "independent",
    is_flag=True,
    help="With mpiexec: parts do not depend on the number of ranks.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
@click.option("--quiet", is_flag=True, help="Print nothing but errors (and JSON with --json).")
def run(
    source: str,
    bisectors: Sequence[str],
    agglomeration: Mapping[str, Any],
    metrics: list[Any] | None,
    output: Path | None,
    compress: bool,
    plot: Path | None,
    explode: float | None,
    report: Path | None,
    independent: bool,
    as_json: bool,
    quiet: bool,
) -> int:
    """Agglomerate a mesh file, or a sample: squares:n=64, voronoi:n=5000,seed=3, paper:triangles, …

    Targets are one of --h-star, --h-factor, --parts, --cells-per-part, as comma lists with a value per level.
    With mpiexec -n 4, the mesh is distributed over four processes, and written as .pvtu.
    """
    if quiet:
        quieten()
    if explode is not None and plot is None:
        raise click.UsageError("--explode needs --plot: give --plot or leave --explode out")
    if compress and output is None:
        raise click.UsageError("--compress needs -o: give -o or leave --compress out")
    if is_of_ranks(output, independent):
        refuse_files({"--plot": plot, "--report": report})
        if not quiet:
            explain_compilation()
        options = {"independent": independent, "compress": compress, "as_json": as_json, "quiet": quiet}
        return run_on_ranks(source, bisectors, agglomeration, metrics, output, **options)
    # Check all options before any work.
    files = check_outputs(source, output, plot, report, bisectors, compress)
    plans = {spec: {"bisector": choice("bisector", spec)} for spec in bisectors} or {"": {}}
    outputs = Outputs()
    with show_progress(quiet) as progress:
        with phase(progress, "reading", source):
            mesh = load_mesh(source)
        if explode is not None and mesh.dim == 2:
            raise click.UsageError(f"--explode applies to 3-D meshes; {mesh.name or source} is 2-D")
        refuse_metrics(mesh, metrics)
        if not quiet:
            explain_compilation(ahead=mesh.dim == 2)
        try:
            # Each run is written as soon as it is complete.
            runs = [
                _carry_out(
                    mesh, spec, {**agglomeration, **components}, metrics, outputs, file, compress, progress
                )
                for (spec, components), file in zip_longest(plans.items(), files)
            ]
        except BaseException:
            outputs.finish(listed=False)  # also report files that could not be written
            raise
    if as_json:
        print_json(data(mesh, source, [_plain_data(r) for r in runs]))
    elif not quiet:
        show(f"{mesh.name or source}: {mesh.n_cells:,} cells, h0 = {number(mesh.h)}", runs)
    with show_progress(quiet) as progress:
        draw_runs(outputs, mesh, runs, plot, report, metrics, progress, explode=explode)
    return outputs.finish(listed=not (as_json or quiet))


def _carry_out(
    mesh: Mesh,
    spec: str,
    arguments: Mapping[str, Any],
    metrics: list[Any] | None,
    outputs: Outputs,
    file: Path | None,
    compress: bool,
    progress: Listener | None,
) -> RunResult:
    """Agglomerate with one bisector and write the result at once.

    Without ``spec`` the bisector is that of the configuration file, or the default.
    """

    def save(hierarchy: Hierarchy, levels: Sequence[Level]) -> None:
        from agglo_core.io import write

        if file is None:
            return
        values = [level.values for level in levels] or None
        make = partial(
            write, file, mesh, hierarchy, level_values=values, compress=compress, progress=progress
        )
        if outputs.result(file, make) and not levels:
            _log.warning("%s was written, but could not be measured", file)

    result = execute(mesh, spec, arguments, metrics, progress, save)
    return (
        result
        if spec or not result.hierarchy
        else replace(result, name=result.hierarchy.statistics["bisector"])
    )


def _plain_data(run: RunResult) -> dict[str, Any]:
    levels = [level_data(level) for level in run.levels]
    statistics = run.hierarchy.statistics if run.hierarchy else {}
    return {"bisector": run.name, "levels": levels, "seconds": run.seconds, "statistics": statistics}
