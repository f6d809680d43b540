"""What is typed after a command: meshes, components with options, targets. For plugins' commands too.

.. code-block:: python

    @click.command()
    @click.argument("source", metavar="MESH|SAMPLE")
    @agglomeration_options
    def mine(source: str, agglomeration: dict[str, Any]) -> None:
        hierarchy = agglomerate(load_mesh(source), **agglomeration)

Nothing heavy is imported before a mesh is loaded.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import wraps
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from agglo_core.errors import FileError, OptionError
from agglo_core.registry import default
from agglo_core.registry.construct import checked_options, resolve
from agglo_core.registry.options import Text

if TYPE_CHECKING:
    from agglo_core.mesh import Mesh

__all__ = [
    "COMPONENT",
    "FILE",
    "agglomeration_options",
    "choice",
    "load_mesh",
    "numbers",
    "parse_spec",
    "refuse_twins",
    "split_specs",
]

COMPONENT = "NAME[:opt=val,…]"
"""Metavar of an option that names a component."""
FILE = click.Path(path_type=Path)

_SAMPLE = re.compile(r"([\w.-]+/)?[A-Za-z_]\w*(:(\w+=.*|[^/\\]*))?")
_TARGETS = {
    "h_star": "--h-star",
    "h_factor": "--h-factor",
    "n_parts": "--parts",
    "cells_per_part": "--cells-per-part",
}


def load_mesh(text: str) -> Mesh:
    """Read the mesh file ``text``, or make the sample it describes.

    Raises
    ------
    FileError
        If it is a file that cannot be read, or neither a file nor the form of a sample.
    OptionError
        If it has the form of a sample, but is none.
    """
    if not text:
        raise FileError("the name of the mesh is empty; expected a file or a sample such as squares:n=64")
    if Path(text).exists():
        from agglo_core.io import read

        return read(Path(text))
    if not _SAMPLE.fullmatch(text):
        raise FileError(
            f"{text!r} is neither a file (there is none of that name) nor a sample such as squares:n=64"
        )
    from agglo_core import samples

    try:
        return samples.from_spec(text)
    except OptionError as error:
        raise OptionError(
            f"{text!r} is neither a file (there is none of that name) nor a sample: {error}"
        ) from error


def parse_spec(text: str) -> tuple[str, dict[str, Text]]:
    """Split ``"metis:ufactor=30,contig=true"`` into its name and options, each as it was typed.

    Raises
    ------
    OptionError
        If the name is missing, or an option is not of the form ``option=value`` or is given twice.
    """
    name, _, rest = text.partition(":")
    if not name.strip():
        raise OptionError(f"{text!r} has no name; expected NAME or NAME:option=value,…")
    options: dict[str, Text] = {}
    for item in rest.split(",") if rest else ():
        option, equals, value = (part.strip() for part in item.partition("="))
        if not equals or not option.isidentifier() or not value:
            raise OptionError(f"{item!r} in {text!r} is not of the form option=value")
        if option in options:
            raise OptionError(f"{text!r} gives {option!r} twice")
        options[option] = Text(value)
    return name.strip(), options


def split_specs(text: str) -> list[str]:
    """Split ``"kmeans,metis:ufactor=30,contig=true,spectral"`` into its three components.

    An item ``option=value`` belongs to the component before it.
    """
    specs: list[str] = []
    for item in text.split(","):
        continues = "=" in item.partition(":")[0]
        if continues and specs:
            specs[-1] += f",{item}"
        else:
            specs.append(item.strip())
    return specs


def choice(kind: str, spec: str) -> tuple[str, dict[str, Any]]:
    """Name and options of a component that can be used, each option as its type wants it.

    Raises
    ------
    PluginError
        If there is no such component, or it cannot be used.
    OptionError
        For an option that it does not have, or a value that does not fit.
    """
    name, options = parse_spec(spec)
    record = default().record(kind, name)
    return name, checked_options(record, resolve(record), options)


def refuse_twins(flag: str, specs: Sequence[str]) -> None:
    """Raise UsageError if something is given twice."""
    twice = sorted({spec for spec in specs if specs.count(spec) > 1})
    if twice:
        raise click.UsageError(f"{flag} {', '.join(twice)} is given twice")


def numbers(
    number: type[int] | type[float], least: float | None = None
) -> Callable[[click.Context, click.Parameter, Any], tuple[float, ...] | None]:
    """A click callback that turns ``"2,4,8"`` into a tuple of positive numbers, ``least`` or more."""

    def read(_: click.Context, parameter: click.Parameter, text: str | None) -> tuple[float, ...] | None:
        if text is None:
            return None
        try:
            values = tuple(number(item) for item in text.split(","))
        except ValueError:
            noun = "whole numbers" if number is int else "numbers"
            raise click.BadParameter(f"{text!r} is not a comma list of {noun}", param=parameter) from None
        for value in values:
            if not (0 < value < inf and value >= (least or 0)):
                wanted = "positive and finite" if least is None else f"at least {least:g} and finite"
                raise click.BadParameter(f"each number must be {wanted}, given {value}", param=parameter)
        return values

    return read


_SIZES, _COUNTS, _MEANS = numbers(float), numbers(int), numbers(float, least=1)
_OPTIONS = (
    click.option(
        "--refiner", "refiners", multiple=True, metavar=COMPONENT, help="Repeatable; 'none' for none."
    ),
    click.option("--fixer", metavar=COMPONENT, help="Default connectivity."),
    click.option("--h-star", callback=_SIZES, metavar="LIST", help="Largest diameters, a level each."),
    click.option("--h-factor", callback=_SIZES, metavar="LIST", help="The same over h0 (default 2,4,8)."),
    click.option("--parts", "n_parts", callback=_COUNTS, metavar="LIST", help="Numbers of agglomerates."),
    click.option("--cells-per-part", callback=_MEANS, metavar="LIST", help="Mean sizes of agglomerates."),
    click.option("--seed", type=click.IntRange(min=0), help="Default 0."),
)


def agglomeration_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator that adds refiners, fixer, the four kinds of target, and the seed.

    The command gets them as one mapping ``agglomeration`` of arguments of
    :func:`agglo_core.agglomerate`; absent ones keep its defaults. Several kinds of target, or a refiner
    beside ``none``, are a UsageError; a component that cannot be used is a PluginError before a mesh is
    read.
    """

    @wraps(command)
    def gathered(**given: Any) -> Any:
        names = ("refiners", "fixer", *_TARGETS, "seed")
        chosen = {name: given.pop(name) for name in names}
        return command(agglomeration=_arguments(chosen), **given)

    for option in reversed(_OPTIONS):
        gathered = option(gathered)
    return gathered


def _arguments(chosen: dict[str, Any]) -> dict[str, Any]:
    given = {name: value for name, value in chosen.items() if value is not None and value != ()}
    targets = [flag for name, flag in _TARGETS.items() if name in given]
    if len(targets) > 1:
        raise click.UsageError(f"{' and '.join(targets)} cannot be given together: choose one")
    refiners = given.get("refiners", ())
    if "none" in refiners and len(refiners) > 1:
        raise click.UsageError("--refiner none cannot be given with another --refiner: choose one")
    if refiners:
        given["refiners"] = tuple(choice("refiner", spec) for spec in refiners if spec != "none")
    if "fixer" in given:
        given["fixer"] = choice("fixer", given["fixer"])
    return given
