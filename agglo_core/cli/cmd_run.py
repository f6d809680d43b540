"""``agglo run``: agglomerate a mesh with one bisector or several, measure, draw, write."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from agglo_core.cli.arguments import FILE, agglomeration_options, choice, load_mesh, metrics_option
from agglo_core.cli.console import explain_compilation, number, print_json, quieten
from agglo_core.cli.outputs import check_outputs, refuse_3d_meshes, write_outputs
from agglo_core.cli.runs import data, execute, level_data, refuse_metrics, show
from agglo_core.cli.stdout import OwnCommand

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from agglo_core.measure.comparison import RunResult
    from agglo_core.mesh import Mesh

__all__ = ["run"]


@click.command(cls=OwnCommand, short_help="Agglomerate a mesh: measure, draw, write.")
@click.argument("source", metavar="MESH|SAMPLE")
@agglomeration_options(bisector="several")
@metrics_option
@click.option("-o", "--output", type=FILE, help="Mesh and levels (.vtu, .npz, …); one file per bisector.")
@click.option("--plot", type=FILE, help="Picture of mesh and levels (.png, .pdf, .svg).")
@click.option("--report", type=FILE, help="One web page with all levels and runs (.html).")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
@click.option("--quiet", is_flag=True, help="Print nothing but errors (and JSON, if asked for).")
def run(
    source: str,
    bisectors: Sequence[str],
    agglomeration: Mapping[str, Any],
    metrics: list[Any] | None,
    output: Path | None,
    plot: Path | None,
    report: Path | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Agglomerate a mesh file, or a sample: squares:n=64, voronoi:n=5000,seed=3, paper:triangles, …

    Targets are one of --h-star, --h-factor, --parts, --cells-per-part: a comma list, a level for each.
    """
    if quiet:
        quieten()
    files = check_outputs(output, plot, report, bisectors)
    chosen = {spec: choice("bisector", spec) for spec in bisectors}
    mesh = load_mesh(source)
    refuse_3d_meshes(mesh, source, {"--plot": plot, "--report": report})
    refuse_metrics(mesh, metrics)
    if not quiet:
        explain_compilation()
    runs = [
        execute(mesh, spec, {**agglomeration, "bisector": chosen[spec]}, quiet, metrics) for spec in bisectors
    ]
    runs = runs or [_configured(mesh, agglomeration, quiet, metrics)]
    written = write_outputs(mesh, runs, files, plot, report, metrics)
    if as_json:
        print_json(data(mesh, source, [_plain(each) for each in runs]))
    elif not quiet:
        show(f"{mesh.name or source}: {mesh.n_cells:,} cells, h0 = {number(mesh.h)}", runs, written)


def _configured(mesh: Mesh, given: Mapping[str, Any], quiet: bool, metrics: list[Any] | None) -> RunResult:
    """The run with the bisector of the configuration, or the default one, under its name."""
    made = execute(mesh, "agglomerating", given, quiet, metrics)
    return replace(made, name=str(made.hierarchy.statistics["bisector"])) if made.hierarchy else made


def _plain(run: RunResult) -> dict[str, Any]:
    levels = [level_data(level) for level in run.levels]
    statistics = run.hierarchy.statistics if run.hierarchy else {}
    return {"bisector": run.name, "levels": levels, "seconds": run.seconds, "statistics": statistics}
