"""Reading what is typed: ``NAME:option=value,…`` and comma lists of numbers."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import Any

import click

from agglo_core.errors import OptionError

__all__ = ["Value", "numbers", "parse_spec", "parse_value", "split_specs"]

Value = int | float | bool | str | None

_WORDS = {"true": True, "false": False, "none": None}


def parse_value(text: str) -> Value:
    """An integer, a number, true, false or none if ``text`` reads as one; else the text itself."""
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    for number in (int, float):
        try:
            return number(text)
        except ValueError:
            continue
    return text


def parse_spec(text: str) -> tuple[str, dict[str, Value]]:
    """Split ``"metis:ufactor=30,contig=true"`` into its name and options.

    Raises
    ------
    OptionError
        If the name is missing, or an option is not of the form ``option=value`` or is given twice.
    """
    name, _, rest = text.partition(":")
    if not name.strip():
        raise OptionError(f"{text!r} has no name; expected NAME or NAME:option=value,…")
    options: dict[str, Value] = {}
    for item in rest.split(",") if rest else ():
        option, equals, value = (part.strip() for part in item.partition("="))
        if not equals or not option.isidentifier() or not value:
            raise OptionError(f"{item!r} in {text!r} is not of the form option=value")
        if option in options:
            raise OptionError(f"{text!r} gives {option!r} twice")
        options[option] = parse_value(value)
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
