"""Parts of blocks in a geometric order."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import helper, kernel
from agglo_core.kernels.interface import sort_by_key

__all__ = ["ordered_parts"]

_FLAT = 1e-6
"""A third moment below this share of its bound is rounding."""


@helper
def _block_axes(owner, count, centroids, weights):
    """Third moment of each block about its centre ``(count, d)``; a fixed direction where it vanishes.

    It turns with the block, and is not zero unless there is symmetry.
    """
    n, d = centroids.shape
    mass, spread = np.zeros(count), np.zeros(count)
    centres, axes = np.zeros((count, d)), np.zeros((count, d))
    extent = 0.0
    for i in range(n):
        b, w = owner[i], weights[i]
        mass[b] += w
        for k in range(d):
            centres[b, k] += w * centroids[i, k]
            extent = max(extent, abs(centroids[i, k] - centroids[0, k]))
    unit = 1.0 / extent if extent > 1e-300 else 1.0  # cubes of any unit are finite
    for b in range(count):
        for k in range(d):
            centres[b, k] = centres[b, k] / mass[b] if mass[b] > 0.0 else 0.0
    for i in range(n):
        b, square = owner[i], 0.0
        for k in range(d):
            square += (unit * (centroids[i, k] - centres[b, k])) ** 2
        square *= weights[i]
        spread[b] += square
        for k in range(d):
            axes[b, k] += square * (unit * (centroids[i, k] - centres[b, k]))
    for b in range(count):
        length, bound = 0.0, spread[b] * np.sqrt(spread[b] / mass[b]) if mass[b] > 0.0 else 0.0
        for k in range(d):
            length += axes[b, k] ** 2
        if not np.sqrt(length) > _FLAT * bound:
            for k in range(d):
                axes[b, k] = 1.0 / (1.0 + np.sqrt(2.0) * k)
    return axes


@kernel
def ordered_parts(labels, block, count, centroids, weights, measures):
    """Parts by block, and in each of the ``count`` blocks by where they are along an axis of it.

    Returns the new numbers of the parts of all cells ``(n,)``; the old ones in their order ``(k,)``; where
    the parts of each block start ``(count + 1,)``; the axes of the blocks ``(count, d)``; and for each cell,
    close together in memory, its weight, measure and centroid ``(n, 2 + d)``.
    """
    n, k, d = len(labels), len(block), centroids.shape[1]
    owner = np.zeros(n, np.int32)
    for i in range(n if count > 1 else 0):
        owner[i] = block[labels[i]]
    axes = _block_axes(owner, count, centroids, weights)
    shapes, keys, cells = np.empty((n, 2 + d)), np.zeros(k), np.zeros(k)
    for i in range(n):
        place = 0.0
        for a in range(d):
            place += axes[owner[i], a] * centroids[i, a]
            shapes[i, 2 + a] = centroids[i, a]
        shapes[i, 0], shapes[i, 1] = weights[i], measures[i]
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
