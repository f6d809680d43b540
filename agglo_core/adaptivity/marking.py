"""Choice of the parts to divide and to join, by their indicators."""

from __future__ import annotations

from typing import Final

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.hierarchy.cuts import Cut

_JOINED: Final = 0.01
"""Siblings are joined if their squared indicators sum to less than this share of the smallest one that is
marked. A larger value may join parts that later steps divide again."""


def largest_share(squares: Float, share: float) -> Int:
    """Return the fewest parts that hold a share of the sum of ``squares (n_parts,)``, the largest first.

    W. Dörfler, SIAM J. Numer. Anal. 33, 1996.
    """
    order = np.argsort(-squares, kind="stable")
    sums = np.cumsum(squares[order])
    return frozen_int(order[: int(np.searchsorted(sums, share * sums[-1])) + 1])


def next_cut(cut: Cut, squares: Float, share: float, goal: float = 0.0, most: float = np.inf) -> Cut | None:
    """Return the cut whose marked parts are divided, or None if it cannot be refined further.

    The marked parts hold a share of the squared indicators of all parts of several cells. Fewer are divided
    if the new cut would have more than ``most`` parts. Siblings with small indicators are joined. None also
    if single cells hold that share of the whole sum, and more than ``goal``.
    """
    forest = cut.forest
    single = forest.n_children[cut.nodes] == 0
    irreducible = float(squares[single].sum())
    divisible = np.where(single, 0.0, squares)
    if not divisible.any() or irreducible > max(goal, share * squares.sum()):
        return None
    marked = largest_share(frozen_float(divisible), share)
    # Join siblings that hardly count
    parents, n_nodes = forest.parent[cut.nodes], len(forest.parent)
    sums = np.bincount(parents[parents >= 0], squares[parents >= 0], n_nodes)
    small = (parents >= 0) & (sums[parents] < _JOINED * squares[marked[-1]])
    base = cut.coarsen(small).cut if small.any() else cut
    # Divide as many as fit, the largest first
    while len(marked):
        refined = base.refine(np.isin(base.nodes, cut.nodes[marked])).cut
        if refined.n_parts <= most:
            return refined
        marked = marked[: len(marked) // 2]
    return None
