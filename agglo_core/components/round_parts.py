"""Round parts of even width, found by annealing: the best that a given effort allows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from agglo_core.arrays import Int, frozen_int, splitmix
from agglo_core.components.annealed_parts import Weights
from agglo_core.components.fixers import ConnectivityFixer
from agglo_core.components.round_search import EFFORTS, Search
from agglo_core.graph import Graph
from agglo_core.protocols import Target

__all__ = ["round_parts"]

Start = Callable[[Graph, int], Int]
"""Labels of a connected graph with about so many parts."""

Rival = Callable[[Graph, Target], Int]
"""Labels of a connected graph that meet a target."""

_FILLED = {2: (0.40, 0.44), 3: (0.12, 0.14)}
"""Measure of a part over its size to the power of the dimension: parts of few cells, and of many."""

_COUNTED = {2: (0.38, 0.42), 3: (0.12, 0.14)}
"""The same where the number of parts is given and the size follows; others are tried, by a factor."""

_FACTOR = 1.06
_WEIGHTS = Weights(1.0, 1.05, 0.35), Weights(0.69, 1.0, 0.3)
"""Of parts of few cells, and of many, which fill a size with ease."""

_MANY = 100
_PIECES = 40
"""Parts of more cells than the one are found on a graph of so many pieces for each as the other."""

_ROUNDING = 1e-9


def round_parts(graph: Graph, target: Target, seed: int, effort: str, start: Start, rival: Rival) -> Int:
    """Labels ``(n,)`` of a connected graph of one block: round parts, connected, as even as may be.

    With a size no part but single cells is wider, and the number of parts is free; with a count there are
    so many. What the ``rival`` finds is returned where it scores higher.

    Parameters
    ----------
    graph : Graph
    target : Target
        Where it has a size its count is not used.
    seed : int
    effort : {"fast", "good", "best"}
    start : callable
        ``start(graph, k)``: labels of about k parts, connected or not.
    rival : callable
        ``rival(graph, target)``: labels of connected parts that meet the target.
    """
    if target.h_star is not None:
        return _by_component(graph, target, seed, effort, start, rival)
    if (target.parts or 1) >= graph.n or (target.parts or 1) < 2:
        return frozen_int(np.arange(graph.n) if (target.parts or 1) > 1 else np.zeros(graph.n))
    return _best(graph, target, seed, effort, start, rival)


def _by_component(graph: Graph, target: Target, seed: int, effort: str, start: Start, rival: Rival) -> Int:
    """Labels of parts of a size; cells that are wider than it stay alone, and what they part falls apart."""
    wide = graph.part_diameters(np.arange(graph.n)) > float(target.h_star or 0.0) * (1 + _ROUNDING)
    rows = np.repeat(wide, np.diff(graph.indptr))
    pieces, cells = graph.split(graph.without_edges(rows | wide[graph.indices]).components())
    fits = pieces.diameters() <= float(target.h_star or 0.0) * (1 + _ROUNDING)
    seeds = splitmix(np.uint64(seed) + np.arange(pieces.n_blocks, dtype=np.uint64))
    labels, count = np.empty(graph.n, np.int64), 0
    for b in range(pieces.n_blocks):
        own = slice(int(pieces.offsets[b]), int(pieces.offsets[b + 1]))
        if fits[b] or pieces.sizes[b] == 1:
            labels[cells[own]] = count
        else:
            labels[cells[own]] = count + _best(pieces[b], target, int(seeds[b]), effort, start, rival)
        count = int(labels[cells[own]].max()) + 1
    return frozen_int(labels)


def _best(graph: Graph, target: Target, seed: int, effort: str, start: Start, rival: Rival) -> Int:
    """Labels of a connected graph: those found by annealing, or the rival's if they score higher."""
    size, parts = _size_and_parts(graph, target, False)
    many = graph.n > _MANY * parts
    search = Search(graph, size, seed, EFFORTS[effort], _WEIGHTS[many])
    if many:
        labels = _from_pieces(search, graph, target, seed, effort, start, rival)
    else:
        labels = _searched(search, graph, target, parts, start, rival)
    other = search.tool.inward(rival(graph, target))
    scores = [search.tool.shapes(each).score(Weights()) for each in (labels, other)]
    return search.tool.outward(labels if scores[0] >= scores[1] else other)


def _searched(search: Search, graph: Graph, target: Target, parts: int, start: Start, rival: Rival) -> Int:
    """Labels, in the order of the search, from those of the start."""
    first = _connected(graph, start(graph, parts))
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
    for _ in range(search.sizes):
        search.size = max(search.size, widest)
        labels, shapes = search.polished(*search.annealed(first), cut=False)
        score = shapes.score(Weights())
        if score > best:
            best, result, chosen = score, labels, search.size
        towards = 1 if shapes.widths.max() > search.size * (1 + _ROUNDING) else -1
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
    pieces = _connected(graph, start(graph, _PIECES * parts))
    coarse = graph.coarsen(pieces)
    less = replace(EFFORTS[effort], tries=EFFORTS[effort].tries // 2)  # pieces have many corners
    above = Search(coarse, size, seed, less, search.weights)
    found = above.tool.outward(_searched(above, coarse, target, parts, start, rival))
    labels, shapes = search.cooled(search.tool.inward(found[pieces]))
    return search.polished(labels, shapes, cut=target.h_star is not None)[0]


def _connected(graph: Graph, labels: Int) -> Int:
    """Labels without gaps, with every part connected."""
    return ConnectivityFixer().fix(graph, frozen_int(np.unique(labels, return_inverse=True)[1]))


def _size_and_parts(graph: Graph, target: Target, many: bool) -> tuple[float, int]:
    """The size of the parts and their number at first: one follows from the other."""
    whole, d = float(graph.measures.sum()), graph.dim
    if target.h_star is not None:
        count = whole / (_FILLED[d][many] * float(target.h_star) ** d)
        return float(target.h_star), int(np.clip(np.ceil(count), 1, graph.n))
    parts = int(target.parts or 1)
    return float((whole / (_COUNTED[d][many] * parts)) ** (1.0 / d)), parts
