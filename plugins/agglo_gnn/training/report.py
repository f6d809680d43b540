"""Training progress as a bar or lines on stderr, and in a log file."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import click

from agglo_core.authoring import FileError

Report = Callable[[str, float], None]
"""Function that receives a status line, and the completed fraction of the training."""


@contextmanager
def reporter(title: Sequence[str], log: Path | None, quiet: bool, append: bool = False) -> Iterator[Report]:
    """Context with a function that reports a status line of the training and writes it to the log.

    Parameters
    ----------
    title : sequence of str
        First log lines, the last with the column headings.
    log : Path, optional
    quiet : bool
        Show nothing.
    append : bool
        Append to an existing log.

    Raises
    ------
    FileError
        If the log cannot be written.
    """
    with ExitStack() as stack:
        outputs: list[Report] = []
        if log is not None:
            fresh = not (append and log.exists())
            _write(log, "w" if fresh else "a", title if fresh else ())
            outputs.append(lambda line, _: _write(log, "a", [line]))
        if not quiet:
            outputs.append(stack.enter_context(_bar(title[-1])) if sys.stderr.isatty() else _lines(title[-1]))

        def report(line: str, share: float) -> None:
            for output in outputs:
                output(line, share)

        yield report


def _write(log: Path, mode: str, lines: Iterable[str]) -> None:
    """Append lines to the log file, which is closed after each call."""
    try:
        with log.open(mode, encoding="utf-8") as file:
            file.writelines(f"{line}\n" for line in lines)
    except OSError as error:
        raise FileError(f"{log}: {error.strerror}") from error


def _lines(heads: str) -> Report:
    click.echo(heads, err=True)
    return lambda line, _: click.echo(line, err=True)


@contextmanager
def _bar(heads: str) -> Iterator[Report]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    console.print(heads, highlight=False)
    columns = TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("starting", total=1.0)
        yield lambda line, share: progress.update(task, description=line, completed=share)
