"""Options of agglomeration for commands, also of plugins, with the help texts of the keywords of a run.

.. code-block:: python

    @click.command()
    @click.argument("source", metavar="MESH|SAMPLE")
    @agglomeration_options
    def mine(source: str, agglomeration: dict[str, Any]) -> None:
        hierarchy = agglomerate(load_mesh(source), **agglomeration)

Decorated like this, a command chooses bisector and method in its own way, if at all. With
``@agglomeration_options(bisector="one")`` it has all options of ``agglo run``, under the same names.

Nothing heavy is imported before a mesh is loaded.
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
    HELP,
    METHODS,
    NAMES,
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
    """A path; an empty text is none."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "":
            self.fail("the name of the file is empty", param, ctx)
        return super().convert(value, param, ctx)


FILE = _File(path_type=Path)
Amount = Literal["one", "several"]


def read_methods(_: click.Context, parameter: click.Parameter, text: str | None) -> list[str]:
    """The methods of a comma list, none twice; a click callback."""
    methods = [method.strip() for method in text.split(",")] if text is not None else []
    flag = parameter.opts[0]
    unknown = [method for method in methods if method not in METHODS]
    if unknown:
        raise click.UsageError(f"{flag}: {unknown[0]!r} is none of {', '.join(METHODS)}")
    refuse_duplicates(flag, methods)
    return methods


def _names(_: click.Context, parameter: click.Parameter, text: str | None) -> tuple[str, ...] | None:
    """The items of a comma list."""
    if text is None:
        return None
    names = tuple(each.strip() for each in text.split(","))
    if not all(names):
        raise click.BadParameter(f"{text!r} is not a comma list of tags", param=parameter)
    return names


def _tensor(_: click.Context, parameter: click.Parameter, text: str | None) -> list[list[float]] | None:
    """A square matrix of 4 or 9 numbers."""
    if text is None:
        return None
    try:
        values = [float(each) for each in text.split(",")]
    except ValueError:
        values = []
    d = {4: 2, 9: 3}.get(len(values))
    if d is None:
        raise click.BadParameter(f"{text!r} is not a comma list of 4 or 9 numbers", param=parameter)
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
_BARE = ("refiners", "fixer", *TARGETS, "seed")
_ALL = (*NAMES, "config", "allow_code")


def _flag(name: str) -> str:
    """Option of a keyword on the command line."""
    return _FLAGS.get(name) or f"--{name.replace('_', '-')}"


def _option(name: str, **settings: Any) -> Decorator:
    """Option of a keyword that takes a value."""
    return click.option(_flag(name), name, help=HELP[name], **settings)


def _component(name: str) -> Decorator:
    """Option of a keyword that names components of a kind."""
    several = name in COMPONENT_LISTS
    also = ("none",) if COMPONENTS[name] == "refiner" else ()
    offer = names(COMPONENTS[name], also=also)
    return _option(name, multiple=several, metavar=COMPONENT, shell_complete=offer)


def _numbers(name: str, kind: type[int] | type[float], least: float | None = None) -> Decorator:
    """Option of a target: a comma list with a number for each level."""
    return _option(name, callback=numbers(kind, least=least), metavar="LIST")


def _bound(name: str) -> Decorator:
    """Option of a bound on parts."""
    return _option(name, type=Number(int, least=1) if name.endswith("cells") else Number(float, above=0))


def _switch(name: str) -> Decorator:
    """Option of a keyword that is true or false; by default that of :func:`~agglo_core.agglomerate`."""
    return click.option(_SWITCHES[name], name, default=None, help=HELP[name])


