"""Merging of parts in pairs, where nothing forbids their union."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_int
from agglo_core.graph import Graph

Refused = Callable[[Int, Mask], Mask]
"""``refused(labels, asked)``: which of the parts asked for ``(k,)`` may not be."""

Pairs = set[tuple[int, int]]


def merged_pairs(
    graph: Graph,
    blocks: Int,
    labels: Int,
    wanted: Callable[[Graph, Int], Mask],
    refused: Refused,
    *,
    most: int | None = None,
    by_interface: bool = False,
) -> Int:
    """Labels ``(n,)``, gaps closed, after wanted parts were merged with neighbours in their block.

    Those of the least mass go first, each with the lightest neighbour, or with that of the longest interface.
    In each round a part merges once; unions that are refused are undone, and not tried again.

    Parameters
    ----------
    wanted : callable
        ``wanted(parts, labels)``: which parts ``(k,)``, nodes of the quotient graph, look for a neighbour.
    refused : callable
    most : int, optional
        Largest number of merges; all that can be made if not given.
    """
    tried: Pairs = set()
    left = graph.n if most is None else most
    while left > 0:
        parts = graph.coarsen(labels)
        block = np.empty(parts.n, np.int64)
        block[labels] = blocks
        pairs = _proposals(parts, block, wanted(parts, labels), tried, by_interface)
        pairs = _apart(pairs, parts.n)[:left]
        if len(pairs) == 0:
            break
        labels, done, tried = _joined(labels, parts.n, pairs, refused, tried)
        left -= done
    return frozen_int(labels)


def _proposals(parts: Graph, block: Int, wanted: Mask, tried: Pairs, by_interface: bool) -> Int:
    """Pairs ``(q, 2)`` of a part that looks for a neighbour and the best one, the most urgent first."""
    rows = np.repeat(np.arange(parts.n), np.diff(parts.indptr))
    columns = parts.indices.astype(np.int64)
    usable = wanted[rows] & (block[rows] == block[columns])
    if tried:
        known = np.array(sorted(tried))
        keys = np.concatenate((known @ (parts.n, 1), known @ (1, parts.n)))
        usable &= ~np.isin(rows * parts.n + columns, keys)
    rows, columns = rows[usable], columns[usable]
    merit: Float = parts.interface[usable] if by_interface else -parts.mass[columns]
    order = np.lexsort((columns, -merit, rows))
    best = order[np.unique(rows[order], return_index=True)[1]]
    urgent = np.argsort(parts.mass[rows[best]] + parts.mass[columns[best]], kind="stable")
    chosen = best[urgent]
    return frozen_int(np.stack((rows[chosen], columns[chosen]), axis=1).reshape(-1, 2))


def _apart(pairs: Int, n: int) -> Int:
    """Those pairs that come before all others with one of their parts."""
    rank = np.arange(len(pairs))
    first = np.full(n, len(pairs))
    np.minimum.at(first, pairs.ravel(), np.repeat(rank, 2))
    return frozen_int(pairs[(first[pairs] == rank[:, None]).all(axis=1)])


def _joined(labels: Int, count: int, pairs: Int, refused: Refused, tried: Pairs) -> tuple[Int, int, Pairs]:
    """Labels once the pairs are joined, how many were, and unions that need not be tried again.

    What is refused stays so when more is added to it.
    """
    whole = _numbers(pairs, count)
    asked = np.zeros(count - len(pairs), bool)
    asked[whole[pairs[:, 1]]] = True
    bad = refused(frozen_int(whole[labels]), asked)[whole[pairs[:, 1]]]
    number = _numbers(pairs[~bad], count)
    known = {(min(pair), max(pair)) for pair in (*tried, *map(tuple, pairs[bad].tolist()))}
    tried = {(int(number[one]), int(number[other])) for one, other in known}
    return frozen_int(number[labels]), int(np.count_nonzero(~bad)), tried


def _numbers(pairs: Int, count: int) -> Int:
    """New number of each part ``(count,)``, without gaps, once the pairs are joined."""
    into = np.arange(count)
    into[pairs[:, 0]] = pairs[:, 1]
    return np.unique(into, return_inverse=True)[1]
