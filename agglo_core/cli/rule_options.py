"""Options for what users ask of parts: materials, barriers, bounds, what counts are shared out by."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from agglo_core.cli.number_types import Number


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
RULE_OPTIONS: tuple[Callable[[Any], Any], ...] = (
    click.option(
        "--regions",
        metavar="TAG,…",
        callback=_names,
        help="No part holds cells of two regions (cell tags): materials.",
    ),
    click.option(
        "--barriers",
        metavar=_TAGS,
        callback=_names,
        help="No part lies on both sides of faces with a tag: fractures, walls.",
    ),
    click.option(
        "--where",
        metavar=_TAGS,
        callback=_names,
        help="Agglomerate only cells with a tag; all others stay single.",
    ),
    click.option(
        "--boundary-rules",
        type=click.Choice(("ridges",)),
        help="Join cells only with those on the same boundary patches (face tags).",
    ),
    click.option("--weights", metavar="NAME", help="Cell data that counts are shared out by, or bounded."),
    click.option(
        "--balance",
        type=click.Choice(("cells", "measure", "weights")),
        help="What counts are shared out by (default cells).",
    ),
    click.option("--max-cells", type=Number(int, least=1), help="No part has more cells."),
    click.option("--min-cells", type=Number(int, least=1), help="Smaller parts join a neighbour."),
    click.option("--max-measure", type=Number(float, above=0), help="No part is larger, but single cells."),
    click.option("--min-measure", type=Number(float, above=0), help="Smaller parts join a neighbour."),
    click.option("--max-weight", type=Number(float, above=0), help="No part is heavier, but single cells."),
    click.option("--min-weight", type=Number(float, above=0), help="Lighter parts join a neighbour."),
    click.option(
        "--metric-tensor",
        "metric",
        metavar="LIST",
        callback=_tensor,
        help="Tensor that lengths are measured in, row by row: 1,0,0,100.",
    ),
    click.option("--lines/--no-lines", default=None, help="Keep lines of strongly coupled cells."),
)
RULES = (
    "regions",
    "barriers",
    "where",
    "boundary_rules",
    "weights",
    "balance",
    "max_cells",
    "min_cells",
    "max_measure",
    "min_measure",
    "max_weight",
    "min_weight",
    "metric",
    "lines",
)
"""Names of these options as arguments of :func:`agglo_core.agglomerate`."""
