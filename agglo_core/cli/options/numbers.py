"""Numeric options and number lists, with error messages that state the expected value."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from typing import Any

import click


@dataclass(frozen=True)
class Number(click.ParamType[float]):
    """Type of numeric options: a finite number within bounds.

    Attributes
    ----------
    kind : type
        ``int`` or ``float``.
    least, above, most : number, optional
        Bounds: at least ``least``, larger than ``above``, at most ``most``.

    Examples
    --------
    >>> from agglo_core.authoring import Number
    >>> Number(int, least=1).convert("3", None, None)
    3
    >>> Number(int, least=1).convert("0", None, None)
    Traceback (most recent call last):
        ...
    click.exceptions.BadParameter: 0 is not in the range; expected a whole number of at least 1
    """

    kind: type[int] | type[float]
    least: float = -inf
    above: float = -inf
    most: float = inf

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name of the type in help texts."""
        return "integer" if self.kind is int else "float"

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> float:
        """Convert a text to a number within the bounds."""
        try:
            number = self.kind(value)
        except ValueError:
            self.fail(self._refusal(value, f"a valid {self.name}"), parameter, context)
        if not (self.least <= number <= self.most and self.above < number < inf):
            self.fail(self._refusal(number, "in the range"), parameter, context)
        return number

    def _refusal(self, value: Any, lacks: str) -> str:
        noun = "a whole number" if self.kind is int else "a finite number"
        bounds = {"of at least": self.least, "above": self.above, "at most": self.most}
        bound_text = " and ".join(
            f"{words} {bound:.15g}" for words, bound in bounds.items() if abs(bound) < inf
        )
        return f"{in_words(value)} is not {lacks}; expected {f'{noun} {bound_text}'.rstrip()}"


def in_words(value: Any) -> str:
    """Return a value in quotation marks for error messages, shortened if long."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:56]}…{text[-1]}"


def numbers(
    number: type[int] | type[float], least: float | None = None
) -> Callable[[click.Context, click.Parameter, Any], tuple[float, ...] | None]:
    """Return a click callback that parses ``"2,4,8"`` to positive numbers of at least ``least``."""
    noun = "whole numbers" if number is int else "numbers"
    condition = "positive and finite" if least is None else f"at least {least:g} and finite"

    def read(_: click.Context, parameter: click.Parameter, text: str | None) -> tuple[float, ...] | None:
        if text is None:
            return None
        try:
            values = tuple(number(item) for item in text.split(","))
        except ValueError:
            message = f"{in_words(text)} is not a comma-separated list of {noun}"
            raise click.BadParameter(message, param=parameter) from None
        for value in values:
            if not (0 < value < inf and value >= (least or 0)):
                message = f"each number must be {condition}, given {in_words(value)}"
                raise click.BadParameter(message, param=parameter)
        return values

    return read
