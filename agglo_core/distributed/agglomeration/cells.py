"""The cells of one rank and its ghosts as a graph, and what ranks agree on about the edges between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, Mask, frozen_int
from agglo_core.distributed.communication import Ranks
from agglo_core.graph import Graph

_DIGITS = 2.0**30  # in which sums are exact: integers


@dataclass(frozen=True, eq=False)
class Cells:
    """The cells of one rank and its ghosts, with who has them.

    Attributes
    ----------
    ranks : Ranks
    graph : Graph
        Of own cells and ghosts; only what it says of own ones need be whole.
    ids : (n,) int
        Global ids, rising.
    owners : (n,) int
    """

    ranks: Ranks
    graph: Graph
    ids: Int
    owners: Int

    @cached_property
    def own(self) -> Mask:
        """Which of them belong to this rank ``(n,)``."""
        mask: Mask = self.owners == self.ranks.rank
        return mask

    @cached_property
    def rows(self) -> Int:
        """The cell of each entry of the graph ``(m,)``."""
        return frozen_int(np.repeat(np.arange(self.graph.n), np.diff(self.graph.indptr)))

    def total(self, values: Float) -> float:
        """Sum over the own cells of all ranks; its last digit does not depend on the ranks."""
        own = values[self.own]
        scale = self.ranks.largest(float(own.max(initial=0.0)))
        if not scale > 0:
            return 0.0
        digits = np.rint(own / scale * _DIGITS).astype(np.int64).sum(keepdims=True)
        return float(self.ranks.reduced(digits, "sum")[0]) * scale / _DIGITS


def agreed(cells: Cells, forbidden: Mask) -> Mask:
    """Forbidden entries, those between ranks if either side says so."""
    graph, rows, own = cells.graph, cells.rows, cells.own
    entry = np.flatnonzero(forbidden & own[rows] & ~own[graph.indices])
    here, there = rows[entry], graph.indices[entry].astype(np.int64)
    parcels: dict[int, NDArray[Any]] = {}
    for rank in np.unique(cells.owners[there]).tolist():
        chosen = cells.owners[there] == rank
        parcels[rank] = np.stack((cells.ids[here[chosen]], cells.ids[there[chosen]]), axis=1)
    told = [each for each in cells.ranks.exchanged(parcels).values() if len(each)]
    if not told:
        return forbidden
    pairs = np.searchsorted(cells.ids, np.concatenate(told))
    return forbidden | among(rows, graph.indices.astype(np.int64), frozen_int(pairs), graph.n)


def among(row: Int, column: Int, pairs: Int, n: int) -> Mask:
    """Which entries of a graph of ``n`` nodes join one of the ``pairs (p, 2)``, in either direction."""
    if not len(pairs):
        return np.zeros(len(row), bool)
    keys = np.concatenate((pairs[:, 0] * n + pairs[:, 1], pairs[:, 1] * n + pairs[:, 0]))
    found: Mask = np.isin(row * n + column, keys)
    return found
