"""Printing of notes and warnings on stderr, and of JSON on stdout."""

from __future__ import annotations

import json
import logging
import math
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import click

from agglo_core.cli.output.stdout import stdout, terminal_columns
from agglo_core.cli.output.tables import line_for
from agglo_core.registry.containment import printable

_log = logging.getLogger("agglo")


class _Notices(logging.Handler):
    """Log handler that prints equal messages only once, because runs on the same mesh repeat them."""

    def __init__(self) -> None:
        super().__init__()
        self._shown: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        text = printable(self.format(record))
        if text not in self._shown:
            self._shown.add(text)
            say(f"{'warning' if record.levelno >= logging.WARNING else 'note'}: {text}")


@contextmanager
def notices() -> Iterator[None]:
    """Print agglo's log messages (repairs, warnings) on stderr within the context."""
    handler, level = _Notices(), _log.level
    _log.addHandler(handler)
    _log.setLevel(logging.INFO)
    try:
        yield
    finally:
        _log.removeHandler(handler)
        _log.setLevel(level)


def quieten() -> None:
    """Suppress all log messages but errors, for ``--quiet``."""
    _log.setLevel(logging.ERROR)


def explain_compilation(*, ahead: bool = False) -> None:
    """Print a note on stderr if kernels are compiled during this command.

    With ``ahead``, other processes then compile kernels that a run in 2-D needs later.
    """
    from agglo_core.compiled.first_run import watch_compilation

    note = "note: compiling numerical kernels for their first use (up to a minute)"
    click.get_current_context().with_resource(watch_compilation(lambda: say(note), ahead=ahead))


def say(line: str) -> None:
    """Print a line on stderr, wrapped to the terminal width.

    The line appears above a progress bar, unlike click's ``err=True``, which writes into the bar.
    """
    if sys.stderr is not None:  # None if the caller has closed stderr
        click.echo(line_for(terminal_columns(sys.stderr), line), file=sys.stderr)


def plain(value: Any) -> Any:
    """Convert a value to JSON types: arrays to lists, NaN and infinities to null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # numpy arrays and scalars, without importing numpy
        return plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def print_json(value: Any) -> None:
    """Print a value as JSON on stdout."""
    click.echo(json.dumps(plain(value), indent=2, allow_nan=False), file=stdout())


def number(value: Any) -> str:
    """Format a number for tables: integers in full, floats with four digits, missing values as –."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
