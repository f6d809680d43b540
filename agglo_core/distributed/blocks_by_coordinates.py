"""Blocks of cells by their coordinates, whatever the ranks they lie on: the top of a tree that all share."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.distributed.communication import Ranks

__all__ = ["coordinate_blocks"]

_HALVINGS = 60
"""Of an interval of numbers: what is left has about the width of a rounding error."""


def coordinate_blocks(ranks: Ranks, points: Float, depth: int) -> Int:
    """Block ``(n,)`` of each point of this rank, one of ``2**depth``, by recursive halving.

    Each block is cut across the longest side of its box, at the coordinate that leaves the halves as equal in
    number as it can: points of the same coordinate stay together. Blocks with the same leading digits are
    near one another. Some stay empty where points coincide.

    Parameters
    ----------
    ranks : Ranks
    points : (n, d) float
        Those of this rank; the result depends on all, not on where they lie.
    depth : int
        Number of cuts from all points to a block.
    """
    block = np.zeros(len(points), np.int64)
    for level in range(depth):
        axis, low, high = _longest_sides(ranks, points, block, 1 << level)
        along = np.take_along_axis(points, axis[block][:, None], axis=1)[:, 0]
        cut = _medians(ranks, along, block, low, high)
        block = 2 * block + (along > cut[block])
    return frozen_int(block)


def _longest_sides(ranks: Ranks, points: Float, block: Int, count: int) -> tuple[Int, Float, Float]:
    """Axis of the longest side of the box of each block, and where it begins and ends."""
    low = np.full((count, points.shape[1]), np.inf)
    high = -low
    np.minimum.at(low, block, points)
    np.maximum.at(high, block, points)
    low, high = ranks.reduced(low, "min"), ranks.reduced(high, "max")
    full = low[:, 0] <= high[:, 0]
    low, high = np.where(full[:, None], low, 0.0), np.where(full[:, None], high, 0.0)
    axis = np.argmax(high - low, axis=1)
    every = np.arange(count)
    return frozen_int(axis), low[every, axis], high[every, axis]


def _medians(ranks: Ranks, along: Float, block: Int, low: Float, high: Float) -> Float:
    """Coordinate of each block at or below which as near to half of its points lie as can be."""
    order = np.lexsort((along, block))
    values, start = along[order], np.searchsorted(block[order], np.arange(len(low) + 1))

    present = np.flatnonzero(np.diff(start))

    def below(cut: Float) -> Int:
        own = np.zeros(len(cut), np.int64)
        for b in present.tolist():
            own[b] = np.searchsorted(values[start[b] : start[b + 1]], cut[b], side="right")
        return ranks.reduced(own, "sum")

    half = 0.5 * below(high)
    low = low - (high - low)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        enough = below(middle) >= half
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    nearer = half - below(low) <= below(high) - half
    return np.where(nearer & (below(low) > 0), low, high)
