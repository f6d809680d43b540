"""Parts of equal size: a refiner that evens out what others leave."""

from __future__ import annotations

from typing import Literal

import numpy as np

from agglo_core.arrays import Int, UInt64, frozen_float, frozen_int
from agglo_core.graph import Graph
from agglo_core.protocols import Target
from agglo_core.refine.part_sizes import SIZES, block_sizes, checked_size, checked_tolerance, refined_blocks


class BalanceRefiner:
    """Hands cells on from parts that are too large to parts that are too small, until sizes are even.

    Cells go the shortest way through parts between, which take some and hand others on: those that lie most
    towards the next part, so that parts stay compact. They stay connected too, and none is emptied. It ends
    when all sizes are within ``tolerance`` times the mean of their block, or less than one cell from it; or
    where what is left cannot be moved. With tolerance 0 numbers of cells differ by at most 1 then.

    Short interfaces are for others: ``post_refiners=("balance", "fm")`` keeps the balance.

    Parameters
    ----------
    size : "cells", "measure" or "weights", optional
        Quantity that is evened out: number of cells, measure, or the weights of the run, else of the graph.
        Default: that which the run balances (its ``weights=`` or ``balance=``), else cells.
    tolerance : float
        0 or more.

    Raises
    ------
    OptionError
        For anything else.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core import samples
    >>> from agglo_core.refine.balance import BalanceRefiner
    >>> from agglo_core.protocols import Target
    >>> graph = samples.strip(8).graph
    >>> BalanceRefiner().refine(graph, np.array([0, 0, 0, 0, 0, 1, 2, 3]), np.zeros(1, np.uint64), Target(4))
    array([0, 0, 1, 1, 2, 2, 3, 3])
    """

    def __init__(
        self, size: Literal["cells", "measure", "weights"] | None = None, tolerance: float = 0.0
    ) -> None:
        self.size = checked_size("balance", size)
        self.tolerance = checked_tolerance("balance", tolerance)
        self.objective = SIZES[size]

    def refine(self, graph: Graph, labels: Int, seeds: UInt64, target: Target) -> Int:
        """Labels ``(n,)`` of even parts; seeds are not used."""
        return refined_blocks(self, graph, labels, target)

    def refine_parts(self, graph: Graph, labels: Int, block: Int, target: Target) -> Int:
        """Labels ``(n,)`` of even parts; part p may trade cells with parts of ``block[p]`` alone."""
        from agglo_core.refine.balance_paths import even_out

        if graph.n == 0:
            return labels
        sizes = graph.node_sizes(self.size)
        mean, cell = block_sizes(sizes, labels, block)
        room = frozen_float(np.maximum(self.tolerance * mean, (1.0 - 1e-9) * cell))
        where = graph.indptr, graph.indices, graph.centroids
        return frozen_int(even_out(*where, sizes, labels, block, frozen_float(mean), room))
