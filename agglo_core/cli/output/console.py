"""Print notices on stderr and JSON on stdout."""

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
    """Prints each notice once: several runs on one mesh have the same to say of it."""

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
    """Say on stderr why this run takes longer, once it compiles kernels."""
    from agglo_core.compiled.first_run import watch_compilation

    note = "note: compiling numerical kernels, once on this machine (up to a minute)"
    click.get_current_context().with_resource(watch_compilation(lambda: say(note)))


def say(line: str) -> None:
    """Print a line on stderr, folded to the terminal that it may be.

    It stands above a bar that is shown there, into which click's own ``err=True`` writes.
    """
    if sys.stderr is not None:  # as it is where the caller has closed it
        click.echo(line_for(terminal_columns(sys.stderr), line), file=sys.stderr)


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
    click.echo(json.dumps(plain(value), indent=2, allow_nan=False), file=stdout())


def number(value: Any) -> str:
    """A number as tables show it: whole numbers in full, others to four digits, a missing one as –."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
