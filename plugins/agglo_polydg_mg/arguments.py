"""What is typed after ``agglo solve``: a mesh, components with options, targets of the agglomeration."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

import click

from agglo_core import Mesh, OptionError, read, samples

__all__ = ["agglomeration_options", "component", "load"]

_COMPONENT = "NAME[:opt=val,…]"
_TARGETS = ("h_star", "h_factor", "n_parts", "cells_per_part")
_WORDS = {"true": True, "false": False, "none": None}


def _list_of(number: type[int] | type[float]) -> Callable[..., Any]:
    def parse(_: click.Context, parameter: click.Parameter, text: str | None) -> list[float] | None:
        try:
            return None if text is None else [number(item) for item in text.split(",")]
        except ValueError:
            noun = "whole numbers" if number is int else "numbers"
            raise click.BadParameter(f"{text!r} is not a comma list of {noun}", param=parameter) from None

    return parse


_REALS, _COUNTS = _list_of(float), _list_of(int)
_OPTIONS = (
    click.option("--bisector", metavar=_COMPONENT, help="How a piece is split (default kmeans)."),
    click.option("--method", type=click.Choice(["recursive", "kway"]), help="Default recursive."),
    click.option("--nested/--not-nested", default=None, help="Whether levels coarsen each other (default)."),
    click.option("--refiner", "refiners", multiple=True, metavar=_COMPONENT, help="Repeatable; 'none'."),
    click.option("--fixer", metavar=_COMPONENT, help="Default connectivity."),
    click.option("--h-star", callback=_REALS, metavar="LIST", help="Largest diameters, a level each."),
    click.option("--h-factor", callback=_REALS, metavar="LIST", help="The same over h0 (default 2,4,8)."),
    click.option("--parts", "n_parts", callback=_COUNTS, metavar="LIST", help="Numbers of agglomerates."),
    click.option("--cells-per-part", callback=_REALS, metavar="LIST", help="Mean sizes of agglomerates."),
    click.option("--seed", type=click.IntRange(min=0), help="Default 0."),
)


def agglomeration_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator that adds the options of ``agglo run``; the command gets them as ``agglomeration``.

    That is a mapping of arguments of :func:`agglo_core.agglomerate`; absent ones keep its defaults.
    """

    @wraps(command)
    def gathered(**given: Any) -> Any:
        names = ("bisector", "method", "nested", "refiners", "fixer", *_TARGETS, "seed")
        chosen = {name: given.pop(name) for name in names}
        return command(agglomeration=_arguments(chosen), **given)

    for option in reversed(_OPTIONS):
        gathered = option(gathered)
    return gathered


def _arguments(chosen: dict[str, Any]) -> dict[str, Any]:
    given = {name: value for name, value in chosen.items() if value is not None and value != ()}
    targets = [name for name in _TARGETS if name in given]
    if len(targets) > 1:
        flags = " and ".join(
            "--parts" if name == "n_parts" else f"--{name.replace('_', '-')}" for name in targets
        )
        raise click.UsageError(f"{flags} cannot be given together: choose one")
    if "refiners" in given:
        given["refiners"] = tuple(component(spec) for spec in given["refiners"] if spec != "none")
    for name in ("bisector", "fixer"):
        if name in given:
            given[name] = component(given[name])
    return given


def component(text: str) -> tuple[str, dict[str, Any]]:
    """Name and options of ``"metis:ufactor=30,contig=true"``.

    Raises
    ------
    OptionError
        If an option is not of the form ``option=value``, or is given twice.
    """
    name, _, rest = text.partition(":")
    options: dict[str, Any] = {}
    for item in rest.split(",") if rest else ():
        option, equals, value = (part.strip() for part in item.partition("="))
        if not equals or not option.isidentifier() or not value or option in options:
            raise OptionError(f"{item!r} in {text!r} is not of the form option=value, or is given twice")
        options[option] = _value(value)
    return name.strip(), options


def _value(text: str) -> Any:
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    for number in (int, float):
        try:
            return number(text)
        except ValueError:
            continue
    return text


def load(text: str) -> Mesh:
    """Read the mesh file ``text``, or make the sample it describes."""
    return read(text) if Path(text).exists() else samples.from_spec(text)
