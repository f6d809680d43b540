"""Choice of the parts to divide and to join, by their indicators."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.hierarchy.cuts import Cut
from agglo_core.hierarchy.forest import Forest

_DEEPEST: Final = 3
"""Largest number of levels that a part is divided by at once."""
_MARGIN: Final = 0.8
"""Share of the squared goal that the last step aims at, since predictions are sometimes too small."""
_FEW: Final = 0.02
"""Share of the parts that at least is divided where ``most`` bounds the number: fewer save no error."""
_JOINED: Final = 0.01
"""Siblings are joined if their squared indicators sum to less than this share of the smallest one that is
marked. A larger value may join parts that later steps divide again."""


def divisions(squares: Float, ratio: float, target: float) -> tuple[Int, Float]:
    """Return the divisions to make, each as the number of its part, and the indicators divided.

    A division into ``ratio`` parts is predicted to divide the sum of the squared indicators by ``ratio``,
    as for linear functions in 2-D. Always the largest indicator, given or predicted, is divided, until the
    predicted sum is ``target`` (W. Dörfler, SIAM J. Numer. Anal. 33, 1996, for one level).
    """
    depth = np.arange(_DEEPEST)[:, None]
    largest = (squares / ratio ** (2.0 * depth)).ravel()
    order = np.argsort(-largest, kind="stable")[: int((largest > 0.0).sum())]
    gains = ((1.0 - 1.0 / ratio) * squares / ratio**depth).ravel()[order]
    count = int(np.searchsorted(np.cumsum(gains), squares.sum() - target)) + 1
    return frozen_int(order[:count] % len(squares)), frozen_float(largest[order[:count]])


def next_cut(cut: Cut, squares: Float, share: float, goal: float = 0.0, most: float = np.inf) -> Cut | None:
    """Return a finer cut where the indicators are large, or None if there is none.

    The predicted sum of ``squares`` falls by ``share``, or to ``goal`` if that is larger. Fewer parts are
    divided if the new cut would have more than ``most`` parts. Siblings with small indicators are joined.
    None if no part can be divided, or if single cells hold over half of the sum, and more than ``goal``.
    """
    forest = cut.forest
    single = forest.n_children[cut.nodes] == 0
    total, irreducible = float(squares.sum()), float(squares[single].sum())
    divisible = np.where(single, 0.0, squares)
    if not divisible.any() or irreducible > max(goal, 0.5 * total):
        return None
    inner = forest.n_children[forest.n_children > 0]
    target = max((1.0 - share) * total, _MARGIN * goal) - irreducible
    parts, largest = divisions(frozen_float(divisible), float(inner.mean()), target)
    # Join siblings that hardly count
    joined = _joined(cut, squares, _JOINED * float(largest[-1]))
    # Divide as many as fit, the largest first
    while len(parts):
        depth = np.zeros(len(forest.parent), np.int64)
        depth[cut.nodes] = np.bincount(parts, minlength=cut.n_parts)
        nodes = _divided(forest, joined, depth)
        if len(nodes) <= cut.n_parts:  # at least one part more, so that all steps end
            nodes = _divided(forest, cut.nodes, depth)
        if len(nodes) <= most:
            return replace(cut, nodes=nodes)
        parts = parts[: len(parts) * 3 // 4]
        if len(parts) < _FEW * cut.n_parts:
            break
    return None


def _joined(cut: Cut, squares: Float, least: float) -> Int:
    """Return the nodes of a cut after siblings are joined whose ``squares`` sum to less than ``least``."""
    forest, parents = cut.forest, cut.forest.parent[cut.nodes]
    has_parent, n_nodes = parents >= 0, len(forest.parent)
    count = np.bincount(parents[has_parent], minlength=n_nodes)
    sums = np.bincount(parents[has_parent], squares[has_parent], n_nodes)
    unions = np.flatnonzero((count > 0) & (count == forest.n_children) & (sums < least))
    return frozen_int(np.append(cut.nodes[~np.isin(parents, unions)], unions))


def _divided(forest: Forest, nodes: Int, depth: Int) -> Int:
    """Return the nodes after each of ``nodes`` is divided ``depth (n_nodes,)`` times."""
    left, is_node = np.array(depth), np.zeros(len(depth), bool)
    is_node[nodes] = True
    for _ in range(_DEEPEST):
        split = is_node & (left > 0) & (forest.n_children > 0)
        children = np.flatnonzero((forest.parent >= 0) & split[forest.parent])
        is_node[split], is_node[children] = False, True
        left[children] = left[forest.parent[children]] - 1
    return frozen_int(np.flatnonzero(is_node))
