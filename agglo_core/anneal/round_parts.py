"""Parts that are round and of even width, found by annealing at a given effort."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agglo_core.anneal.annealed_parts import ROUNDING, Weights
from agglo_core.anneal.round_search import EFFORTS, Search
from agglo_core.anneal.start_parts import Rival, Start, connect_parts
from agglo_core.arrays import Int
from agglo_core.graph import Graph
from agglo_core.progress import TimeLimit
from agglo_core.protocols import Target

_FILLED = {2: (0.40, 0.44), 3: (0.12, 0.14)}
"""Part measure over size to the power of the dimension, by dimension: for parts with few cells, and with
many.

From it follows the initial number of parts for a size: a larger value starts with fewer parts, more of which
are then too wide and cut (benchmarks/roundness.py, in 3-D benchmarks/round_solids.py).
"""

_COUNTED = {2: (0.38, 0.42), 3: (0.12, 0.14)}
"""Ratios for a given number of parts, which determines the size. Other sizes are tried by a factor
(benchmarks/roundness.py, in 3-D benchmarks/round_solids.py)."""

_FACTOR = 1.06  # ratio of successive sizes tried for a count: larger explores more (benchmarks/roundness.py)
_WEIGHTS = {
    "size": (Weights(1.0, 1.05, 0.35), Weights(0.69, 1.0, 0.3)),
    "count": (Weights(1.12, 1.05, 0.35), Weights(0.85, 1.0, 0.3)),
}
"""Weights for parts with few cells, and with many cells, which fill a size easily.

More evenness costs round shapes (benchmarks/roundness.py).
"""

_MANY = 100
"""Mean number of cells per part above which parts are found on a graph of pieces first, which is faster but
leaves parts less round (benchmarks/roundness.py, brain with 40 parts)."""

_PIECES = 40
"""Pieces per part in this graph: more pieces allow rounder parts, and take longer (benchmarks/roundness.py,
brain with 40 parts)."""


def round_parts(
    graph: Graph, target: Target, seed: int, effort: str, start: Start, rival: Rival, limit: TimeLimit
) -> Int:
    """Partition a connected graph into round, even parts, or as ``rival`` does if that scores higher.

    With a size the part count is free, and the target's count is ignored. With a count the number of
    parts is exact.
    """
    # 1. Set up the search. Parts with few and with many cells have different weights.
    size, parts = _size_and_parts(graph, target, False)
    large_parts = graph.n > _MANY * parts
    weights = _WEIGHTS["count" if target.h_star is None else "size"][large_parts]
    search = Search(graph, size, seed, EFFORTS[effort], weights, limit)
    # 2. Search from a start, on a graph of pieces if parts have many cells.
    if large_parts:
        labels = _from_pieces(search, graph, target, seed, effort, start, rival)
    else:
        labels = _search_parts(search, graph, target, parts, start, rival)
    # 3. Compare with the rival.
    rival_labels = search.tool.inward(rival(graph, target))
    scores = [search.tool.shapes(candidate).score(Weights()) for candidate in (labels, rival_labels)]
    return search.tool.outward(labels if scores[0] >= scores[1] else rival_labels)


def _search_parts(
    search: Search, graph: Graph, target: Target, parts: int, start: Start, rival: Rival
) -> Int:
    """Search from the partition that ``start`` returns, and return the labels in curve order."""
    first = connect_parts(graph, start(graph, parts))
    if target.h_star is not None:
        labels, shapes = search.thinned(*search.fitted(search.tool.inward(first)))
        return search.polished(labels, shapes)[0]
    return _search_sizes(
        search, search.tool.inward(first if int(first.max()) + 1 == parts else rival(graph, target))
    )


def _search_sizes(search: Search, first: Int) -> Int:
    """Search with several part sizes at a fixed part count, and return the best labels.

    The next size is larger if parts were too wide, otherwise smaller, and at least the width of the widest
    cell. The search keeps the best size.
    """
    factor, widest = _FACTOR, float(search.tool.widths.max())
    best, result, best_size, before = -np.inf, first, search.size, 0
    for turn in range(search.sizes):
        if turn and search.limit.over():
            break
        search.size = max(search.size, widest)
        # 1. Anneal at this size, and keep the best labels.
        labels, shapes = search.polished(*search.annealed(first), cut=False)
        score = shapes.score(Weights())
        if score > best:
            best, result, best_size = score, labels, search.size
        # 2. Change the size, by a smaller factor after a change of direction.
        direction = 1 if shapes.widths.max() > search.size * (1 + ROUNDING) else -1
        factor = factor if direction * before >= 0 else factor**0.5
        search.size *= factor**direction
        before = direction
    search.size = best_size
    return result


def _from_pieces(
    search: Search, graph: Graph, target: Target, seed: int, effort: str, start: Start, rival: Rival
) -> Int:
    """Search on a coarser graph of pieces first, then on the cells, and return the labels in curve order."""
    size, parts = _size_and_parts(graph, target, True)
    # 1. Graph of pieces.
    pieces = connect_parts(graph, start(graph, _PIECES * parts))
    coarse = graph.coarsen(pieces)
    # 2. Search on this graph.
    settings = replace(EFFORTS[effort], tries=EFFORTS[effort].tries // 2)  # pieces have many corners
    coarse_search = Search(coarse, size, seed, settings, search.weights, search.limit)
    coarse_labels = coarse_search.tool.outward(
        _search_parts(coarse_search, coarse, target, parts, start, rival)
    )
    # 3. Cool and polish on the cells.
    search.size = coarse_search.size
    labels, shapes = search.cooled(search.tool.inward(coarse_labels[pieces]))
    return search.polished(labels, shapes, cut=target.h_star is not None)[0]


def _size_and_parts(graph: Graph, target: Target, large_parts: bool) -> tuple[float, int]:
    """Return the part size and the initial part count, one computed from the other."""
    whole, d = float(graph.measures.sum()), graph.dim
    if target.h_star is not None:
        count = whole / (_FILLED[d][large_parts] * float(target.h_star) ** d)
        return float(target.h_star), int(np.clip(np.ceil(count), 1, graph.n))
    parts = int(target.parts or 1)
    return float((whole / (_COUNTED[d][large_parts] * parts)) ** (1.0 / d)), parts
