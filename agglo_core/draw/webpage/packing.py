"""Array compression in the report: smallest sufficient type, deflate, base64.

``data.js`` unpacks them.
"""

from __future__ import annotations

import base64
import zlib
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

_INTEGERS = (("Uint8", "<u1"), ("Uint16", "<u2"), ("Uint32", "<u4"))
_EFFORT: Final = 5
"""zlib level: higher levels take twice the time to save 1 % of the size."""


def integers(values: ArrayLike) -> dict[str, Any]:
    """Compress integers from 0 to 2³² − 1."""
    name, array = _shrink_type(values)
    return _compress(name, array.tobytes())


def separate_bytes(values: ArrayLike) -> dict[str, Any]:
    """Compress integers with mostly equal high bytes: all lowest bytes first, then the next bytes, …"""
    return _separate_bytes(*_shrink_type(values))


def differences(values: ArrayLike) -> dict[str, Any]:
    """Compress integers that change little from one to the next, by their differences.

    Differences 0, −1, 1, −2, … are stored as 0, 1, 2, 3, …
    """
    steps = np.array(values, dtype=np.int64)
    steps[1:] -= steps[:-1].copy()
    return separate_bytes((steps << 1) ^ (steps >> 63)) | {"differences": True}


def reals(values: ArrayLike) -> dict[str, Any]:
    """Compress real numbers to seven digits, byte by byte as :func:`separate_bytes`."""
    return _separate_bytes("Float32", np.asarray(values).astype("<f4"))


def _shrink_type(values: ArrayLike) -> tuple[str, NDArray[np.generic]]:
    array = np.asarray(values)
    largest = int(array.max(initial=0))
    name, kind = next(pair for pair in _INTEGERS if largest <= np.iinfo(pair[1]).max)
    return name, array.astype(kind)


def _separate_bytes(name: str, array: NDArray[np.generic]) -> dict[str, Any]:
    planes = np.ascontiguousarray(array).view(np.uint8).reshape(-1, array.itemsize).T
    return _compress(name, planes.tobytes()) | {"apart": True}


def _compress(name: str, raw: bytes) -> dict[str, Any]:
    return {"type": name, "data": base64.b64encode(zlib.compress(raw, _EFFORT)).decode("ascii")}
