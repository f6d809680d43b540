"""Array types and the read-only rule: dataclasses hold read-only C-contiguous arrays.

Read-only inputs also give every numba kernel one signature: an argument is always a read-only view,
an output always fresh.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "Bytes",
    "Float",
    "Index",
    "Int",
    "Mask",
    "UInt64",
    "first_of_each",
    "fits_in_index",
    "frozen",
    "frozen_float",
    "frozen_index",
    "frozen_int",
    "label_order",
    "narrow",
    "splitmix",
]

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Index = NDArray[np.int32]
UInt64 = NDArray[np.uint64]
Bytes = NDArray[np.uint8]
Mask = NDArray[np.bool_]

_MIX = tuple(np.uint64(c) for c in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))


def frozen(values: ArrayLike, dtype: Any) -> NDArray[Any]:
    """Read-only C-contiguous view of ``values`` in ``dtype`` (a copy only if one is needed).

    Examples
    --------
    >>> from agglo_core.authoring import frozen
    >>> values = frozen([1, 2], np.int16)
    >>> values, values.flags.writeable
    (array([1, 2], dtype=int16), False)
    """
    if type(values) is np.ndarray and values.dtype == dtype:  # most are, and frozen already
        array = values if values.flags.c_contiguous else np.ascontiguousarray(values)
    else:
        array = np.ascontiguousarray(values, dtype=dtype)
        if np.ndim(values) == 0:
            array = array.reshape(())
    if array.flags.writeable:
        array = array.view()
        array.flags.writeable = False
    return array


def frozen_float(values: ArrayLike) -> Float:
    """Read-only float64 array.

    Examples
    --------
    >>> from agglo_core.authoring import frozen_float
    >>> frozen_float([1, 2]).dtype.name
    'float64'
    """
    return frozen(values, np.float64)


def frozen_int(values: ArrayLike) -> Int:
    """Read-only int64 array (labels, offsets).

    Examples
    --------
    >>> from agglo_core.authoring import frozen_int
    >>> labels = frozen_int([0, 0, 1])
    >>> labels.dtype.name, labels.flags.writeable
    ('int64', False)
    """
    return frozen(values, np.int64)


def frozen_index(values: ArrayLike) -> Index:
    """Read-only int32 array (CSR indices).

    Examples
    --------
    >>> from agglo_core.authoring import frozen_index
    >>> frozen_index([1, 2]).dtype.name
    'int32'
    """
    return frozen(values, np.int32)


def label_order(labels: Int) -> Int:
    """Stable order ``(n,)`` of labels from 0 on, by 16 bits at a time: several times faster than argsort."""
    order = np.argsort((labels & 0xFFFF).astype(np.uint16), kind="stable")
    for shift in range(16, int(labels.max(initial=0)).bit_length(), 16):
        digits = (labels >> shift & 0xFFFF).astype(np.uint16)
        order = order[np.argsort(digits[order], kind="stable")]
    return frozen_int(order)


def narrow(values: NDArray[Any]) -> NDArray[Any]:
    """Integers in 32 bits if all fit, other values as they are."""
    return values.astype(np.int32) if fits_in_index(values) else values


def fits_in_index(values: NDArray[Any]) -> bool:
    """Whether the values are int64 and fit in 32 bits."""
    if values.dtype != np.int64:
        return False
    limits = np.iinfo(np.int32)
    return bool(limits.min <= values.min(initial=0) and values.max(initial=0) <= limits.max)


def first_of_each(labels: Int) -> Int:
    """Place ``(k,)`` of the first of each label 0..k−1, of which none is missing."""
    first = np.empty(int(labels.max(initial=-1)) + 1, np.int64)
    first[labels[::-1]] = np.arange(len(labels))[::-1]  # the last one assigned stays
    return frozen_int(first)


def splitmix(seeds: UInt64) -> UInt64:
    """The splitmix64 mixing step: well-spread numbers from any distinct ones."""
    z = seeds + _MIX[0]
    z = (z ^ (z >> np.uint64(30))) * _MIX[1]
    z = (z ^ (z >> np.uint64(27))) * _MIX[2]
    return np.asarray(z ^ (z >> np.uint64(31)))
