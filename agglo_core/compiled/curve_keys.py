"""Compute sort keys of points along a Hilbert curve."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel

_ZERO, _SIX, _LOW_SIX = np.uint64(0), np.uint64(6), np.uint64(63)
_OFFSET = 1.0 / np.pi
"""Shift of the points, in steps of the curve.

Structured meshes have centroids on the faces of the curve's cubes. An irrational shift keeps them off, so
that rounding does not decide between two cubes.
"""


@helper
def _spread_by_one(x):
    """Spread the 32 low bits of x to every second bit, to interleave two coordinates."""
    x = (x | (x << np.uint64(16))) & np.uint64(0x0000FFFF0000FFFF)
    x = (x | (x << np.uint64(8))) & np.uint64(0x00FF00FF00FF00FF)
    x = (x | (x << np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    x = (x | (x << np.uint64(2))) & np.uint64(0x3333333333333333)
    return (x | (x << ONE)) & np.uint64(0x5555555555555555)


@helper
def _spread_by_two(x):
    """Spread the 21 low bits of x to every third bit, to interleave three coordinates."""
    x = (x | (x << np.uint64(32))) & np.uint64(0x001F00000000FFFF)
    x = (x | (x << np.uint64(16))) & np.uint64(0x001F0000FF0000FF)
    x = (x | (x << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    x = (x | (x << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    return (x | (x << np.uint64(2))) & np.uint64(0x1249249249249249)


@helper
def _project(point, axes, a):
    """Return the coordinate of a point along the axis a."""
    result = axes[a, 0] * point[0] + axes[a, 1] * point[1]
    return result + axes[a, 2] * point[2] if len(point) > 2 else result


@kernel
def curve_keys(points, axes, bits, table, keys):
    """Write the index along a Hilbert curve, followed by the point number, to ``keys (n,)``.

    The curve has 2^bits steps along each of the ``axes (d, d)``. The point number takes the remaining
    64 − d · bits bits. The ``table`` converts six bits at a time from a Morton to the Hilbert curve: see
    ``hilbert_table`` in ``graph/ordering.py``.
    """
    n, d = points.shape
    low, extent = np.empty(d), 0.0
    # 1. Bounding cube: the scale of the longest side for all axes.
    for a in range(d):
        least, most = np.inf, -np.inf
        for i in range(n):
            x = _project(points[i], axes, a)
            least, most = min(least, x), max(most, x)
        low[a], extent = least, max(extent, most - least)
    rate = (2.0**bits - 1.0) / (extent if extent > 0.0 else 1.0)
    # 2. Steps along each axis with interleaved bits.
    spare = np.uint64(64 - d * bits)
    for i in range(n):
        x = np.uint64((_project(points[i], axes, 0) - low[0]) * rate + _OFFSET)
        y = np.uint64((_project(points[i], axes, 1) - low[1]) * rate + _OFFSET)
        if d == 2:
            morton = (_spread_by_one(x) << ONE) | _spread_by_one(y)
        else:
            z = np.uint64((_project(points[i], axes, 2) - low[2]) * rate + _OFFSET)
            morton = (_spread_by_two(x) << np.uint64(2)) | (_spread_by_two(y) << ONE) | _spread_by_two(z)
        # 3. Convert to the Hilbert curve, from the largest cubes to the smallest. Point numbers make the keys
        #    distinct.
        key, state, place = _ZERO, _ZERO, np.uint64(d * bits)
        while place > _ZERO:
            place -= _SIX
            entry = np.uint64(table[state, morton >> place & _LOW_SIX])
            key, state = key << _SIX | (entry & _LOW_SIX), entry >> _SIX
        keys[i] = key << spare | np.uint64(i)
