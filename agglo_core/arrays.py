"""Array types and the read-only rule: dataclasses hold read-only C-contiguous arrays.

Read-only inputs also give every numba kernel one signature: an argument is always a read-only view,
an output always fresh.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Float", "Index", "Int", "Mask", "UInt64", "frozen", "frozen_float", "frozen_index", "frozen_int"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Index = NDArray[np.int32]
UInt64 = NDArray[np.uint64]
Mask = NDArray[np.bool_]


def frozen(values: ArrayLike, dtype: Any) -> NDArray[Any]:
    """Read-only C-contiguous view of ``values`` in ``dtype`` (a copy only if one is needed)."""
    if type(values) is np.ndarray and values.dtype == dtype:  # most are frozen already
        flags = values.flags
        if flags.c_contiguous and not flags.writeable:
            return values
    array = np.ascontiguousarray(values, dtype=dtype)
    if np.ndim(values) == 0:
        array = array.reshape(())
    if array.flags.writeable:
        array = array.view()
        array.flags.writeable = False
    return array


def frozen_float(values: ArrayLike) -> Float:
    """Read-only float64 array."""
    return frozen(values, np.float64)


def frozen_int(values: ArrayLike) -> Int:
    """Read-only int64 array (labels, offsets)."""
    return frozen(values, np.int64)


def frozen_index(values: ArrayLike) -> Index:
    """Read-only int32 array (CSR indices)."""
    return frozen(values, np.int32)
