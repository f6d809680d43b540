"""Options shared by several commands: bisectors, metrics, threads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import click

from agglo_core.cli.options.completion import names
from agglo_core.cli.options.numbers import Number
from agglo_core.cli.options.specs import as_typed, bisector_specs, split_specs
from agglo_core.threads import using_threads

COMPONENT = "NAME[:opt=val,…]"
"""Metavar of options that name a component."""

Command = Callable[..., Any]
Decorator = Callable[[Command], Command]


def read_bisectors(_: click.Context, __: click.Parameter, typed: Sequence[str]) -> list[str]:
    """Parse a repeatable option that lists bisectors, separated by commas (click callback)."""
    return bisector_specs(typed)


def bisectors_option(about: str) -> Decorator:
    """Add the repeatable option ``--bisector``, whose values become the argument ``bisectors`` (decorator).

    Parameters
    ----------
    about : str
        Beginning of the help text: the bisectors' purpose.

    Examples
    --------
    >>> from agglo_core.cli.options.shared import bisectors_option
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
        help=f"{about} Repeatable, or a comma list; 'all' for all usable ones.",
    )


def _read_metrics(_: click.Context, __: click.Parameter, text: str | None) -> list[Any] | None:
    if text is None:
        return None
    from agglo_core.measure.selection import select

    parsed = [as_typed(spec) for spec in split_specs(text)]
    metrics = [(name, options) if options else name for name, options in parsed]
    select(metrics)  # refuse invalid metrics before a mesh is read
    return metrics


def metrics_option(command: Command) -> Command:
    """Add the option ``--metrics``, a list for :func:`~agglo_core.measure.measure_levels` (decorator).

    Examples
    --------
    >>> from agglo_core.cli.options.shared import metrics_option
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
        help="Metrics (NAME[:opt=val,…]) or objectives to show instead of the default ones.",
    )(command)
    return decorated


def _use_threads(context: click.Context, _: click.Parameter, count: int | None) -> None:
    context.with_resource(using_threads(count))


threads_option = click.option(
    "--threads",
    type=Number(int, least=1),
    expose_value=False,
    callback=_use_threads,
    help="Number of threads (default: AGGLO_THREADS, else 1); results do not depend on it.",
)
"""Add the option ``--threads``, the number of threads for the whole command (decorator)."""
