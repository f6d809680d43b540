"""Compute and sort keys of points along a Hilbert curve."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel
from agglo_core.compiled.sorting import sort_by_keys

_ZERO, _SIX, _LOW_SIX = np.uint64(0), np.uint64(6), np.uint64(63)
_OFFSET = 1.0 / np.pi
"""Shift of the points, in steps of the curve.

Structured meshes have centroids on the faces of the curve's cubes. An irrational shift keeps them off, so
that rounding does not decide between two cubes.
"""


_CROWDED = 64.0
"""Mean number of keys in the bucket of a key above which insertion sort takes longer than numpy's sort."""


@helper
def _project(point, axes, a):
    """Return the coordinate of a point along the axis a."""
    result = axes[a, 0] * point[0] + axes[a, 1] * point[1]
    return result + axes[a, 2] * point[2] if len(point) > 2 else result


@kernel
def bounding_cube(points, axes):
    """Return the lower corner ``(d,)`` of the bounding box along the axes, and its longest side."""
    d, extent = points.shape[1], 0.0
    low = np.empty(d)
    for a in range(d):
        least, most = np.inf, -np.inf
        for i in range(len(points)):
            x = _project(points[i], axes, a)
            least, most = min(least, x), max(most, x)
        low[a], extent = least, max(extent, most - least)
    return low, extent


@kernel
def curve_keys(points, start, axes, low, extent, bits, table, keys):
    """Write the index along a Hilbert curve, followed by the point number, to ``keys (m,)``.

    These are the keys of m points from number ``start``. The curve has 2^bits steps along each of the ``axes
    (d, d)`` of the cube from :func:`bounding_cube`. The point number takes the remaining 64 − d · bits bits.
    The ``table`` converts the steps by six bits at a time: see ``hilbert_table`` in ``graph/ordering.py``.
    """
    d, rate = points.shape[1], (2.0**bits - 1.0) / (extent if extent > 0.0 else 1.0)
    # 1. Steps along each axis.
    spare, width = np.uint64(64 - d * bits), np.uint64(6 // d)
    digit = (ONE << width) - ONE
    for i in range(np.uint64(start), np.uint64(start + len(keys))):
        x = np.uint64((_project(points[i], axes, 0) - low[0]) * rate + _OFFSET)
        y = np.uint64((_project(points[i], axes, 1) - low[1]) * rate + _OFFSET)
        z = np.uint64((_project(points[i], axes, 2) - low[2]) * rate + _OFFSET) if d > 2 else _ZERO
        # 2. Convert to the Hilbert curve, from the largest cubes to the smallest. Point numbers make the keys
        #    distinct.
        key, state, place = _ZERO, _ZERO, np.uint64(bits)
        while place > _ZERO:
            place -= width
            cube = (x >> place & digit) << width | (y >> place & digit)
            cube = cube << width | (z >> place & digit) if d > 2 else cube
            entry = np.uint64(table[state, cube])
            key, state = key << _SIX | (entry & _LOW_SIX), entry >> _SIX
        keys[i - np.uint64(start)] = key << spare | i


@kernel
def sort_keys(keys, first, result):
    """Write the sorted ``keys (n,)`` to ``result``, or return False if many have the same leading bits.

    ``first`` is workspace: its length, a power of two, is the number of buckets.
    """
    # 1. Bucket sort by the leading bits.
    shift, total, pairs = np.uint64(64), np.int64(0), 0.0
    while ONE << (np.uint64(64) - shift) < len(first):
        shift -= ONE
    for b in range(len(first)):
        first[b] = 0
    for i in range(len(keys)):
        first[keys[i] >> shift] += 1
    for b in range(len(first)):
        size, first[b] = np.int64(first[b]), total
        total, pairs = total + size, pairs + np.float64(size) * np.float64(size)
    if pairs > _CROWDED * len(keys):
        return False
    for i in range(len(keys)):
        b = keys[i] >> shift
        result[np.uint32(first[b])] = keys[i]
        first[b] += 1
    # 2. Insertion sort within the buckets.
    for i in range(1, len(result)):
        key, place = result[i], i
        while place > 0 and result[place - 1] > key:
            result[place] = result[place - 1]
            place -= 1
        result[place] = key
    return True


@kernel
def sort_ties(keys, spare, points, axis):
    """Sort points in the same step of the curve along the ``axis (1, d)``, in the sorted ``keys (n,)``."""
    i, n, places = ONE, np.uint64(len(keys)), np.empty(16)
    while i < n:
        start = i - ONE
        while i < n and (keys[i] ^ keys[start]) >> spare == _ZERO:
            i += ONE
        m = np.int64(i - start)
        if m > 1:
            if m > len(places):
                places = np.empty(2 * m)
            for k in range(m):
                point = keys[start + np.uint64(k)] & ((ONE << spare) - ONE)
                places[k] = _project(points[point], axis, 0)
            sort_by_keys(keys[start:i], places, m)
        i += ONE
