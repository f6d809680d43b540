"""The command of the study: ``python -m shape_study``."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from agglo_core.authoring import Number, print_lines
from agglo_paper.long_runs import one_thread, progress, without_notices


def _degrees(context: click.Context, parameter: click.Parameter, text: str | None) -> tuple[int, ...] | None:
    if text is None:
        return None
    try:
        found = tuple(dict.fromkeys(int(each) for each in text.split(",")))
    except ValueError:
        found = ()
    if not found or not all(1 <= each <= 6 for each in found):
        raise click.BadParameter(f"expected degrees from 1 to 6 such as 1,2,3, given {text!r}")
    return found


@click.command()
@click.argument("what", type=click.Choice(["shapes", "levels", "solids"]))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, file_okay=False), default=Path("agglo-study"),
    show_default=True, help="Folder of the page, and of results to go on from.",
)  # fmt: skip
@click.option(
    "--meshes", type=Number(int, least=1, most=100),
    help="How many: Voronoi, random triangles, squares (or solids) by turns  [default: 3; solids 4]",
)  # fmt: skip
@click.option("--cells", type=Number(int, least=32), help="Of each mesh, about  [default: 500; solids 2000]")
@click.option(
    "--partitions", type=Number(int, least=4),
    help="Of each mesh, from excellent to bad  [default: 40; levels and solids 20]",
)  # fmt: skip
@click.option(
    "--cells-per-part", type=Number(int, least=2),
    help="Of the finest level  [default: 16; levels 4; solids 32, with four levels a quarter]",
)  # fmt: skip
@click.option(
    "--degrees", callback=_degrees, metavar="LIST",
    help="Of the polynomials, in the plane  [default: 1,2,3; levels 1,2]",
)  # fmt: skip
@click.option("--seed", type=Number(int, least=0), default=0, show_default=True, help="Of the first mesh.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of the page.")
def study(
    what: str,
    output: Path,
    meshes: int | None,
    cells: int | None,
    partitions: int | None,
    cells_per_part: int | None,
    degrees: tuple[int, ...] | None,
    seed: int,
    as_json: bool,
) -> None:
    """Correlate metrics of partitions with iterations and errors of solvers.

    WHAT is shapes (in the plane, two levels), levels (four levels) or solids (in space, by finite volumes).
    Writes WHAT.md, WHAT.json and, with matplotlib, figures. An interrupted run goes on where it was.
    """
    if what == "solids" and degrees is not None:
        raise click.UsageError("--degrees is for the plane: solids are studied by finite volumes")
    with one_thread(), without_notices():
        from shape_study.build import build
        from shape_study.plan import DEFAULTS

        given: dict[str, Any] = {"meshes": meshes, "cells": cells, "partitions": partitions}
        given |= {"per_part": cells_per_part, "degrees": degrees}
        size = replace(DEFAULTS[what], seed=seed, **{k: v for k, v in given.items() if v is not None})
        with progress() as begin:
            page = build(output, size, begin)
    if as_json:
        click.echo(json.dumps(page.data(), indent=2, allow_nan=False))
        return
    print_lines(page.markdown())
    print_lines(f"wrote {what} to {output}")


if __name__ == "__main__":
    study(prog_name="python -m shape_study")
