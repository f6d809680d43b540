"""Dual graph on a rank's cells and ghosts, and agreement between ranks on forbidden edges."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, Mask, frozen_int
from agglo_core.distributed.communication import Ranks
from agglo_core.graph import Graph

_DIGITS = 2.0**30  # values are rounded to integers of this size, so that sums are exact


@dataclass(frozen=True, eq=False)
class Cells:
    """Dual graph on a rank's cells and ghosts, with the rank that owns each cell.

    Attributes
    ----------
    ranks : Ranks
    graph : Graph
        Own cells and ghosts. Only data on own cells need be complete.
    ids : (n,) int
        Global ids, increasing.
    owners : (n,) int
    """

    ranks: Ranks
    graph: Graph
    ids: Int
    owners: Int

    @cached_property
    def own(self) -> Mask:
        """Mask for the cells owned by this rank ``(n,)``."""
        mask: Mask = self.owners == self.ranks.rank
        return mask

    @cached_property
    def rows(self) -> Int:
        """Tail node of each edge ``(m,)``: its row in the adjacency matrix."""
        return frozen_int(np.repeat(np.arange(self.graph.n), np.diff(self.graph.indptr)))

    def total(self, values: Float) -> float:
        """Sum values over the cells of all ranks, with a result bitwise independent of the distribution."""
        own_values = values[self.own]
        scale = self.ranks.largest(float(own_values.max(initial=0.0)))
        if not scale > 0:
            return 0.0
        digits = np.rint(own_values / scale * _DIGITS).astype(np.int64).sum(keepdims=True)
        return float(self.ranks.reduced(digits, "sum")[0]) * scale / _DIGITS


def agree_on_forbidden(cells: Cells, forbidden: Mask) -> Mask:
    """Return the forbidden edges. An edge between two ranks is forbidden if either rank forbids it.

    Edges within a rank keep their marks.
    """
    graph, rows, is_own = cells.graph, cells.rows, cells.own
    entry = np.flatnonzero(forbidden & is_own[rows] & ~is_own[graph.indices])
    own_node, ghost_node = rows[entry], graph.indices[entry].astype(np.int64)
    parcels: dict[int, NDArray[Any]] = {}
    for rank in np.unique(cells.owners[ghost_node]).tolist():
        of_rank = cells.owners[ghost_node] == rank
        parcels[rank] = np.stack((cells.ids[own_node[of_rank]], cells.ids[ghost_node[of_rank]]), axis=1)
    messages = [message for message in cells.ranks.exchanged(parcels).values() if len(message)]
    if not messages:
        return forbidden
    pairs = np.searchsorted(cells.ids, np.concatenate(messages))
    return forbidden | mark_pairs(rows, graph.indices.astype(np.int64), frozen_int(pairs), graph.n)


def mark_pairs(row: Int, column: Int, pairs: Int, n: int) -> Mask:
    """Mark the edges (``n`` nodes) that join a pair of ``pairs (p, 2)``, in either direction."""
    if not len(pairs):
        return np.zeros(len(row), bool)
    keys = np.concatenate((pairs[:, 0] * n + pairs[:, 1], pairs[:, 1] * n + pairs[:, 0]))
    found: Mask = np.isin(row * n + column, keys)
    return found
