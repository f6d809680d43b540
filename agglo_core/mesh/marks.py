"""Interpret user-defined groups and weights of cells or faces: tag names, tag values, or arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Mask, frozen_float, plain_array
from agglo_core.errors import OptionError


def in_group(values: NDArray[Any]) -> Mask:
    """Return the mask ``(n,)`` of the cells or faces with a tag: values other than 0 and −1.

    Readers set −1 on faces that the file does not list, and 0 on listed faces of other groups.

    Examples
    --------
    >>> from agglo_core.mesh.marks import in_group
    >>> in_group(np.array([-1, 0, 1, 7, -6])).tolist()
    [False, False, True, True, True]
    """
    mask: Mask = (values != 0) & (values != -1)
    return mask


def select_members(word: str, given: Any, tags: Mapping[str, NDArray[Any]], n: int, what: str) -> Mask:
    """Return the mask ``(n,)`` of cells or faces selected by tag names, tag values, or a mask.

    A name selects the members of that group (see :func:`in_group`), ``name=value`` the members with that
    value, and several names select their union. A mapping holds values or lists of values by name. A boolean
    array is returned unchanged.

    Parameters
    ----------
    word : str
        Rule name, for error messages.
    given : str, sequence of str, mapping of str to values, or (n,) bool
    tags : mapping of str to (n,) int
    n : int
        Cell or face count.
    what : "cell" or "face"

    Raises
    ------
    OptionError
        For an unknown tag, or an unsuitable array.
    """
    if isinstance(given, str):
        return _mask_of_name(word, given, tags, n, what)
    if isinstance(given, Mapping):
        masks = [np.isin(values_of(word, name, tags, n, what), values) for name, values in given.items()]
        return _union(masks, n)
    if isinstance(given, Sequence) and given and all(isinstance(name, str) for name in given):
        return _union([_mask_of_name(word, name, tags, n, what) for name in given], n)
    mask = plain_array(given, word, OptionError)
    if mask.shape != (n,) or mask.dtype != bool:
        raise OptionError(
            f"{word} must be the name of a {what} tag or {n} booleans, one for each {what}; "
            f"given shape {mask.shape} of {mask.dtype}"
        )
    return mask


def values_of(word: str, name: str, tags: Mapping[str, NDArray[Any]], n: int, what: str) -> NDArray[Any]:
    """Return the values ``(n,)`` of a tag by its name, or raise OptionError with the known tags."""
    if name not in tags:
        hint = f"there are {', '.join(tags)}" if tags else "the mesh has none"
        raise OptionError(f"{word}: no {what} tag is named {name!r}; {hint}")
    values = plain_array(tags[name], f"{word}: {what} tag {name!r}", OptionError)
    if values.shape != (n,):
        raise OptionError(f"{word}: {what} tag {name!r} has shape {values.shape}, expected ({n},)")
    return values


def weights_of(given: Any, data: Mapping[str, NDArray[Any]], n: int) -> Float:
    """Return cell weights ``(n,)``, given as an array or as a cell data name.

    Raises
    ------
    OptionError
        For unknown data, or values that are not finite and non-negative, one per cell.
    """
    values = values_of("weights", given, data, n, "cell") if isinstance(given, str) else given
    weights = plain_array(values, "weights", OptionError)
    if weights.shape != (n,) or weights.dtype.kind not in "iufb":
        raise OptionError(
            f"weights must be {n} numbers, one for each cell; given shape {weights.shape} of {weights.dtype}"
        )
    good = np.isfinite(weights) & (weights >= 0)
    if not good.all():
        cell = int(np.argmin(good))
        raise OptionError(f"weights must be finite and not negative; cell {cell} has {weights[cell]}")
    return frozen_float(weights)


def _mask_of_name(word: str, text: str, tags: Mapping[str, NDArray[Any]], n: int, kind: str) -> Mask:
    name, equals, value = text.rpartition("=")
    if not equals or text in tags:
        return in_group(values_of(word, text, tags, n, kind))
    try:
        number = int(value)
    except ValueError:
        raise OptionError(f"{word}: {text!r} must be a tag name, or tag=value with a whole number") from None
    mask: Mask = values_of(word, name, tags, n, kind) == number
    return mask


def _union(masks: Sequence[Mask], n: int) -> Mask:
    """Return the union of several masks."""
    result = np.zeros(n, bool)
    for mask in masks:
        result |= mask
    return result
