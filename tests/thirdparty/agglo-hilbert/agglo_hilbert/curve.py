"""Hilbert curve in any dimension: Skilling, "Programming the Hilbert curve", AIP Conf. Proc. 707, 2004."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["hilbert_keys"]


def hilbert_keys(grid: NDArray[np.uint64], bits: int) -> NDArray[np.uint64]:
    """Return positions ``(n,)`` along the curve for integer points ``(n, d)``.

    Coordinates are in ``0..2^bits − 1``, with d · bits ≤ 64.
    """
    axes = np.array(grid.T, dtype=np.uint64)
    powers = [np.uint64(1 << bit) for bit in range(bits - 1, 0, -1)]
    for power in powers:  # undo the rotations of smaller and smaller squares
        low = power - np.uint64(1)
        for axis in axes:
            high = (axis & power) > 0
            swap = np.where(high, 0, (axes[0] ^ axis) & low)
            axes[0] ^= np.where(high, low, swap)
            axis ^= swap
    np.bitwise_xor.accumulate(axes, axis=0, out=axes)  # Gray code
    flips = np.zeros(len(grid), np.uint64)
    for power in powers:
        flips ^= np.where((axes[-1] & power) > 0, power - np.uint64(1), np.uint64(0))
    axes ^= flips
    # Interleave the bits of the coordinates.
    keys = np.zeros(len(grid), np.uint64)
    for bit in range(bits - 1, -1, -1):
        for axis in axes:
            keys = (keys << np.uint64(1)) | ((axis >> np.uint64(bit)) & np.uint64(1))
    return keys
