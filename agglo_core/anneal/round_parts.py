"""Round parts of even width, found by annealing: the best that a given effort allows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agglo_core.anneal.annealed_parts import ROUNDING, Weights
from agglo_core.anneal.round_search import EFFORTS, Search
from agglo_core.anneal.start_parts import Rival, Start, connected_parts
from agglo_core.arrays import Int
from agglo_core.graph import Graph
from agglo_core.progress import TimeLimit
from agglo_core.protocols import Target

_FILLED = {2: (0.40, 0.44), 3: (0.12, 0.14)}
"""Measure of a part over its size to the power of the dimension: parts of few cells, and of many."""

_COUNTED = {2: (0.38, 0.42), 3: (0.12, 0.14)}
"""The same where the number of parts is given and the size follows; others are tried, by a factor."""

_FACTOR = 1.06
_WEIGHTS = {
    "size": (Weights(1.0, 1.05, 0.35), Weights(0.69, 1.0, 0.3)),
    "count": (Weights(1.12, 1.05, 0.35), Weights(0.85, 1.0, 0.3)),
}
"""Of parts of few cells, and of many, which fill a size with ease."""

_MANY = 100
_PIECES = 40
"""Parts of more cells than the one are found on a graph of so many pieces for each as the other."""


def round_parts(
    graph: Graph, target: Target, seed: int, effort: str, start: Start, rival: Rival, limit: TimeLimit
) -> Int:
    """Labels of a connected graph: round parts, as even as may be, or the rival's if they score higher.

    With a size the number of parts is free and its count is not used; with a count there are so many.
    """
    size, parts = _size_and_parts(graph, target, False)
    many = graph.n > _MANY * parts
    weights = _WEIGHTS["count" if target.h_star is None else "size"][many]
    search = Search(graph, size, seed, EFFORTS[effort], weights, limit)
    if many:
        labels = _from_pieces(search, graph, target, seed, effort, start, rival)
    else:
        labels = _searched(search, graph, target, parts, start, rival)
    other = search.tool.inward(rival(graph, target))
    scores = [search.tool.shapes(each).score(Weights()) for each in (labels, other)]
    return search.tool.outward(labels if scores[0] >= scores[1] else other)


def _searched(search: Search, graph: Graph, target: Target, parts: int, start: Start, rival: Rival) -> Int:
    """Labels, in the order of the search, from those of the start."""
    first = connected_parts(graph, start(graph, parts))
    if target.h_star is not None:
        labels, shapes = search.thinned(*search.fitted(search.tool.inward(first)))
        return search.polished(labels, shapes)[0]
    return _counted(
        search, search.tool.inward(first if int(first.max()) + 1 == parts else rival(graph, target))
    )


def _counted(search: Search, first: Int) -> Int:
    """The best labels of several sizes with as many parts as at first; the search keeps that size.

    The next size is larger where parts were wider, else smaller. None is below the widest cell.
    """
    factor, widest = _FACTOR, float(search.tool.widths.max())
    best, result, chosen, before = -np.inf, first, search.size, 0
    for turn in range(search.sizes):
        if turn and search.limit.over():
            break
        search.size = max(search.size, widest)
        labels, shapes = search.polished(*search.annealed(first), cut=False)
        score = shapes.score(Weights())
        if score > best:
            best, result, chosen = score, labels, search.size
        towards = 1 if shapes.widths.max() > search.size * (1 + ROUNDING) else -1
        factor = factor if towards * before >= 0 else factor**0.5
        search.size *= factor**towards
        before = towards
    search.size = chosen
    return result


def _from_pieces(
    search: Search, graph: Graph, target: Target, seed: int, effort: str, start: Start, rival: Rival
) -> Int:
    """Labels, in the order of the search, from parts of a graph of pieces, of which there are fewer."""
    size, parts = _size_and_parts(graph, target, True)
    pieces = connected_parts(graph, start(graph, _PIECES * parts))
    coarse = graph.coarsen(pieces)
    less = replace(EFFORTS[effort], tries=EFFORTS[effort].tries // 2)  # pieces have many corners
    above = Search(coarse, size, seed, less, search.weights, search.limit)
    found = above.tool.outward(_searched(above, coarse, target, parts, start, rival))
    search.size = above.size
    labels, shapes = search.cooled(search.tool.inward(found[pieces]))
    return search.polished(labels, shapes, cut=target.h_star is not None)[0]


def _size_and_parts(graph: Graph, target: Target, many: bool) -> tuple[float, int]:
    """The size of the parts and their number at first: one follows from the other."""
    whole, d = float(graph.measures.sum()), graph.dim
    if target.h_star is not None:
        count = whole / (_FILLED[d][many] * float(target.h_star) ** d)
        return float(target.h_star), int(np.clip(np.ceil(count), 1, graph.n))
    parts = int(target.parts or 1)
    return float((whole / (_COUNTED[d][many] * parts)) ** (1.0 / d)), parts
