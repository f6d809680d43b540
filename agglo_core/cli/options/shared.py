"""Options that several commands have: bisectors to try, metrics to show, threads at work."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import click

from agglo_core.cli.options.completion import names
from agglo_core.cli.options.numbers import Number
from agglo_core.cli.options.specs import as_typed, bisector_specs, split_specs
from agglo_core.threads import using_threads

COMPONENT = "NAME[:opt=val,…]"
"""Metavar of an option that names a component."""

Command = Callable[..., Any]
Decorator = Callable[[Command], Command]


def read_bisectors(_: click.Context, __: click.Parameter, typed: Sequence[str]) -> list[str]:
    """The bisectors of a repeatable option, whose values may be comma lists; a click callback."""
    return bisector_specs(typed)


def bisectors_option(about: str) -> Decorator:
    """Decorator that adds ``--bisector``, repeatable, for a command that takes ``bisectors``: texts.

    Parameters
    ----------
    about : str
        What the bisectors are for: the beginning of the help text.

    Examples
    --------
    >>> from agglo_core.authoring import bisectors_option
    >>> @click.command()
    ... @bisectors_option("Which to try.")
    ... def mine(bisectors):
    ...     print(bisectors)
    >>> mine(["--bisector", "kmeans,metis:ufactor=30"], standalone_mode=False)
    ['kmeans', 'metis:ufactor=30']
    """
    return click.option(
        "--bisector",
        "bisectors",
        multiple=True,
        metavar=COMPONENT,
        shell_complete=names("bisector", several=True, also=("all",)),
        callback=read_bisectors,
        help=f"{about} Repeatable, or a comma list; 'all' for all that can be used.",
    )


def _read_metrics(_: click.Context, __: click.Parameter, text: str | None) -> list[Any] | None:
    if text is None:
        return None
    from agglo_core.measure.selection import select

    parsed = [as_typed(spec) for spec in split_specs(text)]
    chosen = [(name, options) if options else name for name, options in parsed]
    select(chosen)  # what cannot be measured is refused before a mesh is read
    return chosen


def metrics_option(command: Command) -> Command:
    """Decorator that adds ``--metrics``: what :func:`agglo_core.measure.measure_levels` takes, or None.

    Examples
    --------
    >>> from agglo_core.authoring import metrics_option
    >>> @click.command()
    ... @metrics_option
    ... def mine(metrics):
    ...     print(metrics)
    >>> mine(["--metrics", "UF,cut"], standalone_mode=False)
    ['UF', 'cut']
    """
    decorated: Command = click.option(
        "--metrics",
        metavar="LIST",
        shell_complete=names("metric", several=True),
        callback=_read_metrics,
        help="Metrics (NAME[:opt=val,…]) or objectives to show in place of the default ones.",
    )(command)
    return decorated


def _use_threads(context: click.Context, _: click.Parameter, count: int | None) -> None:
    context.with_resource(using_threads(count))


threads_option = click.option(
    "--threads",
    type=Number(int, least=1),
    expose_value=False,
    callback=_use_threads,
    help="Threads at work (default: AGGLO_THREADS, else 1); results do not depend on it.",
)
"""Decorator that adds ``--threads``: how many threads everything in the command may use."""
