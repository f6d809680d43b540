"""Values to try for the options of a component."""

from __future__ import annotations

from enum import Enum
from typing import Any, Literal, get_args, get_origin

from agglo_core.conformance.base import Subject
from agglo_core.registry.options import Option, options_of


def option_choices(subject: Subject, *, but: str = "") -> list[dict[str, Any]]:
    """Return no options, then each value of each option but one, with the others left out."""
    options = [option for option in options_of(subject.target) or () if option.name != but]
    return [{}, *({option.name: value} for option in options for value in option_values(option))]


def option_values(option: Option) -> list[Any]:
    """Return a few values for an option of a common type."""
    default = option.default
    if get_origin(option.type) is Literal:
        return list(get_args(option.type))
    if isinstance(default, Enum):
        return list(type(default))
    if isinstance(default, bool):
        return [False, True]
    if isinstance(default, int):
        return [2, 3, 5, 7, 10]
    if isinstance(default, float):
        return [default, 0.9 * default, 1.1 * default + 0.01, 0.5 * default + 0.1, 2.0 * default + 0.3]
    return []
