"""``agglo study``: what the shapes of agglomerates do to iterations and errors."""

from __future__ import annotations

import json
from pathlib import Path

import click

from agglo_core.authoring import Number, print_lines
from agglo_paper.long_runs import one_thread, progress, without_notices

__all__ = ["study"]


def _degrees(context: click.Context, parameter: click.Parameter, text: str) -> tuple[int, ...]:
    try:
        found = tuple(dict.fromkeys(int(each) for each in text.split(",")))
    except ValueError:
        found = ()
    if not found or not all(1 <= each <= 6 for each in found):
        raise click.BadParameter(f"expected degrees from 1 to 6 such as 1,2,3, given {text!r}")
    return found


@click.command(short_help="What shapes do to iterations and errors.")
@click.argument("what", type=click.Choice(["shapes"]))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, file_okay=False), default=Path("agglo-study"),
    show_default=True, help="Folder of the page, and of results to go on from.",
)  # fmt: skip
@click.option(
    "--meshes", type=Number(int, least=1, most=100), default=3, show_default=True,
    help="How many: Voronoi, random triangles, squares by turns.",
)  # fmt: skip
@click.option(
    "--cells", type=Number(int, least=32), default=500, show_default=True, help="Of each mesh, about."
)
@click.option(
    "--partitions", type=Number(int, least=4), default=40, show_default=True,
    help="Of each mesh, from excellent to bad.",
)  # fmt: skip
@click.option("--cells-per-part", type=Number(int, least=2), default=16, show_default=True)
@click.option("--degrees", callback=_degrees, default="1,2,3", show_default=True, metavar="LIST")
@click.option("--seed", type=Number(int, least=0), default=0, show_default=True, help="Of the first mesh.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of the page.")
def study(
    what: str,
    output: Path,
    meshes: int,
    cells: int,
    partitions: int,
    cells_per_part: int,
    degrees: tuple[int, ...],
    seed: int,
    as_json: bool,
) -> None:
    """Find out which metric tells how a partition does: WHAT is shapes.

    Writes shapes.md, shapes.json and, with matplotlib, shapes.svg. An interrupted run goes on where it was.
    """
    with one_thread(), without_notices():
        from agglo_paper.study.study_build import Size, build

        with progress() as begin:
            page = build(output, Size(meshes, cells, partitions, cells_per_part, degrees, seed), begin)
    if as_json:
        click.echo(json.dumps(page.data(), indent=2, allow_nan=False))
        return
    print_lines(page.markdown())
    print_lines(f"wrote {what} to {output}")
