"""Compute sort keys of points along a Morton (Z-order) curve."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@helper
def _spread_by_one(x):
    """Spread the 16 low bits of x to every second bit, to interleave two coordinates."""
    x = (x | (x << np.uint64(8))) & np.uint64(0x00FF00FF)
    x = (x | (x << np.uint64(4))) & np.uint64(0x0F0F0F0F)
    x = (x | (x << np.uint64(2))) & np.uint64(0x33333333)
    return (x | (x << np.uint64(1))) & np.uint64(0x55555555)


@helper
def _spread_by_two(x):
    """Spread the 10 low bits of x to every third bit, to interleave three coordinates."""
    x = (x | (x << np.uint64(16))) & np.uint64(0x030000FF)
    x = (x | (x << np.uint64(8))) & np.uint64(0x0300F00F)
    x = (x | (x << np.uint64(4))) & np.uint64(0x030C30C3)
    return (x | (x << np.uint64(2))) & np.uint64(0x09249249)


@kernel
def curve_keys(points, keys):
    """Write the index along a Morton curve, times 2^32, plus the point index, to ``keys (n,)``.

    The curve has 2^16 (2-D) or 2^10 (3-D) steps along each axis.
    """
    n, d = points.shape
    low, extent, steps = np.empty(d), 0.0, 2.0**16 - 1.0 if d == 2 else 2.0**10 - 1.0
    # 1. Bounding cube: the scale of the longest side for all axes.
    for c in range(d):
        least, most = np.inf, -np.inf
        for i in range(n):
            least, most = min(least, points[i, c]), max(most, points[i, c])
        low[c], extent = least, max(extent, most - least)
    rate = steps / (extent if extent > 0.0 else 1.0)
    # 2. Steps along each axis with interleaved bits. Point numbers make the keys distinct.
    for i in range(n):
        key = np.uint64(0)
        for c in range(d):
            step = np.uint64((points[i, c] - low[c]) * rate)
            key |= (_spread_by_one(step) if d == 2 else _spread_by_two(step)) << np.uint64(c)
        keys[i] = key << np.uint64(32) | np.uint64(i)
