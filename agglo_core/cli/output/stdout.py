"""Standard output reserved for the results of a command. All other output goes to stderr.

Components may print, and so may C code (METIS reports some errors in this way). Tables and JSON must not
contain such lines. Therefore a command keeps the real stdout while running, and redirects the file
descriptor 1 and ``sys.stdout`` to stderr, or to the null device with ``--quiet``.
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
from click.core import augment_usage_errors

from agglo_core.cli.output.option_groups import write_options

_KEY = "agglo.stdout"
_COLUMNS = 80  # terminal width if unknown


class OwnCommand(click.Command):
    """Command whose results alone go to stdout, with its options in groups. Other output goes to stderr."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options for the help text, by :func:`~.option_groups.write_options`."""
        write_options(ctx, formatter)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments, and refuse a second value of an option that keeps only the last one."""
        order = self.make_parser(ctx).parse_args(args=list(args))[2]
        for option in order:
            is_single = isinstance(option, click.Option) and not (
                option.multiple or option.is_flag or option.count
            )
            if is_single and order.count(option) > 1 and not ctx.resilient_parsing:
                raise click.UsageError(f"{option.opts[0]} is given twice, but has one value", ctx)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command, with :func:`stdout` as the stream for its results."""
        with augment_usage_errors(ctx), _reserve_stdout(quiet=bool(ctx.params.get("quiet"))) as stream:
            ctx.meta[_KEY] = stream
            return super().invoke(ctx)


def stdout() -> TextIO:
    """Return the stream for results: the original stdout in an :class:`OwnCommand`, else ``sys.stdout``.

    Outside an own command the result is None if the caller has closed stdout.
    """
    context = click.get_current_context(silent=True)
    output: TextIO | None = context.meta.get(_KEY) if context else None
    return sys.stdout if output is None else output


def terminal_columns(stream: TextIO | None = None) -> int | None:
    """Return the terminal width of a stream (default: :func:`stdout`), or None for a file or pipe."""
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
def _reserve_stdout(*, quiet: bool) -> Iterator[TextIO]:
    with ExitStack() as stack:
        stray = stack.enter_context(open(os.devnull, "w")) if quiet else sys.stderr
        stream = sys.stdout
        if stream is None:  # closed by the caller: command output must not go to stderr instead
            stream = stack.enter_context(open(os.devnull, "w"))
        if _descriptor(stream) == 1 and _descriptor(stray) is not None:
            stream = stack.enter_context(_redirect_descriptor(stream, stray))
        stack.enter_context(redirect_stdout(stray))
        yield stream
        stream.flush()


@contextmanager
def _redirect_descriptor(stream: TextIO, stray: TextIO) -> Iterator[TextIO]:
    """Redirect file descriptor 1 to ``stray`` within the context, and provide its original target."""
    stream.flush()
    buffering = 1 if stream.isatty() else -1
    output = os.fdopen(os.dup(1), "w", buffering, encoding=stream.encoding, errors=stream.errors)
    os.dup2(stray.fileno(), 1)
    try:
        yield output
    finally:
        with suppress(OSError, AttributeError, TypeError):  # flush C buffers into stray
            ctypes.CDLL(None).fflush(None)
        os.dup2(output.fileno(), 1)
        with suppress(OSError):  # already reported by the previous flush
            output.close()


def _descriptor(stream: TextIO) -> int | None:
    try:
        return stream.fileno()
    except (UnsupportedOperation, AttributeError, ValueError):  # streams of tests and IDEs, closed streams
        return None
