"""The refiner that anneals: the parts stay, their cells change hands."""

from __future__ import annotations

from typing import Literal

import numpy as np

from agglo_core.anneal.annealed_parts import ROUNDING, Annealing, Weights
from agglo_core.anneal.rounds import Ramps
from agglo_core.anneal.solver_parts import SolverAnnealing
from agglo_core.arrays import Int, UInt64, frozen_int
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.progress import TimeLimit, checked_seconds
from agglo_core.protocols import Target

_RAMPS = Ramps(0.1, 1e-3, 160.0, 400.0)
_FOR_SOLVERS = Ramps(2.0, 0.02)
_NEVER = 1e7
_FILLED = {2: 0.38, 3: 0.13}
"""Measure of a part over its largest width to the power of the dimension, once annealed."""


class AnnealRefiner:
    """Anneals the labels of each block, at the same number of parts, for solvers or for round parts.

    Boundary cells move at random to neighbouring parts, ever more rarely where that makes parts worse. No
    part is emptied or falls into more pieces. If the target is a size, no part becomes wider than it, or than
    the widest was. A block that does not become better stays as it was. The result follows from the seeds; it
    also depends on how the mesh is turned and its cells are numbered. For parts found from nothing see the
    option ``effort`` of ``kmeans``.

    Parameters
    ----------
    moves : int
        Cells drawn for each cell of a block.
    objective : "solver" or "roundness"
        Small moments of inertia with short interfaces; or round parts of even width.
    roundness, evenness : float
        With the objective ``roundness``: what round parts, and parts of even width, count. At equal weights
        widths become even at the expense of the largest inscribed circles.
    seconds : float, optional
        When annealing ends, by a clock on the wall; the best so far is returned, which then differs from run
        to run.

    Raises
    ------
    OptionError
        If ``moves`` is not a whole number from 1 on, the objective another, the seconds not above 0, or a
        weight is negative or not finite, or both are 0.

    Examples
    --------
    >>> from agglo_core import agglomerate, samples
    >>> mesh = samples.voronoi(256, seed=1)
    >>> agglomerate(mesh, n_parts=16, post_refiners=["anneal"]).parts
    [16]
    """

    def __init__(
        self,
        moves: int = 500,
        objective: Literal["solver", "roundness"] = "solver",
        roundness: float = 1.3,
        evenness: float = 1.0,
        seconds: float | None = None,
    ) -> None:
        if not isinstance(moves, int | np.integer) or isinstance(moves, bool) or moves < 1:
            raise OptionError(f"anneal: moves must be a whole number, 1 or more, not {moves!r}")
        if objective not in ("solver", "roundness"):
            raise OptionError(f"anneal: objective must be solver or roundness, given {objective!r}")
        self.moves, self.objective = int(moves), objective
        self.seconds = checked_seconds("anneal", seconds)
        self.roundness, self.evenness = _weight("roundness", roundness), _weight("evenness", evenness)
        if self.roundness == self.evenness == 0.0:
            raise OptionError("anneal: roundness and evenness are both 0: nothing is left to pursue")

    def refine(self, graph: Graph, labels: Int, seeds: UInt64, target: Target) -> Int:
        """Labels ``(n,)`` after the moves, block by block."""
        result, limit = labels.copy(), TimeLimit(self.seconds)
        for b in range(graph.n_blocks):
            own = slice(int(graph.offsets[b]), int(graph.offsets[b + 1]))
            used, local = np.unique(labels[own], return_inverse=True)
            if 1 < len(used) < len(local):
                make = self._for_solver if self.objective == "solver" else self._round
                result[own] = used[make(graph[b], frozen_int(local), int(seeds[b]), target, limit)]
        return frozen_int(result)

    def _for_solver(self, graph: Graph, labels: Int, seed: int, target: Target, limit: TimeLimit) -> Int:
        """Labels 0..k−1 of one block after the moves; those given unless they become better."""
        tool = SolverAnnealing(graph, np.inf if target.h_star is None else target.h_star * (1 + ROUNDING))
        after = tool.outward(tool.annealed(tool.inward(labels), _FOR_SOLVERS, self.moves, seed, limit))
        better = OBJECTIVES[self.objective].value
        return after if better(graph, after) < better(graph, labels) else labels

    def _round(self, graph: Graph, labels: Int, seed: int, target: Target, limit: TimeLimit) -> Int:
        """Labels 0..k−1 of one block after the moves; those given unless they become better."""
        widths = graph.part_diameters(labels)
        most, ramps = float(widths.max()), _RAMPS.for_cells(len(labels) / len(widths))
        if not most > 0.0:
            return labels
        tool, weights = Annealing(graph), Weights(self.evenness, self.roundness, 0.0)
        if target.h_star is None:
            size = _size(tool, len(widths), most)
        else:
            size = most if most > target.h_star * (1 + ROUNDING) else float(target.h_star)
            ramps = ramps._replace(soft=_NEVER, stiff=_NEVER)
        first = tool.inward(labels)
        after = tool.outward(tool.annealed(first, size, ramps, self.moves, seed, weights, limit)[0])
        if target.h_star is not None and graph.part_diameters(after).max() > size * (1 + ROUNDING):
            return labels
        return after if self._is_better(tool, graph, labels, after) else labels

    def _is_better(self, tool: Annealing, graph: Graph, before: Int, after: Int) -> bool:
        weights, better = Weights(self.evenness, self.roundness, 0.0), OBJECTIVES[self.objective]
        if not better.value(graph, after) < better.value(graph, before):
            return False
        now, then = (tool.seen(tool.inward(labels)).score(weights) for labels in (after, before))
        return now > then


def _size(tool: Annealing, parts: int, most: float) -> float:
    """Width that so many parts of a block may have; ``most`` if cells have no measure."""
    whole = float(tool.graph.measures.sum())
    even = (whole / (_FILLED[tool.graph.dim] * parts)) ** (1.0 / tool.graph.dim)
    return max(even, float(tool.widths.max())) if even > 0.0 else most  # no part is narrower than its cells


def _weight(name: str, value: float) -> float:
    real = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    if not real or not 0.0 <= value < np.inf:
        raise OptionError(f"anneal: {name} must be a number, 0 or more, not {value!r}")
    return float(value)
