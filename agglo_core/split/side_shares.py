"""Shares of the mass of a piece that the sides of its split are to hold."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.graph.dual import Graph

_MANY = 16
"""Quota from which halves serve: with one part more or less on a side, parts differ by 1/8 at most."""


def side_shares(parts: int) -> Float:
    """Share of the mass for the lighter side of a piece that is to become q parts, by q, ``(17,)``.

    It is below 1/2 for small odd q, which halves would leave with parts of very different size; larger q
    count as 16. All shares are 1/2 if the number of ``parts`` of the whole level is 0 (for a size) or a
    power of two, which halves alone lead to.
    """
    shares = np.full(_MANY + 1, 0.5)
    if parts & (parts - 1):
        odd = np.arange(3, _MANY, 2)
        shares[odd] = (odd // 2) / odd
    return frozen_float(shares)


def shifted(level: Graph, sides: Int, blocks: Int, shares: Float | None) -> Int:
    """Sides ``(n,)`` once the cuts of some blocks are moved until the lighter side holds a share of the mass.

    The new cuts are straight, across the line between the centroids of both sides. Cuts within 5 % of the
    share stay.

    Parameters
    ----------
    level : Graph
    sides : (n,) int
    blocks : (b,) int
        Blocks whose cuts are moved.
    shares : (B,) float, optional
        Below 1/2 for these blocks.
    """
    from agglo_core.split.piece_shares import shifted_sides

    if shares is None or len(blocks) == 0:
        return sides
    nodes = np.flatnonzero(np.isin(level.block_ids, blocks))
    part, result = level.take(blocks), sides.copy()
    result[nodes] = shifted_sides(part.offsets, part.centroids, part.mass, sides[nodes], shares[blocks])
    return frozen_int(result)
