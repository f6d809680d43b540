"""Parts of blocks in a geometric order."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import helper, kernel
from agglo_core.kernels.interface import sort_by_key

__all__ = ["ordered_parts"]

_FLAT = 1e-6
"""A third moment below this share of its bound is rounding."""


@helper(allocates=True)
def _block_axes(owner, count, shapes):
    """Third moment of each block about its centre ``(count, 3)``; a fixed direction where it vanishes.

    It turns with the block, and is not zero unless there is symmetry.
    """
    n = len(shapes)
    mass, spread = np.zeros(count), np.zeros(count)
    centres, axes = np.zeros((count, 3)), np.zeros((count, 3))
    extent = 0.0
    for i in range(n):
        b, w = owner[i], shapes[i, 0]
        mass[b] += w
        for k in range(3):
            centres[b, k] += w * shapes[i, 2 + k]
            extent = max(extent, abs(shapes[i, 2 + k] - shapes[0, 2 + k]))
    unit = 1.0 / extent if extent > 1e-300 else 1.0  # cubes of any unit are finite
    for b in range(count):
        for k in range(3):
            centres[b, k] = centres[b, k] / mass[b] if mass[b] > 0.0 else 0.0
    for i in range(n):
        b, square = owner[i], 0.0
        for k in range(3):
            square += (unit * (shapes[i, 2 + k] - centres[b, k])) ** 2
        square *= shapes[i, 0]
        spread[b] += square
        for k in range(3):
            axes[b, k] += square * (unit * (shapes[i, 2 + k] - centres[b, k]))
    for b in range(count):
        length, bound = 0.0, spread[b] * np.sqrt(spread[b] / mass[b]) if mass[b] > 0.0 else 0.0
        for k in range(3):
            length += axes[b, k] ** 2
        if not np.sqrt(length) > _FLAT * bound:
            for k in range(3):
                axes[b, k] = 1.0 / (1.0 + np.sqrt(2.0) * k)
    return axes


@kernel
def ordered_parts(labels, block, count, centroids, weights, measures):
    """Parts by block, and in each of the ``count`` blocks by where they are along an axis of it.

    Returns the new numbers of the parts of all cells ``(n,)``; the old ones in their order ``(k,)``; where
    the parts of each block start ``(count + 1,)``; the axes of the blocks ``(count, 3)``; and for each cell,
    close together in memory, its weight, measure and centroid ``(n, 5)``. In the plane the third coordinate
    is 0: loops of a length that the compiler knows take half the time.
    """
    n, k, d = len(labels), len(block), centroids.shape[1]
    owner, shapes = np.zeros(n, np.int32), np.empty((n, 5))
    for i in range(n if count > 1 else 0):
        owner[i] = block[labels[i]]
    for i in range(n):
        shapes[i, 0], shapes[i, 1] = weights[i], measures[i]
        shapes[i, 2], shapes[i, 3] = centroids[i, 0], centroids[i, 1]
        shapes[i, 4] = centroids[i, 2] if d > 2 else 0.0
    axes = _block_axes(owner, count, shapes)
    keys, cells = np.zeros(k), np.zeros(k)
    for i in range(n):
        b, place = owner[i], 0.0
        for a in range(3):
            place += axes[b, a] * shapes[i, 2 + a]
        keys[labels[i]] += place
        cells[labels[i]] += 1.0
    starts, order, rank = np.zeros(count + 1, np.int64), np.empty(k, np.int64), np.empty(k, np.int32)
    for p in range(k):
        keys[p] /= cells[p]
        starts[block[p] + 1] += 1
    for b in range(count):
        starts[b + 1] += starts[b]
    filled = starts.copy()
    for p in range(k):
        order[filled[block[p]]] = p
        filled[block[p]] += 1
    for b in range(count):
        sort_by_key(order[starts[b] : starts[b + 1]], keys, starts[b + 1] - starts[b])
    for r in range(k):
        rank[order[r]] = r
    parts = np.empty(n, np.int32)
    for i in range(n):
        parts[i] = rank[labels[i]]
    return parts, order, starts, axes, shapes
