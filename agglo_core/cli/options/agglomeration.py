"""Command line options for all keywords of :func:`~agglo_core.agglomerate`, with their help texts.

.. code-block:: python

    @click.command()
    @click.argument("source", metavar="MESH|SAMPLE")
    @agglomeration_options
    def mine(source: str, agglomeration: dict[str, Any]) -> None:
        hierarchy = agglomerate(load_mesh(source), **agglomeration)

Decorated like this, a command has its own means to choose bisector and method, if any. With
``@agglomeration_options(bisector="one")``, the command has all options of ``agglo run``, with equal names.

No heavy package is imported before a mesh is loaded.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import wraps
from pathlib import Path
from typing import Any, Literal, overload

import click

from agglo_core.agglomeration.keywords import (
    BALANCES,
    BOUNDS,
    COMPONENT_LISTS,
    COMPONENTS,
    GROUPS,
    HELP,
    METHODS,
    TARGETS,
)
from agglo_core.cli.options.completion import names
from agglo_core.cli.options.numbers import Number, numbers
from agglo_core.cli.options.shared import (
    COMPONENT,
    Command,
    Decorator,
    bisectors_option,
    threads_option,
)
from agglo_core.cli.options.specs import (
    choice,
    refuse_duplicates,
)


class _File(click.Path):
    """Type of path options: a path that is not empty."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "":
            self.fail("the file name is empty", param, ctx)
        return super().convert(value, param, ctx)


FILE = _File(path_type=Path)
Amount = Literal["one", "several"]


def read_methods(_: click.Context, parameter: click.Parameter, text: str | None) -> list[str]:
    """Parse a comma-separated list of methods without duplicates (click callback)."""
    methods = [method.strip() for method in text.split(",")] if text is not None else []
    flag = parameter.opts[0]
    unknown = [method for method in methods if method not in METHODS]
    if unknown:
        raise click.UsageError(f"{flag}: unknown method {unknown[0]!r}; expected one of {', '.join(METHODS)}")
    refuse_duplicates(flag, methods)
    return methods


def _names(_: click.Context, parameter: click.Parameter, text: str | None) -> tuple[str, ...] | None:
    """Parse a comma-separated list of tags (click callback)."""
    if text is None:
        return None
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise click.BadParameter(f"{text!r} is not a comma-separated list of tags", param=parameter)
    return names


def _tensor(_: click.Context, parameter: click.Parameter, text: str | None) -> list[list[float]] | None:
    """Parse a 2×2 or 3×3 matrix from 4 or 9 comma-separated numbers (click callback)."""
    if text is None:
        return None
    try:
        values = [float(item) for item in text.split(",")]
    except ValueError:
        values = []
    d = {4: 2, 9: 3}.get(len(values))
    if d is None:
        raise click.BadParameter(f"{text!r} is not a comma-separated list of 4 or 9 numbers", param=parameter)
    return [values[d * i : d * (i + 1)] for i in range(d)]


_TAGS = "TAG[=VALUE],…"
_FLAGS = {
    "n_parts": "--parts",
    "refiners": "--refiner",
    "post_refiners": "--post-refiner",
    "metric": "--metric-tensor",
}
_FLAGS |= {"constraints": "--constraint"}
_SWITCHES = {
    "nested": "--nested/--not-nested",
    "merge": "--merge/--no-merge",
    "polish": "--polish/--no-polish",
    "lines": "--lines/--no-lines",
}


def _flag(name: str) -> str:
    """Return the command line flag for a keyword, such as ``--parts``."""
    return _FLAGS.get(name) or f"--{name.replace('_', '-')}"


def _option(name: str, **settings: Any) -> Decorator:
    """Build the command line option for a keyword that takes a value."""
    return click.option(_flag(name), name, help=HELP[name], **settings)


def _component(name: str) -> Decorator:
    """Build the command line option for a keyword whose value names components."""
    several = name in COMPONENT_LISTS
    also = ("none",) if COMPONENTS[name] == "refiner" else ()
    offer = names(COMPONENTS[name], also=also)
    return _option(name, multiple=several, metavar=COMPONENT, shell_complete=offer)


def _numbers(name: str, kind: type[int] | type[float], least: float | None = None) -> Decorator:
    """Build the command line option for a target: comma-separated numbers, one per level."""
    return _option(name, callback=numbers(kind, least=least), metavar="LIST")


def _bound(name: str) -> Decorator:
    """Build the command line option for a bound on part sizes."""
    return _option(name, type=Number(int, least=1) if name.endswith("cells") else Number(float, above=0))


def _switch(name: str) -> Decorator:
    """Build the on/off option for a boolean keyword, by default as in :func:`~agglo_core.agglomerate`."""
    return click.option(_SWITCHES[name], name, default=None, help=HELP[name])


