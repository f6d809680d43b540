"""Standard output belongs to what the commands print: whatever else writes there goes to stderr.

Components print, and so does the C code below them (METIS reports some errors that way). Tables and JSON
must not have such lines in them. So a command of ours keeps the real stdout for itself while it runs: the
file descriptor 1 and ``sys.stdout`` lead to stderr, or nowhere with ``--quiet``.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from io import UnsupportedOperation
from typing import Any, TextIO

import click

_KEY = "agglo.stdout"
_COLUMNS = 80  # of a terminal that does not say


class OwnCommand(click.Command):
    """A command of ours, which has stdout for itself."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; :func:`stdout` is the stream it prints to."""
        with _kept(quiet=bool(ctx.params.get("quiet"))) as stream:
            ctx.meta[_KEY] = stream
            return super().invoke(ctx)


def stdout() -> TextIO:
    """The stream for what a command prints: the one :class:`OwnCommand` keeps, or else ``sys.stdout``.

    Outside such a command None, as ``sys.stdout`` is, where the caller has closed it.
    """
    context = click.get_current_context(silent=True)
    kept: TextIO | None = context.meta.get(_KEY) if context else None
    return sys.stdout if kept is None else kept


def terminal_columns(stream: TextIO | None = None) -> int | None:
    """Columns of the terminal that a stream (by default :func:`stdout`) is; None if it is none."""
    stream = stdout() if stream is None else stream
    if stream is None or not stream.isatty():
        return None
    with suppress(KeyError, ValueError):
        return int(os.environ["COLUMNS"])
    try:
        return os.get_terminal_size(stream.fileno()).columns or _COLUMNS
    except OSError:
        return _COLUMNS


@contextmanager
def _kept(*, quiet: bool) -> Iterator[TextIO]:
    with ExitStack() as stack:
        stray = stack.enter_context(open(os.devnull, "w")) if quiet else sys.stderr
        stream = sys.stdout
        if stream is None:  # the caller has closed it: nothing of ours may go to stderr instead
            stream = stack.enter_context(open(os.devnull, "w"))
        if _descriptor(stream) == 1 and _descriptor(stray) is not None:
            stream = stack.enter_context(_moved(stream, stray))
        stack.enter_context(redirect_stdout(stray))
        yield stream
        stream.flush()


@contextmanager
def _moved(stream: TextIO, stray: TextIO) -> Iterator[TextIO]:
    """A stream to where descriptor 1 leads, which leads to ``stray`` meanwhile."""
    stream.flush()
    buffering = 1 if stream.isatty() else -1
    kept = os.fdopen(os.dup(1), "w", buffering, encoding=stream.encoding, errors=stream.errors)
    os.dup2(stray.fileno(), 1)
    try:
        yield kept
    finally:
        with suppress(OSError, AttributeError, TypeError):  # what C holds back belongs to stray too
            ctypes.CDLL(None).fflush(None)
        os.dup2(kept.fileno(), 1)
        with suppress(OSError):  # what cannot be written has been reported by the flush before
            kept.close()


def _descriptor(stream: TextIO) -> int | None:
    try:
        return stream.fileno()
    except (UnsupportedOperation, AttributeError, ValueError):  # a test's, an IDE's, a closed one
        return None
