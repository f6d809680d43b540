"""Parts for solvers: anneal the better of two starts, and keep the best result."""

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
    """Draws per cell, number of annealing runs with different random numbers, and their temperatures."""

    draws: int
    times: int
    ramps: Ramps


_WARM, _HOT, _BALANCED = Ramps(1.0, 0.1), Ramps(2.0, 0.05), Ramps(2.0, 0.05, 0.3, 3.0)
"""Temperatures and penalties, relative to the change of the objective by a cell of mean size.

A warm run keeps the arrangement of its initial parts. In a hot run these hardly matter, which needs more
draws. At last almost no move worsens the parts. Penalties apply to the squared excess beyond the bounds, in
cells (benchmarks/solver_shapes.py, penalties with --balance).
"""

EFFORTS = {
    "quick": Effort(30, 1, _WARM),
    "fast": Effort(300, 1, _WARM),
    "good": Effort(3000, 1, _HOT),
    "best": Effort(10_000, 3, _HOT),
}
"""By name: about 6, 13, 100 and 900 µs per cell, for 4,000 cells (benchmarks/solver_shapes.py --times)."""

_FILLED = {2: 0.40, 3: 0.11}
"""Part measure over size to the power of the dimension, by dimension.

From it follows the initial number of parts for a size: a larger value starts with fewer parts, more of which
are then too wide and cut (benchmarks/solver_shapes.py --objective).
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
    """Anneal the better of the partitions from ``start`` and ``rival``, and return the best result.

    The starts compete with the annealed parts. With a count the number of parts is exact, balanced if
    requested. With a size, fewer parts are better, whatever the objective.
    """
    # 1. The better start, once it meets the target.
    starts = [rival(graph, target), *_start_parts(graph, target, start)]
    results = [_finish(graph, labels, target, balance) for labels in starts]
    place = min(range(len(starts)), key=lambda i: results[i].rank)
    best = results[place]
    # 2. Anneal several times. With a size, parts that are too wide may shrink before they are cut.
    size = np.inf if target.h_star is None else target.h_star * (1 + ROUNDING)
    tool, budget = SolverAnnealing(graph, size, balance), EFFORTS[effort]
    inner = tool.inward(best.labels if target.h_star is None else starts[place])
    ramps = _BALANCED if balance.bounded else budget.ramps
    for trial in splitmix(np.uint64(seed) + np.arange(budget.times, dtype=np.uint64)).tolist():
        if limit.over():
            break
        annealed = tool.outward(tool.annealed(inner, ramps, budget.draws, trial, limit))
        best = _better(best, _finish(graph, annealed, target, balance))
    return best.labels


class _Result(NamedTuple):
    """Labels that meet the target, and a sort key: balanced labels first, few parts, a small objective."""

    rank: tuple[bool, int, float]
    labels: Int


def _better(one: _Result, other: _Result) -> _Result:
    """Return the result with the lower rank, in a tie the first."""
    return other if other.rank < one.rank else one


def _start_parts(graph: Graph, target: Target, start: Start) -> list[Int]:
    """Return the connected parts of ``start`` in a list, empty if their number is not the target's.

    With a size, the parts are polished, and may be too wide.
    """
    if target.h_star is None:
        labels = connect_parts(graph, start(graph, target.parts or 1))
        return [labels] if int(labels.max()) + 1 == target.parts else []
    parts = float(graph.measures.sum()) / (_FILLED[graph.dim] * target.h_star**graph.dim)
    labels = connect_parts(graph, start(graph, int(np.clip(np.ceil(parts), 1, graph.n))))
    return [_finish(graph, labels, Target(parts=int(labels.max()) + 1), FREE).labels]


def _finish(graph: Graph, labels: Int, target: Target, balance: Balance) -> _Result:
    """Cut parts that are wider than the target, then even out their sizes if requested, otherwise polish.

    The polish is kept if it lowers the objective and meets the target.
    """
    # 1. Cut wide parts.
    if target.h_star is not None:
        labels = parts_within(graph, labels, target.h_star)
    k, value = int(labels.max()) + 1, OBJECTIVES["solver"].value
    blocks = frozen_int(np.zeros(k))
    # 2. Balanced parts: only even out the sizes.
    if balance.bounded:
        labels = BalanceRefiner(balance.size, balance.tolerance).refine_parts(graph, labels, blocks, target)
        off = not balance.holds(graph.node_sizes(balance.size), labels)
        return _Result((off, k, value(graph, labels)), labels)
    # 3. Otherwise polish, if the result is admissible and better.
    before = _Result((False, k, value(graph, labels)), labels)
    labels = CompactnessRefiner().refine_parts(graph, labels, blocks, target)
    if len(np.unique(graph.components(labels))) > k:
        return before
    if target.h_star is not None and graph.part_diameters(labels).max() > target.h_star * (1 + ROUNDING):
        return before
    return _better(before, _Result((False, k, value(graph, labels)), labels))
