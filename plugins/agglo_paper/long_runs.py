"""Contexts for long computations: one thread, no repeated messages, a progress bar."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

import click

if TYPE_CHECKING:
    from agglo_paper.work.store import Unit

_THREADS: Final = ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS")


@contextmanager
def one_thread() -> Iterator[None]:
    """Context in which newly loaded libraries use one thread, for comparable CPU times."""
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
def without_notices() -> Iterator[None]:
    """Context without messages about single cells larger than h*, which would repeat thousands of times."""
    log = logging.getLogger("agglo")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)


@contextmanager
def progress() -> Iterator[Callable[[Sequence[Unit], str], Callable[[Unit, bool], None]]]:
    """Context with a function that starts a progress bar on stderr for a page's computations.

    The function takes units and page name, and returns a function to call after each unit.
    """
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
