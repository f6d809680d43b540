"""Options and arguments of commands: meshes, components with options, targets. For plugins' commands too.

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

from agglo_core.cli.completing import names
from agglo_core.cli.number_types import Number
from agglo_core.cli.rule_options import RULE_OPTIONS, RULES
from agglo_core.cli.shared_options import (
    COMPONENT,
    Command,
    Decorator,
    bisectors_option,
    threads_option,
)
from agglo_core.cli.specs import (
    choice,
    numbers,
    refuse_duplicates,
)


class _File(click.Path):
    """A path; an empty text is none."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "":
            self.fail("the name of the file is empty", param, ctx)
        return super().convert(value, param, ctx)


FILE = _File(path_type=Path)
METHODS = ("recursive", "kway")

_TARGETS = {
    "h_star": "--h-star",
    "h_factor": "--h-factor",
    "n_parts": "--parts",
    "cells_per_part": "--cells-per-part",
}
_BARE = ("refiners", "fixer", *_TARGETS, "seed")
_LAST = ("merge", "polish", "post_refiners", "constraints", "config", "allow_code")
_ALL = ("bisector", "method", "nested", *_BARE, *_LAST, *RULES)
_SEVERAL = {"refiners": ("refiner", "--refiner"), "post_refiners": ("refiner", "--post-refiner")}

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


_ONE_BISECTOR = click.option(
    "--bisector",
    metavar=COMPONENT,
    shell_complete=names("bisector"),
    help="How a piece is split (default kmeans).",
)
_METHOD = click.option("--method", type=click.Choice(METHODS), help="Default recursive.")
_METHOD_LIST = click.option(
    "--method", "methods", callback=read_methods, metavar="LIST", help="recursive (default), kway, or both."
)
_NESTED = click.option(
    "--nested/--not-nested", default=None, help="Whether levels coarsen each other (default)."
)
_SIZES, _COUNTS, _MEANS = numbers(float), numbers(int), numbers(float, least=1)
_REFINER = click.option(
    "--refiner",
    "refiners",
    multiple=True,
    metavar=COMPONENT,
    shell_complete=names("refiner", also=("none",)),
    help="Repeatable; 'none' for none.",
)
_FIXER = click.option(
    "--fixer", metavar=COMPONENT, shell_complete=names("fixer"), help="Default connectivity."
)
_LAST_STEPS = (
    click.option(
        "--merge/--no-merge", default=None, help="Sizes: merge neighbours while they meet the target."
    ),
    click.option(
        "--polish/--no-polish", default=None, help="Whether finished levels are polished (default)."
    ),
    click.option(
        "--post-refiner",
        "post_refiners",
        multiple=True,
        metavar=COMPONENT,
        shell_complete=names("refiner", also=("none",)),
        help="For each finished level (default compactness). Repeatable; 'none' for none.",
    ),
    click.option(
        "--constraint",
        "constraints",
        multiple=True,
        metavar=COMPONENT,
        shell_complete=names("constraint"),
        help="A rule for the parts. Repeatable.",
    ),
)
_TARGET_OPTIONS = (
    click.option("--h-star", callback=_SIZES, metavar="LIST", help="Largest diameters, a level each."),
    click.option("--h-factor", callback=_SIZES, metavar="LIST", help="The same over h0 (default 2,4,8)."),
    click.option("--parts", "n_parts", callback=_COUNTS, metavar="LIST", help="Numbers of agglomerates."),
    click.option("--cells-per-part", callback=_MEANS, metavar="LIST", help="Mean sizes of agglomerates."),
    click.option("--seed", type=Number(int, least=0), help="Default 0."),
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
    options += [*RULE_OPTIONS, *_CONFIG]
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
    targets = [flag for name, flag in _TARGETS.items() if name in given]
    if len(targets) > 1:
        raise click.UsageError(f"{' and '.join(targets)} cannot be given together: choose one")
    for name, (kind, flag) in _SEVERAL.items():
        specs = given.get(name, ())
        if "none" in specs and len(specs) > 1:
            raise click.UsageError(f"{flag} none cannot be given with another {flag}: choose one")
        if specs:
            given[name] = tuple(choice(kind, spec) for spec in specs if spec != "none")
    for name in ("bisector", "fixer"):
        if name in given:
            given[name] = choice(name, given[name])
    if "constraints" in given:
        given["constraints"] = tuple(choice("constraint", spec) for spec in given["constraints"])
    return given
