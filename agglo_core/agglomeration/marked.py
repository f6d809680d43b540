"""Cells or faces that a user marks: by tags, by tags with the values that count, or by an array."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Mask
from agglo_core.errors import OptionError

__all__ = ["marked", "values_of"]


def marked(word: str, given: Any, tags: Mapping[str, NDArray[Any]], n: int, what: str) -> Mask:
    """Mask ``(n,)`` of what ``given`` marks.

    A name marks where that tag is not zero, ``name=value`` where it has that value, several names where any
    of them does; a mapping has values or lists of values by name; an array of booleans is taken as it is.

    Raises
    ------
    OptionError
        If there is no such tag, or an array does not fit.
    """
    if isinstance(given, str):
        return _by_name(word, given, tags, n, what)
    if isinstance(given, Mapping):
        masks = [np.isin(values_of(word, name, tags, n, what), values) for name, values in given.items()]
        return _any(masks, n)
    if isinstance(given, Sequence) and given and all(isinstance(each, str) for each in given):
        return _any([_by_name(word, each, tags, n, what) for each in given], n)
    mask = np.asarray(given)
    if mask.shape != (n,) or mask.dtype != bool:
        raise OptionError(
            f"{word} must be the name of a {what} tag or {n} booleans, one for each {what}; "
            f"given shape {mask.shape} of {mask.dtype}"
        )
    return mask


def values_of(word: str, name: str, tags: Mapping[str, NDArray[Any]], n: int, what: str) -> NDArray[Any]:
    """Values ``(n,)`` of a tag, or an OptionError that says which tags there are."""
    if name not in tags:
        known = f"there are {', '.join(tags)}" if tags else "the mesh has none"
        raise OptionError(f"{word}: no {what} tag is named {name!r}; {known}")
    values = np.asarray(tags[name])
    if values.shape != (n,):
        raise OptionError(f"{word}: {what} tag {name!r} has shape {values.shape}, expected ({n},)")
    return values


def _by_name(word: str, text: str, tags: Mapping[str, NDArray[Any]], n: int, what: str) -> Mask:
    name, equals, value = text.rpartition("=")
    if not equals or text in tags:
        mask: Mask = values_of(word, text, tags, n, what) != 0
        return mask
    try:
        number = int(value)
    except ValueError:
        raise OptionError(f"{word}: {text!r} should be a tag, or a tag = a whole number") from None
    found: Mask = values_of(word, name, tags, n, what) == number
    return found


def _any(masks: Sequence[Mask], n: int) -> Mask:
    """Where one of the masks is true."""
    result = np.zeros(n, bool)
    for mask in masks:
        result |= mask
    return result
