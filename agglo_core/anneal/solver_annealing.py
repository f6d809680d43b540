"""Annealing of partitions for solvers, on one graph: the arrays its kernel wants, made once."""

from __future__ import annotations

from typing import Any

import numpy as np

from agglo_core.anneal.annealed_parts import corner_cells
from agglo_core.anneal.rounds import Ramps, rooms_of, take_turns
from agglo_core.arrays import Float, Int, frozen_float, frozen_index, frozen_int
from agglo_core.graph import Graph
from agglo_core.graph.ordering import curve_order
from agglo_core.graph.solver_shape import solver_factors
from agglo_core.progress import TimeLimit
from agglo_core.refine.part_sizes import FREE, Balance


class SolverAnnealing:
    """Anneals partitions of one connected block; labels are in the ``order`` of the cells along a curve.

    Parameters
    ----------
    graph : Graph
        Of one block.
    limit : float, optional
        No part becomes wider, but those that are.
    balance : Balance, optional
        How even the parts are to be.

    Attributes
    ----------
    order : (n,) int
    graph : Graph
        The graph in this order.
    """

    def __init__(self, graph: Graph, limit: float = np.inf, balance: Balance = FREE) -> None:
        from agglo_core.anneal.state import Cells

        self.order, self._limit, self._balance = curve_order(graph.centroids), float(limit), balance
        self.graph = own = graph.subgraph(self.order, frozen_int([0, graph.n]))
        self.sizes = own.node_sizes(balance.size)
        if limit < np.inf:
            self._cells: Any = corner_cells(own)
        else:
            shape = frozen_index([]), frozen_float(np.empty((0, own.dim)))
            around = *(np.empty(0) for _ in range(3)), np.empty(0, np.int64), np.empty(0, np.int32)
            geometry = own.interface, own.measures, own.centroids
            self._cells = Cells(own.indptr, own.indices, *geometry, frozen_int([]), *shape, *around)

    def inward(self, labels: Int) -> Int:
        """Labels of the graph that was given, in the order used here."""
        return frozen_int(labels[self.order])

    def outward(self, labels: Int) -> Int:
        """Labels in the order used here, as those of the graph that was given."""
        result = np.empty(len(labels), np.int64)
        result[self.order] = labels
        return frozen_int(result)

    def annealed(
        self, labels: Int, ramps: Ramps, draws: float, seed: int, limit: TimeLimit | None = None
    ) -> Int:
        """Labels after so many draws for each cell: the same for any number of threads.

        Temperatures are over what a cell of mean size changes.
        """
        from agglo_core.anneal.inertia_annealing import Pursuit, anneal_inertia, solver_state

        n, k = len(labels), int(labels.max()) + 1
        heavy, long = solver_factors(self.graph, frozen_int([k]))
        bounds = self._balance.bounds(self.sizes, k)
        factors = n * float(heavy[0]), n * float(long[0])
        pursuit = Pursuit(self.graph.weights, self.sizes, *factors, self._limit, *bounds)
        given = self.graph.weights, self.sizes, labels, k, self._limit < np.inf
        parts, work = solver_state(self._cells, *given)

        def make(room: Any, shares: Any, start: int, stop: int, rounds: Float, own: Any, stamp: int) -> None:
            anneal_inertia(self._cells, parts, room, shares, start, stop, pursuit, rounds, own, stamp)

        rest = ramps.rounds(draws), seed, limit or TimeLimit()
        take_turns(make, self.graph, parts, rooms_of(work), *rest)
        return frozen_int(parts.labels)
