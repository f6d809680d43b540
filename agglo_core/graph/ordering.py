"""Orders of cells along a space-filling curve: neighbours in space become neighbours in memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, frozen_int

__all__ = ["curve_order"]


def curve_order(centroids: Float) -> Int:
    """Order ``(n,)`` of points ``(n, d)`` along a Morton curve of 2^16 (2-D) or 2^10 (3-D) steps."""
    d = centroids.shape[1]
    bits = 16 if d == 2 else 10
    columns = np.ascontiguousarray(centroids.T)  # reductions along rows are far slower
    low = columns.min(axis=1, keepdims=True)
    extent = float((columns.max(axis=1, keepdims=True) - low).max()) or 1.0
    steps = ((columns - low) * ((2**bits - 1) / extent)).astype(np.uint32)
    spread = _spread2 if d == 2 else _spread3
    key = np.zeros(len(centroids), np.uint32)
    for k in range(d):
        key |= spread(steps[k]) << np.uint32(k)
    return frozen_int(np.argsort(key))


def _spread2(x: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Insert a zero bit between the 16 low bits."""
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        x = (x | (x << np.uint32(shift))) & np.uint32(mask)
    return x


def _spread3(x: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Insert two zero bits between the 10 low bits."""
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        x = (x | (x << np.uint32(shift))) & np.uint32(mask)
    return x
