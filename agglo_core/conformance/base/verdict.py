"""Exception for a component that breaks a law, and requirements that raise it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

ATTRIBUTES = "required attributes"
"""Cause of failures by attributes that are missing or invalid."""
FORM = "form of the result"
"""Cause of failures by a result of another type or shape."""


class Broken(Exception):
    """Exception raised if a component breaks a law.

    Parameters
    ----------
    message : str
        The fault and its remedy.
    cause : str
        Key of the cause; failures with equal keys are reported once. Empty if the fault is the law's own.
    code : str
        Lines of Python that make the arguments of the failing call; empty if they are not drawn.
    """

    def __init__(self, message: str, cause: str = "", code: str = "") -> None:
        super().__init__(message)
        self.cause, self.code = cause, code


def require(holds: object, message: str, cause: str = "") -> None:
    """Raise :class:`Broken` with the message if the condition ``holds`` is false."""
    if not holds:
        raise Broken(message, cause)


_NUMBERS = {"i": "integers", "b": "booleans", "f": "floats"}


def require_array(
    given: Any, shape: tuple[int, ...], kinds: str, remedy: str = "", what: str = "it"
) -> NDArray[Any]:
    """Return a result as an array, and require its shape and kind of numbers.

    ``kinds`` are characters of numpy's ``dtype.kind``, such as ``"iub"``.
    """
    values = as_array(given)
    numbers = " or ".join(words for kind, words in _NUMBERS.items() if kind in kinds)
    require(
        values.shape == shape and values.dtype.kind in kinds,
        f"{what} returned {in_words(given)}, expected {numbers} of shape {shape}{remedy and ': '}{remedy}",
        FORM,
    )
    return values


def require_close(found: Any, expected: Any, tolerance: float, what: str, remedy: str = "") -> None:
    """Require the shape and values of an array, up to a tolerance relative to the largest expected value."""
    values, wanted = as_array(found), np.asarray(expected)
    require(
        values.shape == wanted.shape and values.dtype.kind in "iuf",
        f"{what} is {in_words(found)}, expected numbers of shape {wanted.shape}",
    )
    gaps = np.where(np.isnan(values), np.inf, np.abs(values - wanted))
    worst = np.unravel_index(np.argmax(gaps), gaps.shape)
    require(
        gaps[worst] <= tolerance * np.abs(wanted).max(),
        f"{what} is {values[worst]:.9g}, expected {wanted[worst]:.9g}{remedy and ': '}{remedy}",
    )


def as_array(given: Any) -> NDArray[Any]:
    """Convert the result of a component to an array, as the core does.

    Ragged lists become arrays of objects.
    """
    try:
        return np.asarray(given)
    except ValueError:
        return np.asarray(given, dtype=object)


def in_words(value: Any) -> str:
    """Describe a value for an error message: type, and shape or beginning of its text."""
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape} and {value.dtype}"
    return f"a {type(value).__name__} ({value!r:.40})"
