"""Mass shares of the two sides of a split."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.graph.dual import Graph

_MANY = 16
"""Quota, in parts, from which equal halves suffice: with one part more or less on a side, parts differ by at
most 1/8.

A larger value makes parts more equal, but more cuts are shifted (benchmarks/interfaces.py, row kmeans).
"""


def side_shares(parts: int) -> Float:
    """Return the lighter side's mass share in a split into q parts, indexed by q ``(17,)``.

    The share is below 1/2 for small odd q, where equal halves would lead to parts with very different sizes.
    Larger q count as 16. All shares are 1/2 if the level's number of ``parts`` is 0 (a size goal) or a power
    of two, which equal halves reach.
    """
    shares = np.full(_MANY + 1, 0.5)
    if parts & (parts - 1):
        odd = np.arange(3, _MANY, 2)
        shares[odd] = (odd // 2) / odd
    return frozen_float(shares)


def shift_cuts(level: Graph, sides: Int, blocks: Int, shares: Float | None) -> Int:
    """Move the cuts of some blocks until the lighter side has its mass share.

    Returns the sides ``(n,)``. The new cuts are straight, across the line between the centroids of both
    sides. Cuts within 5 % of the share stay.

    Parameters
    ----------
    level : Graph
    sides : (n,) int
    blocks : (b,) int
        Blocks whose cuts are moved.
    shares : (B,) float, optional
        Below 1/2 for these blocks.
    """
    from agglo_core.split.piece_shares import shift_sides

    if shares is None or len(blocks) == 0:
        return sides
    nodes = np.flatnonzero(np.isin(level.block_ids, blocks))
    part, result = level.take(blocks), sides.copy()
    result[nodes] = shift_sides(part.offsets, part.centroids, part.mass, sides[nodes], shares[blocks])
    return frozen_int(result)
