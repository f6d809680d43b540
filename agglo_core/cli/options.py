"""Options that several commands share, and what they mean as arguments of ``agglomerate``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from agglo_core.cli.specs import Value, numbers, parse_spec
from agglo_core.plugins import default
from agglo_core.plugins.construct import resolve

__all__ = ["COMPONENT", "FILE", "arguments", "choice", "pipeline_options", "refuse_twins"]

COMPONENT = "NAME[:opt=val,…]"
FILE = click.Path(path_type=Path)

_FLAGS = {
    "h_star": "--h-star",
    "h_factor": "--h-factor",
    "n_parts": "--parts",
    "cells_per_part": "--cells-per-part",
}
_SIZES, _COUNTS, _MEANS = numbers(float), numbers(int), numbers(float, least=1)
_PIPELINE = (
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


def pipeline_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator that adds refiners, fixer, the four kinds of target, and the seed."""
    for option in reversed(_PIPELINE):
        command = option(command)
    return command


def arguments(
    refiners: Sequence[str],
    fixer: str | None,
    h_star: Sequence[float] | None,
    h_factor: Sequence[float] | None,
    n_parts: Sequence[int] | None,
    cells_per_part: Sequence[float] | None,
    seed: int | None,
) -> dict[str, Any]:
    """What was given as arguments of ``agglomerate``; absent ones keep its defaults.

    Raises
    ------
    UsageError
        If there are several kinds of target, or a refiner beside ``none``.
    PluginError, OptionError
        If a component cannot be used: found out before a mesh is read.
    """
    targets = {"h_star": h_star, "h_factor": h_factor, "n_parts": n_parts, "cells_per_part": cells_per_part}
    given: dict[str, Any] = {name: value for name, value in targets.items() if value is not None}
    if len(given) > 1:
        flags = " and ".join(_FLAGS[name] for name in given)
        raise click.UsageError(f"{flags} cannot be given together: choose one")
    if "none" in refiners and len(refiners) > 1:
        raise click.UsageError("--refiner none cannot be given with another --refiner: choose one")
    if refiners:
        given["refiners"] = tuple(choice("refiner", spec) for spec in refiners if spec != "none")
    if fixer is not None:
        given["fixer"] = choice("fixer", fixer)
    if seed is not None:
        given["seed"] = seed
    return given


def choice(kind: str, spec: str) -> tuple[str, dict[str, Value]]:
    """Name and options of a component that can be used, or PluginError."""
    name, options = parse_spec(spec)
    resolve(default().record(kind, name))
    return name, options


def refuse_twins(flag: str, specs: Sequence[str]) -> None:
    """Raise UsageError if something is given twice."""
    twice = sorted({spec for spec in specs if specs.count(spec) > 1})
    if twice:
        raise click.UsageError(f"{flag} {', '.join(twice)} is given twice")
