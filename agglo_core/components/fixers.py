"""Connectivity repair."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.graph import Graph

__all__ = ["ConnectivityFixer"]


class ConnectivityFixer:
    """Keeps the largest component of each part; the others join the neighbour they touch most.

    "Largest" is by measure, "most" by interface; growth is outwards from what is kept, so every part
    is connected by construction and no label is created or dropped. Of equal ones (up to rounding) the place
    among the components decides, not the numbering of the cells.
    """

    def fix(self, graph: Graph, labels: Int) -> Int:
        """Labels ``(n,)`` with every part connected; the identity if they already are.

        Raises
        ------
        ValueError
            If a block of ``graph`` is itself disconnected.
        """
        from agglo_core.kernels.graphs import components
        from agglo_core.kernels.repair import absorb, keepers

        stride = int(labels.max()) + 1
        parts = frozen_int(graph.block_ids * stride + labels)
        nodes, offsets = components(graph.indptr, graph.indices, parts)
        part_of = frozen_int(parts[nodes[offsets[:-1]]])
        if len(part_of) == np.count_nonzero(np.bincount(part_of)):
            return frozen_int(labels)
        size = frozen_float(np.add.reduceat(graph.measures[nodes], offsets[:-1]))
        places = _places(graph, frozen_int(nodes), frozen_int(offsets))
        keeper = keepers(part_of, size, places, stride * graph.n_blocks)
        intact = keeper[part_of] == np.arange(len(part_of))
        kept = np.empty(graph.n, np.int64)
        kept[nodes] = np.where(np.repeat(intact, np.diff(offsets)), parts[nodes], -1)
        fixed = absorb(
            graph.indptr,
            graph.indices,
            graph.interface,
            frozen_int(kept),
            frozen_int(nodes),
            frozen_int(offsets),
            frozen_int(np.flatnonzero(~intact)),
            frozen_int(keeper),
            places,
        )
        lost = np.flatnonzero(fixed < 0)
        if len(lost):
            block = int(graph.block_ids[lost[0]])
            raise ValueError(f"block {block} is disconnected: split it into components before fixing")
        return frozen_int(fixed - graph.block_ids * stride)


def _places(graph: Graph, nodes: Int, offsets: Int) -> Float:
    """Where each component lies in its block, ``(components, 3 + d)`` numbers of order 1.

    The first three do not change if the mesh is turned, mirrored, moved or scaled: how far along the mean
    of all components from the middle, and along their mean weighted by squared distance, and the squared
    distance itself. Coordinates are for labels that have a symmetry, where those are equal.
    """
    first, counts = offsets[:-1], np.diff(offsets)[:, None]
    total = np.add.reduceat(graph.centroids.take(nodes, axis=0), first)
    block = graph.block_ids[nodes[first]]
    starts = np.flatnonzero(np.diff(block, prepend=-1))  # components are numbered block by block
    of = np.cumsum(np.diff(block, prepend=block[0]) > 0)

    def average(values: Float, weights: Int) -> Float:
        return np.asarray(np.add.reduceat(values, starts) / np.add.reduceat(weights, starts))

    mean = total / counts - average(total, counts)[of]
    furthest = np.sqrt(np.maximum.reduceat((mean**2).sum(axis=1), starts))
    mean /= np.where(furthest > 0.0, furthest, 1.0)[of, None]
    squares = (mean**2).sum(axis=1)
    axes = [average(each, np.ones_like(counts))[of] for each in (mean, squares[:, None] * mean)]
    return frozen_float(np.column_stack((*((mean * axis).sum(axis=1) for axis in axes), squares, mean)))
