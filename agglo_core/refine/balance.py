"""Balance refiner: move cells until parts have equal sizes."""

from __future__ import annotations

from typing import Literal

import numpy as np

from agglo_core.arrays import Int, UInt64, frozen_float, frozen_int
from agglo_core.graph import Graph
from agglo_core.protocols import Target
from agglo_core.refine.part_sizes import SIZES, block_sizes, check_size, check_tolerance, refine_blocks


class BalanceRefiner:
    """Move cells from parts that are too large to parts that are too small, until sizes are even.

    Cells travel along shortest paths of adjacent parts. Each part on a path passes on the cells farthest in
    the path's direction, so parts stay compact. Parts also stay connected, and no part is emptied. The
    refiner stops when all sizes are within ``tolerance`` times their block's mean, or less than one cell from
    it, or when no further cell can move. With tolerance 0, cell counts then differ by at most 1.

    Interface lengths are not considered: ``post_refiners=("balance", "fm")`` shortens interfaces and keeps
    the balance.

    Parameters
    ----------
    size : "cells", "measure" or "weights", optional
        Quantity to balance: cell count, measure, or the run's weights (else the graph's). Default: the
        quantity that the run balances (its ``weights=`` or ``balance=``), else cells.
    tolerance : float
        0 or more.

    Raises
    ------
    OptionError
        For any other value.

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
        self.size = check_size("balance", size)
        self.tolerance = check_tolerance("balance", tolerance)
        self.objective = SIZES[size]

    def refine(self, graph: Graph, labels: Int, seeds: UInt64, target: Target) -> Int:
        """Return the balanced labels ``(n,)``, independent of the seeds."""
        return refine_blocks(self, graph, labels, target)

    def refine_parts(self, graph: Graph, labels: Int, block: Int, target: Target) -> Int:
        """Return the balanced labels ``(n,)``, where part p exchanges cells only within ``block[p]``."""
        from agglo_core.refine.balance_paths import even_out

        if graph.n == 0:
            return labels
        sizes = graph.node_sizes(self.size)
        mean, cell = block_sizes(sizes, labels, block)
        room = frozen_float(np.maximum(self.tolerance * mean, (1.0 - 1e-9) * cell))
        where = graph.indptr, graph.indices, graph.centroids
        return frozen_int(even_out(*where, sizes, labels, block, frozen_float(mean), room))
