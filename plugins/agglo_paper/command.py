"""The command ``agglo paper``, which writes the paper's tables and figures beside agglo's."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import click

from agglo_core.authoring import choice, print_lines
from agglo_core.cli.options.agglomeration import FILE
from agglo_core.cli.options.shared import bisectors_option
from agglo_paper.long_runs import one_thread, progress, without_notices

WORDS: Final = (
    *("uf", "cr", "brain", "runtime"),
    *("mg-levels", "mg-m1", "mg-smoothing", "mg-degree"),
    *("statistics", "figures", "all"),
)


@click.command(short_help="The paper's tables and figures next to ours.")
@click.argument("what", nargs=-1, type=click.Choice(WORDS))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, file_okay=False), default=Path("agglo-paper"),
    show_default=True, help="Folder for pages, figures and results to resume from.",
)  # fmt: skip
@bisectors_option("Columns in addition to the paper's own (default: all).")
@click.option("--quick", is_flag=True, help="Fewer grids, repetitions and meshes: a minute at most.")
@click.option("--mesh", type=FILE, help="Make the brain tables for this mesh, too.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of the tables.")
def paper(
    what: tuple[str, ...],
    output: Path,
    bisectors: Sequence[str],
    quick: bool,
    mesh: Path | None,
    as_json: bool,
) -> None:
    """Reproduce tables and figures of the paper: WHAT selects them (default all).

    Each cell is paper / ours; each row has a verdict and, for differences, the reason. Every installed or
    selected bisector has a column. An interrupted run resumes.
    """
    selection = {spec: choice("bisector", spec) for spec in bisectors} or None
    with one_thread(), without_notices():
        from agglo_paper.pages import build

        with progress() as done:
            pages, front = build(what or ("all",), output, quick, mesh, done, selection)
    if as_json:
        click.echo(json.dumps([page.data() for page in pages], indent=2, allow_nan=False))
        return
    for text in [front] if front else [page.markdown() for page in pages]:
        print_lines(text)
    print_lines(f"wrote {len(pages)} pages to {output}")
