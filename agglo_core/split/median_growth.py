"""All splits of a run at medians, made in place, without a graph for each depth."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Int, UInt64, frozen_float, frozen_int
from agglo_core.graph import Graph
from agglo_core.graph.blocks import TIE
from agglo_core.progress import Tell
from agglo_core.split.side_shares import side_shares

_WORK = 2_000_000
"""Cells handled, each once for every split, between two reports: about 0.1 s."""


class MedianGrowth:
    """Pieces of a graph, halved across the longest side of the box of their centroids; parts are mended.

    Gives, to the bit, what :class:`~agglo_core.split.geometric.CoordinateBisection` and
    :class:`~agglo_core.refine.connectivity.ConnectivityFixer` give depth by depth: sums are added up in the
    same order, and what counts as equal does so in both.

    Parameters
    ----------
    graph : Graph
    pieces : (n,) int
        Connected pieces 0..k−1 to start from.
    """

    def __init__(self, graph: Graph, pieces: Int) -> None:
        order = np.argsort(pieces, kind="stable")
        self._graph = (
            graph.indptr,
            graph.indices,
            graph.interface,
            graph.centroids,
            graph.mass,
            graph.weights,
        )
        self._columns = frozen_float(graph.centroids.T)
        self._lists = np.empty((graph.dim + 1, graph.n), np.int32)
        self._lists[0] = order
        for axis, values in enumerate(self._columns):
            sorted_cells = np.argsort(values, kind="stable")
            self._lists[axis + 1] = sorted_cells[np.argsort(pieces[sorted_cells], kind="stable")]
        self._tag = np.full(graph.n, -1, np.int32)
        stops = np.cumsum(np.bincount(pieces))
        self._slices = np.stack((np.concatenate(([0], stops[:-1])), stops), axis=1)

    def split(self, quotas: Int, seeds: UInt64, tell: Tell) -> tuple[Int, Int]:
        """Split piece i into ``quotas[i]`` pieces: see the protocol ``Growth`` of agglomeration."""
        from agglo_core.split.median_splits import split_at_medians

        total, first = int(quotas.sum()), len(quotas)
        todo, leaves = np.zeros((total, 4), np.int64), np.empty((total, 2), np.int64)
        todo[:first, :2], todo[:first, 2] = self._slices, quotas
        counts, tally = np.array([first, 0]), np.zeros((int(quotas.max()), 3), np.int64)
        given = self._graph, self._columns, self._lists, self._tag, side_shares(total)
        while counts[0]:
            split_at_medians(*given, todo, leaves, counts, tally, TIE, _WORK)
            done = int(counts[1])
            tell(done / total, f"{done:,} parts")
        cells = self._lists[0]
        self._slices = leaves[np.argsort(cells[leaves[:, 0]])]
        places = np.argsort(self._slices[:, 0])
        labels = np.empty(len(cells), np.int64)
        labels[cells] = np.repeat(places, np.diff(self._slices[places])[:, 0])
        return frozen_int(labels), frozen_int(tally[tally[:, 0] > 0])