_ONE_BISECTOR = _component("bisector")
_METHOD = _option("method", type=click.Choice(METHODS))
_METHOD_LIST = click.option(
    "--method", "methods", callback=read_methods, metavar="LIST", help="recursive (default), kway, or both."
)
_NESTED, _REFINER, _FIXER = _switch("nested"), _component("refiners"), _component("fixer")
_LAST_STEPS = (_switch("merge"), _switch("polish"), _component("post_refiners"), _component("constraints"))
_TARGET_OPTIONS = (
    _numbers("h_star", float),
    _numbers("h_factor", float),
    _numbers("n_parts", int),
    _numbers("cells_per_part", float, least=1),
    _option("seed", type=Number(int, least=0)),
)
_RULE_OPTIONS = (
    _option("regions", metavar="TAG,…", callback=_names),
    _option("barriers", metavar=_TAGS, callback=_names),
    _option("where", metavar=_TAGS, callback=_names),
    _option("boundary_rules", type=click.Choice(("ridges",))),
    _option("weights", metavar="NAME"),
    _option("balance", type=click.Choice(BALANCES)),
    *map(_bound, BOUNDS),
    _option("metric", metavar="LIST", callback=_tensor),
    _switch("lines"),
)
_CONFIG = (
    click.option("--config", type=FILE, help="TOML file; options given here win."),
    click.option(
        "--allow-code",
        is_flag=True,
        default=None,
        help="Let options in TOML files name code, which is imported and run.",
    ),
)


@overload
def agglomeration_options(command: Command) -> Command: ...
@overload
def agglomeration_options(*, bisector: Amount = "one", method: Amount = "one") -> Decorator: ...
def agglomeration_options(
    command: Command | None = None, *, bisector: Amount = "one", method: Amount = "one"
) -> Command | Decorator:
    """Decorator that adds the options of agglomeration to a command.

    The command gets them as one mapping ``agglomeration`` of arguments of
    :func:`agglo_core.agglomerate`; absent ones keep its defaults. Several kinds of target, or a refiner
    beside ``none``, are a UsageError; a component that cannot be used is a PluginError before a mesh is
    read.

    Parameters
    ----------
    command : callable, optional
        Decorated without arguments, it gets refiners, fixer, the four kinds of target, and the seed.
    bisector : "one" or "several"
        All the options of ``agglo run``: also bisector, method, nested, merge, polish,
        post-refiners, constraints, rules for the parts, config. With "several" the command gets
        ``bisectors`` besides, a list of texts for :func:`choice`, empty if none was given.
    method : "one" or "several"
        With "several" the command gets ``methods`` besides, a list of words, empty if none was given.

    Examples
    --------
    >>> from agglo_core.authoring import agglomeration_options
    >>> @click.command()
    ... @agglomeration_options
    ... def mine(agglomeration):
    ...     print(agglomeration)
    >>> mine(["--parts", "8,2", "--refiner", "none"], standalone_mode=False)
    {'refiners': (), 'n_parts': (8, 2)}
    """
    if command is not None:
        return _gathering(command, [_REFINER, _FIXER, *_TARGET_OPTIONS], _BARE)
    usual = "all" if method == "several" else "kmeans"
    several = bisectors_option(f"How a piece is split (default {usual}); several are compared.")
    chosen = several if bisector == "several" else _ONE_BISECTOR
    methods = _METHOD_LIST if method == "several" else _METHOD
    options = [chosen, methods, _NESTED, _REFINER, _FIXER, *_LAST_STEPS, *_TARGET_OPTIONS]
    options += [*_RULE_OPTIONS, *_CONFIG]
    options.append(threads_option)
    return lambda inner: _gathering(inner, options, _ALL)


def _gathering(command: Command, options: Sequence[Decorator], names: Sequence[str]) -> Command:
    """The command with these options, those of some names gathered in one argument ``agglomeration``."""

    @wraps(command)
    def gathered(**given: Any) -> Any:
        chosen = {name: given.pop(name) for name in names if name in given}
        return command(agglomeration=_arguments(chosen), **given)

    decorated: Command = gathered
    for option in reversed(options):
        decorated = option(decorated)
    return decorated


def _arguments(chosen: dict[str, Any]) -> dict[str, Any]:
    given = {name: value for name, value in chosen.items() if value is not None and value != ()}
    targets = [_flag(name) for name in TARGETS if name in given]
    if len(targets) > 1:
        raise click.UsageError(f"{' and '.join(targets)} cannot be given together: choose one")
    for name, kind in COMPONENTS.items():
        if name not in given:
            continue
        if name not in COMPONENT_LISTS:
            given[name] = choice(kind, given[name])
            continue
        specs, alone = given[name], "none" if kind == "refiner" else None
        if alone in specs and len(specs) > 1:
            raise click.UsageError(
                f"{_flag(name)} none cannot be given with another {_flag(name)}: choose one"
            )
        given[name] = tuple(choice(kind, spec) for spec in specs if spec != alone)
    return given
