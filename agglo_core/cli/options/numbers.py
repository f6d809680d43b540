"""Options that are numbers: what does not fit is refused with what was expected, NaN and infinities too."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Any

import click


@dataclass(frozen=True)
class Number(click.ParamType[float]):
    """A finite number within bounds.

    Attributes
    ----------
    kind : type
        ``int`` or ``float``.
    least, above, most : number, optional
        It is at least ``least``, larger than ``above``, at most ``most``.

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
        """How help texts call it."""
        return "integer" if self.kind is int else "float"

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> float:
        """The number a text stands for."""
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
        said = " and ".join(f"{words} {bound:.15g}" for words, bound in bounds.items() if abs(bound) < inf)
        return f"{in_words(value)} is not {lacks}; expected {f'{noun} {said}'.rstrip()}"


def in_words(value: Any) -> str:
    """A value as error messages quote it: the beginning of a long one."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:56]}…{text[-1]}"
