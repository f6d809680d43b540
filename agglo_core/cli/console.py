"""What the commands say: notices and progress on stderr, tables and JSON on stdout."""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import click

__all__ = [
    "explain_compilation",
    "notices",
    "number",
    "plain",
    "print_json",
    "print_table",
    "quieten",
]

_log = logging.getLogger("agglo")


class _Notices(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        click.echo(f"note: {self.format(record)}", err=True)


@contextmanager
def notices() -> Iterator[None]:
    """Show the log of agglo (repairs, warnings) on stderr for as long as the context lasts."""
    handler, level = _Notices(), _log.level
    _log.addHandler(handler)
    _log.setLevel(logging.INFO)
    try:
        yield
    finally:
        _log.removeHandler(handler)
        _log.setLevel(level)


def quieten() -> None:
    """Log nothing but errors, for ``--quiet``."""
    _log.setLevel(logging.ERROR)


def explain_compilation() -> None:
    """Say on stderr why the first run on a machine takes longer, if this is the first."""
    from agglo_core.kernels.first_run import first_use

    if first_use():
        click.echo("note: compiling the numerical kernels, once on this machine (about a minute)", err=True)


def plain(value: Any) -> Any:
    """``value`` as JSON knows it: arrays as lists, NaN and infinities as null."""
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if hasattr(value, "tolist"):  # numpy arrays and scalars, without importing numpy
        return plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def print_json(value: Any) -> None:
    """Print a value as JSON on stdout."""
    click.echo(json.dumps(plain(value), indent=2, allow_nan=False))


def number(value: Any) -> str:
    """A number as tables show it: whole numbers in full, others to four digits, a missing one as –."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], fold: str = "") -> None:
    """Print a table on stdout; the column named ``fold`` wraps, all others keep their words whole."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(highlight=False)
    if not console.is_terminal:  # a pipe has no width: leave the wrapping to whoever reads
        console = Console(highlight=False, width=200)
    table = Table(title=Text(title), title_justify="left")
    for column in columns:
        table.add_column(column, no_wrap=column != fold, overflow="fold")
    for row in rows:
        table.add_row(*map(Text, row))
    console.print(table)
