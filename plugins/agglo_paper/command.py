"""``agglo paper``: the paper's tables and figures, ours beside the printed numbers."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from agglo_core.authoring import FILE, bisectors_option, choice, print_lines

if TYPE_CHECKING:
    from agglo_paper.store import Unit

__all__ = ["WORDS", "paper"]

WORDS: Final = (
    *("uf", "cr", "brain", "runtime"),
    *("mg-levels", "mg-m1", "mg-smoothing", "mg-degree"),
    *("statistics", "figures", "all"),
)
_THREADS: Final = ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS")


@click.command(short_help="The paper's tables and figures beside ours.")
@click.argument("what", nargs=-1, type=click.Choice(WORDS))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, file_okay=False), default=Path("agglo-paper"),
    show_default=True, help="Folder of the pages and figures, and of results to go on from.",
)  # fmt: skip
@bisectors_option("Columns beside the paper's own (default: all).")
@click.option("--quick", is_flag=True, help="Fewer grids, repetitions and meshes: a minute at most.")
@click.option("--mesh", type=FILE, help="Treat this mesh as a brain too.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of the tables.")
def paper(
    what: tuple[str, ...],
    output: Path,
    bisectors: Sequence[str],
    quick: bool,
    mesh: Path | None,
    as_json: bool,
) -> None:
    """Reproduce the paper: WHAT is one or more of its tables and figures (default all).

    Each cell is paper / ours, each row has a verdict and, where it differs, the reason. Every installed
    bisector, or each that is chosen, has a column. An interrupted run goes on where it was.
    """
    chosen = {spec: choice("bisector", spec) for spec in bisectors} or None
    with _one_thread(), _without_notices():
        from agglo_paper.pages import build

        with _progress() as done:
            pages, front = build(what or ("all",), output, quick, mesh, done, chosen)
    if as_json:
        click.echo(json.dumps([page.data() for page in pages], indent=2, allow_nan=False))
        return
    for text in [front] if front else [page.markdown() for page in pages]:
        print_lines(text)
    print_lines(f"wrote {len(pages)} pages to {output}")


@contextmanager
def _one_thread() -> Iterator[None]:
    """Libraries loaded from here on use one thread: CPU times are compared."""
    names = [f"{library}_NUM_THREADS" for library in _THREADS]
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _without_notices() -> Iterator[None]:
    """Hides notices about single cells larger than h*, which would be repeated thousands of times."""
    log = logging.getLogger("agglo")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)


@contextmanager
def _progress() -> Iterator[Callable[[Sequence[Unit], str], Callable[[Unit, bool], None]]]:
    """A bar on stderr: given the units of a page and its name, what to call after each."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:

        def begin(units: Sequence[Unit], name: str) -> Callable[[Unit, bool], None]:
            task = bar.add_task(name, total=len(units))
            if not console.is_terminal:
                click.echo(f"{name}: {len(units)} units of work", err=True)
            return lambda unit, known: bar.advance(task)

        yield begin
