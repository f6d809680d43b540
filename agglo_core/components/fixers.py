"""Connectivity repair."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Int, frozen_int
from agglo_core.graph import Graph

__all__ = ["ConnectivityFixer"]


class ConnectivityFixer:
    """Keeps the largest component of each part; the others join the neighbour they touch most.

    "Largest" is by measure, "most" by interface; growth is outwards from what is kept, so every part
    is connected by construction and no label is created or dropped.
    """

    def fix(self, graph: Graph, labels: Int) -> Int:
        """Labels ``(n,)`` with every part connected; the identity if they already are.

        Raises
        ------
        ValueError
            If a block of ``graph`` is itself disconnected.
        """
        from agglo_core.kernels.graphs import components
        from agglo_core.kernels.repair import absorb

        stride = int(labels.max()) + 1
        parts = frozen_int(graph.block_ids * stride + labels)
        nodes, offsets = components(graph.indptr, graph.indices, parts)
        part_of = parts[nodes[offsets[:-1]]]
        size = np.add.reduceat(graph.measures[nodes], offsets[:-1])
        order = np.lexsort((np.arange(len(size)), -size, part_of))
        largest = np.concatenate(([True], np.diff(part_of[order]) != 0))
        loose = np.sort(order[~largest])
        if len(loose) == 0:
            return frozen_int(labels)
        intact = np.ones(len(size), bool)
        intact[loose] = False
        kept = np.empty(graph.n, np.int64)
        kept[nodes] = np.where(np.repeat(intact, np.diff(offsets)), parts[nodes], -1)
        fixed = absorb(
            graph.indptr,
            graph.indices,
            graph.interface,
            frozen_int(kept),
            frozen_int(nodes),
            frozen_int(offsets),
            frozen_int(loose),
            stride * graph.n_blocks,
        )
        lost = np.flatnonzero(fixed < 0)
        if len(lost):
            block = int(graph.block_ids[lost[0]])
            raise ValueError(f"block {block} is disconnected: split it into components before fixing")
        return frozen_int(fixed - graph.block_ids * stride)
