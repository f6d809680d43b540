"""Command ``agglo`` with its subcommands, those of plugins included, and error reports."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import NoReturn

import click
from click.core import augment_usage_errors
from click.exceptions import NoArgsIsHelpError

import agglo_core
from agglo_core.cli.commands.check import check
from agglo_core.cli.commands.compare import compare
from agglo_core.cli.commands.demo import demo
from agglo_core.cli.commands.formats import formats
from agglo_core.cli.commands.mesh import mesh
from agglo_core.cli.commands.plugins import plugins
from agglo_core.cli.commands.quality import quality
from agglo_core.cli.commands.run import run
from agglo_core.cli.commands.solve import solve
from agglo_core.cli.options.completion import completion
from agglo_core.cli.output.console import notices, say
from agglo_core.cli.output.encoding import readable_output
from agglo_core.cli.ranks.launch import find_launch, on_all_ranks, refuse_on_ranks
from agglo_core.cli.stopping import Terminated, find_interrupt, terminations
from agglo_core.errors import AggloError, PluginError
from agglo_core.registry import CORE_COMMANDS, Record, default, describe
from agglo_core.registry.construct import resolve
from agglo_core.registry.containment import printable
from agglo_core.suggestions import did_you_mean

_ON_RANKS = ("run", "solve")  # commands that support several ranks
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)  # possible errors of writing to stdout


class Commands(click.Group):
    """Group of agglo's own commands and those of plugins, which are imported only when they run."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return agglo's own commands, then those of plugins.

        A plugin command with a name that is taken is listed as ``plugin/name``.
        """
        plugin_commands = (
            f"{record.plugin}/{record.name}" if record.state == "conflict" else record.name
            for record in default().commands()
        )
        return [*CORE_COMMANDS, *sorted(set(plugin_commands))]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command:
        """Return the command with this name. For a plugin it is a placeholder until it runs."""
        core_command = super().get_command(ctx, cmd_name)
        if core_command is not None:
            return core_command
        try:
            return _stand_in(cmd_name, default().record("command", cmd_name))
        except PluginError:
            raise click.UsageError(_unknown(cmd_name, self.list_commands(ctx)), ctx) from None


def _stand_in(name: str, record: Record) -> click.Command:
    """Return a placeholder for a plugin command, which imports the real command when it runs."""

    def hand_over(arguments: tuple[str, ...]) -> object:
        real = resolve(record)
        if not isinstance(real, click.Command):
            raise PluginError(f"{describe(record)}: its target is {real!r:.60}, expected a click command")
        context = click.get_current_context()
        with (
            real.make_context(name, list(arguments), parent=context.parent) as inner,
            augment_usage_errors(inner),
        ):
            try:
                return real.invoke(inner)
            except (AggloError, click.ClickException, click.exceptions.Exit, click.Abort):
                raise
            except Exception as error:  # a plugin bug: name the plugin, keep the traceback
                error.add_note(f"raised by {describe(record)}")
                raise

    summary = record.command.summary if record.command else ""
    return click.Command(
        name,
        callback=hand_over,
        params=[click.Argument(["arguments"], nargs=-1, type=click.UNPROCESSED)],
        help=summary if record.state == "ok" else f"({record.state}) {summary}",
        context_settings={"ignore_unknown_options": True},
        add_help_option=False,
    )


def _unknown(name: str, names: list[str]) -> str:
    failures = [record for record in default().list() if record.kind == "plugin"]
    reasons = "".join(f"; {describe(record)} is {record.state}: {record.reason}" for record in failures)
    return f"no command {name!r}{did_you_mean(name, names)}; accepted: {', '.join(names)}{reasons}"


@click.group(
    cls=Commands,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},  # inherited by all commands
)
@click.version_option(agglo_core.__version__, prog_name="agglo")
@click.pass_context
def app(context: click.Context) -> None:
    """Agglomerate polygonal and polyhedral meshes into nested hierarchies.

    Exit codes: 0 done, 2 bad input, 3 not converged, a law failed or no picture, 130 Ctrl-C, 143 SIGTERM.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())
    elif context.invoked_subcommand not in _ON_RANKS:
        refuse_on_ranks(f"agglo {context.invoked_subcommand}", f"agglo {_ON_RANKS[0]} works on several")


for _command in (demo, run, compare, quality, mesh, solve, formats, plugins, check, completion):
    app.add_command(_command)


def main(args: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit.

    Errors raised on purpose are printed as one line, bugs with a traceback.
    """
    launch = find_launch()
    sys.exit(_main(args) if launch is None else on_all_ranks(lambda: _main(args), launch))


def _main(args: Sequence[str] | None) -> int:
    with readable_output(), notices(), terminations():
        return _run(args)


def _run(args: Sequence[str] | None) -> int:
    try:
        result = app.main(args=args, prog_name="agglo", standalone_mode=False)
        if sys.stdout is not None:  # None if the caller has closed stdout
            sys.stdout.flush()
    except (AggloError, click.Abort, SystemError) as error:
        # Interrupts may be wrapped in other errors.
        stop = find_interrupt(error)
        if stop is not None or isinstance(error, click.Abort):
            return _report_stop(143 if isinstance(stop, Terminated) else 130, stop)
        if isinstance(error, SystemError):
            raise
        return _fail(str(error))
    except NoArgsIsHelpError as error:  # a group of a plugin, without subcommand
        error.show()
        return error.exit_code
    except click.UsageError as error:
        return _fail(error.format_message(), error.ctx)
    except click.ClickException as error:
        return _fail(error.format_message())
    except MemoryError as error:
        return _fail(f"out of memory: {error}" if str(error) else "out of memory")
    except BrokenPipeError:  # the reader has closed the pipe: end silently
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        # Files are reported by name, a full stdout in general.
        if error.filename is not None:
            return _fail(f"{error.filename}: {error.strerror}")
        if error.errno not in _FULL:
            raise
        _give_up_output()
        return _fail(f"the output cannot be written: {error.strerror}")
    return result if isinstance(result, int) else 0


def _give_up_output() -> None:
    """Discard the rest of stdout that cannot be written, since it would fail again at exit."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(message: str, context: click.Context | None = None) -> int:
    """Print an error, with the usage of the command that was called wrongly. Returns the exit code."""
    lines = [f"error: {printable(' '.join(message.split()))}"]
    if context is not None:
        pieces = " ".join(context.command.collect_usage_pieces(context))
        lines.append(f"usage: {context.command_path} {pieces} (help: {context.command_path} -h)")
    with suppress(OSError):  # stderr may be full, too: then only the exit code reports
        for line in lines:
            say(line)
    return 2


def _report_stop(code: int, stop: BaseException | None) -> int:
    location = ", ".join(getattr(stop, "__notes__", ()))
    with suppress(OSError):
        click.echo(f"{'interrupted' if code == 130 else 'terminated'} {location}".rstrip(), err=True)
    return code
