"""Arrays for the page: base64, in the smallest type that holds them."""

from __future__ import annotations

import base64

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["integers", "reals"]

_INTEGERS = (("Uint8", "<u1"), ("Uint16", "<u2"), ("Uint32", "<u4"))


def integers(values: ArrayLike) -> dict[str, str]:
    """Whole numbers, 0 or more."""
    array = np.asarray(values)
    largest = int(array.max(initial=0))
    name, kind = next(pair for pair in _INTEGERS if largest <= np.iinfo(pair[1]).max)
    return _packed(name, array.astype(kind))


def reals(values: ArrayLike) -> dict[str, str]:
    """Real numbers, to seven digits."""
    return _packed("Float32", np.asarray(values).astype("<f4"))


def _packed(name: str, array: NDArray[np.generic]) -> dict[str, str]:
    return {"type": name, "data": base64.b64encode(array.tobytes()).decode("ascii")}