_METHOD_LIST = click.option(
    "--method", "methods", callback=read_methods, metavar="LIST", help="recursive (default), kway, or both."
)
_OPTIONS = {
    "h_star": _numbers("h_star", float),
    "h_factor": _numbers("h_factor", float),
    "n_parts": _numbers("n_parts", int),
    "cells_per_part": _numbers("cells_per_part", float, least=1),
    **{name: _component(name) for name in COMPONENTS},
    "method": _option("method", type=click.Choice(METHODS)),
    **{name: _switch(name) for name in _SWITCHES},
    "seed": _option("seed", type=Number(int, least=0)),
    "regions": _option("regions", metavar="TAG,…", callback=_names),
    "barriers": _option("barriers", metavar=_TAGS, callback=_names),
    "where": _option("where", metavar=_TAGS, callback=_names),
    "boundary_rules": _option("boundary_rules", type=click.Choice(("ridges",))),
    "weights": _option("weights", metavar="NAME"),
    "balance": _option("balance", type=click.Choice(BALANCES)),
    **{name: _bound(name) for name in BOUNDS},
    "metric": _option("metric", metavar="LIST", callback=_tensor),
    "config": click.option("--config", type=FILE, help="TOML file; options given here take precedence."),
    "allow_code": click.option(
        "--allow-code",
        is_flag=True,
        default=None,
        help="Allow options in TOML files to name code to import and run.",
    ),
}
_ALL = tuple(name for names in GROUPS.values() for name in names if name in _OPTIONS)
_BARE = (*TARGETS, "refiners", "fixer", "seed")


@overload
def agglomeration_options(command: Command) -> Command: ...
@overload
def agglomeration_options(*, bisector: Amount = "one", method: Amount = "one") -> Decorator: ...
def agglomeration_options(
    command: Command | None = None, *, bisector: Amount = "one", method: Amount = "one"
) -> Command | Decorator:
    """Add the options for all keywords of :func:`~agglo_core.agglomerate` to a command (decorator).

    The command receives a mapping ``agglomeration`` with arguments of :func:`agglo_core.agglomerate`. Absent
    options keep the defaults. Several target kinds, or a refiner beside ``none``, are a UsageError. An
    unusable component is a PluginError before a mesh is read.

    Parameters
    ----------
    command : callable, optional
        Without decorator arguments, the command has refiners, fixer, the four target kinds, and the seed.
    bisector : "one" or "several"
        Add all options of ``agglo run``: also bisector, method, nested, merge, polish, post-refiners,
        constraints, rules for the parts, config. With "several", the command also receives ``bisectors``,
        a list of texts for :func:`choice`, empty by default.
    method : "one" or "several"
        With "several", the command also receives ``methods``, a list of words, empty by default.

    Examples
    --------
    >>> from agglo_core.authoring import agglomeration_options
    >>> @click.command()
    ... @agglomeration_options
    ... def mine(agglomeration):
    ...     print(agglomeration)
    >>> mine(["--parts", "8,2", "--refiner", "none"], standalone_mode=False)
    {'n_parts': (8, 2), 'refiners': ()}
    """
    if command is not None:
        return _gather_options(command, [_OPTIONS[name] for name in _BARE], _BARE)
    options = dict(_OPTIONS)
    if bisector == "several":
        usual = "all" if method == "several" else "kmeans"
        options["bisector"] = bisectors_option(
            f"How a piece is split (default {usual}); several are compared."
        )
    if method == "several":
        options["method"] = _METHOD_LIST
    ordered = [*(options[name] for name in _ALL), threads_option]
    return lambda inner: _gather_options(inner, ordered, _ALL)


def _gather_options(command: Command, options: Sequence[Decorator], names: Sequence[str]) -> Command:
    """Add options to a command, which receives the named ones as a dict ``agglomeration``."""

    @wraps(command)
    def gathered(**arguments: Any) -> Any:
        agglomeration = {name: arguments.pop(name) for name in names if name in arguments}
        return command(agglomeration=_arguments(agglomeration), **arguments)

    decorated: Command = gathered
    for option in reversed(options):
        decorated = option(decorated)
    return decorated


def _arguments(options: dict[str, Any]) -> dict[str, Any]:
    arguments = {name: value for name, value in options.items() if value is not None and value != ()}
    targets = [_flag(name) for name in TARGETS if name in arguments]
    if len(targets) > 1:
        raise click.UsageError(f"{' and '.join(targets)} cannot be combined: choose one")
    for name, kind in COMPONENTS.items():
        if name not in arguments:
            continue
        if name not in COMPONENT_LISTS:
            arguments[name] = choice(kind, arguments[name])
            continue
        specs, alone = arguments[name], "none" if kind == "refiner" else None
        if alone in specs and len(specs) > 1:
            raise click.UsageError(
                f"{_flag(name)} none cannot be combined with another {_flag(name)}: choose one"
            )
        arguments[name] = tuple(choice(kind, spec) for spec in specs if spec != alone)
    return arguments
