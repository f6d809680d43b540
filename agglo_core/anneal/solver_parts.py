"""Parts for solvers: anneal from several starts, and keep the best."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.anneal.annealed_parts import ROUNDING, OrderedBlock, corner_cells
from agglo_core.anneal.rounds import Ramps, rooms_of, take_turns
from agglo_core.anneal.start_parts import Rival, Start, connect_parts, parts_within
from agglo_core.arrays import Float, Int, frozen_float, frozen_index, frozen_int, splitmix
from agglo_core.graph import Graph
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.graph.solver_shape import solver_factors
from agglo_core.progress import TimeLimit
from agglo_core.protocols import Target
from agglo_core.refine.balance import BalanceRefiner
from agglo_core.refine.compactness.refiner import CompactnessRefiner
from agglo_core.refine.part_sizes import FREE, Balance


class SolverAnnealing(OrderedBlock):
    """Simulated annealing for solvers on one connected block, with labels in curve order.

    Parameters
    ----------
    graph : Graph
        A graph with one block.
    limit : float, optional
        Largest width. Only parts wider at entry may stay wider.
    balance : Balance, optional
        Required evenness.
    """

    def __init__(self, graph: Graph, limit: float = np.inf, balance: Balance = FREE) -> None:
        from agglo_core.anneal.state import Cells

        super().__init__(graph)
        search_graph, self._limit, self._balance = self.graph, float(limit), balance
        self.sizes = search_graph.node_sizes(balance.size)
        if limit < np.inf:
            self._cells: Any = corner_cells(search_graph)
        else:
            shape = frozen_index([]), frozen_float(np.empty((0, search_graph.dim)))
            around = *(np.empty(0) for _ in range(3)), np.empty(0, np.int64), np.empty(0, np.int32)
            geometry = search_graph.interface, search_graph.measures, search_graph.centroids
            self._cells = Cells(
                search_graph.indptr, search_graph.indices, *geometry, frozen_int([]), *shape, *around
            )

    def annealed(
        self, labels: Int, ramps: Ramps, draws: float, seed: int, limit: TimeLimit | None = None
    ) -> Int:
        """Anneal with ``draws`` draws per cell, and return the labels, equal for any number of threads.

        Temperatures are relative to the change by a cell of mean size.
        """
        from agglo_core.anneal.inertia_annealing import Pursuit, anneal_inertia, solver_state

        # 1. Objective and bounds.
        n, k = len(labels), int(labels.max()) + 1
        heavy, long = solver_factors(self.graph, frozen_int([k]))
        bounds = self._balance.bounds(self.sizes, k)
        factors = n * float(heavy[0]), n * float(long[0])
        pursuit = Pursuit(self.graph.weights, self.sizes, *factors, self._limit, *bounds)
        given = self.graph.weights, self.sizes, labels, k, self._limit < np.inf
        parts, work = solver_state(self._cells, *given)

        # 2. Annealing rounds in all threads.
        def make(room: Any, shares: Any, start: int, stop: int, rounds: Float, own: Any, stamp: int) -> None:
            anneal_inertia(self._cells, parts, room, shares, start, stop, pursuit, rounds, own, stamp)

        rest = ramps.rounds(draws), seed, limit or TimeLimit()
        take_turns(make, self.graph, parts, rooms_of(work), *rest)
        return frozen_int(parts.labels)


class Effort(NamedTuple):
    """Draws per cell, and number of annealing runs with different random numbers."""

    draws: int
    times: int = 1


EFFORTS = {"fast": Effort(300), "good": Effort(3000), "best": Effort(10_000, 3)}
"""By name: about 8, 80 and 800 µs per cell (benchmarks/solver_shapes.py --times)."""

_RAMPS, _BALANCED = Ramps(2.0, 0.05, 0.0, 0.0), Ramps(2.0, 0.05, 0.3, 3.0)
"""Temperatures and penalties, relative to the change of the objective by a cell of mean size.

At first the initial parts hardly matter, at last almost no move worsens the parts. Penalties apply to the
squared excess beyond the bounds, in cells (benchmarks/solver_shapes.py, penalties with --balance).
"""


def solver_parts(
    graph: Graph,
    target: Target,
    seed: int,
    effort: str,
    start: Start,
    rival: Rival,
    limit: TimeLimit,
    balance: Balance = FREE,
) -> Int:
    """Return the best partition for solvers from several annealing runs, their start and ``rival``.

    With a size, the number of parts follows the start, or the rival if it has fewer parts. With a count the
    number is exact, balanced if requested.
    """
    # 1. Candidates: the rival, and the start if it meets the target.
    rival_labels = rival(graph, target)
    first = _first(graph, target, start, rival_labels)
    best, least = rival_labels, (True, np.inf)
    for trial in (rival_labels, first) if first is not rival_labels else (rival_labels,):
        labels = _even_or_polish(graph, trial, target, balance)
        worth = _worth(graph, labels, balance)
        if worth < least:
            best, least = labels, worth
    # 2. Anneal the start several times.
    size = np.inf if target.h_star is None else target.h_star * (1 + ROUNDING)
    tool, budget = SolverAnnealing(graph, size, balance), EFFORTS[effort]
    inner, ramps = tool.inward(first), _BALANCED if balance.asked else _RAMPS
    for trial in splitmix(np.uint64(seed) + np.arange(budget.times, dtype=np.uint64)).tolist():
        if limit.over():
            break
        annealed = tool.annealed(inner, ramps, budget.draws, trial, limit)
        labels = _even_or_polish(graph, tool.outward(annealed), target, balance)
        worth = _worth(graph, labels, balance)
        if worth < least:
            best, least = labels, worth
    return best


def _first(graph: Graph, target: Target, start: Start, rival_labels: Int) -> Int:
    """Return the labels from ``start`` if they meet the target with few parts, else ``rival_labels``."""
    parts = int(rival_labels.max()) + 1
    first = connect_parts(graph, start(graph, min(parts, target.parts or parts)))
    if target.h_star is not None:
        first = parts_within(graph, first, target.h_star)
        return first if int(first.max()) < parts else rival_labels
    return first if int(first.max()) + 1 == parts else rival_labels


def _worth(graph: Graph, labels: Int, balance: Balance) -> tuple[bool, float]:
    """Return a sort key of labels, smaller is better: balanced labels first, then by the objective."""
    off = not balance.holds(graph.node_sizes(balance.size), labels)
    return off, OBJECTIVES["solver"].value(graph, labels)


def _even_or_polish(graph: Graph, labels: Int, target: Target, balance: Balance) -> Int:
    """Even out part sizes if requested, otherwise apply the default polish.

    The polish is kept if it lowers the objective and meets the target.
    """
    k = int(labels.max()) + 1
    # 1. Balanced parts: only even out the sizes.
    if balance.asked:
        even = BalanceRefiner(balance.size, balance.tolerance)
        return even.refine_parts(graph, labels, frozen_int(np.zeros(k)), target)
    # 2. Otherwise polish, if the result is admissible and better.
    after = CompactnessRefiner().refine_parts(graph, labels, frozen_int(np.zeros(k)), target)
    if len(np.unique(graph.components(after))) > k:
        return labels
    if target.h_star is not None and graph.part_diameters(after).max() > target.h_star * (1 + ROUNDING):
        return labels
    value = OBJECTIVES["solver"].value
    return after if value(graph, after) < value(graph, labels) else labels
