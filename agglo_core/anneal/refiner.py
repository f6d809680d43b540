"""Annealing refiner: move cells between parts at random, with a fixed part count."""

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
"""For round parts: temperatures in units of the part score, penalties in scores per excess width over size.

A hotter start loses the shapes of the given parts, a colder start moves few cells
(benchmarks/round_solids.py).
"""

_FOR_SOLVERS = Ramps(2.0, 0.02)
"""For solvers: temperatures relative to the change of the objective by a cell of mean size, no penalty."""

_NEVER = 1e7
"""Penalty, in scores per excess width over size, that prevents all violating moves."""

_FILLED = {2: 0.38, 3: 0.13}
"""Part measure over its largest width to the power of the dimension, for annealed parts.

From it follows the expected width for a number of parts: a larger value penalises wide parts more
(benchmarks/round_solids.py).
"""


class AnnealRefiner:
    """Anneal each block at a fixed part count, for solvers or for round parts.

    Boundary cells move at random to adjacent parts, with ever fewer moves that worsen the parts. No part is
    emptied or falls into more components. With a size target, no part becomes wider than the target, or than
    the widest part at entry. A block without improvement remains unchanged. The result depends on the seeds,
    and also on the mesh orientation and cell numbering. To find parts from scratch, use the option ``effort``
    of ``kmeans``.

    Parameters
    ----------
    moves : int
        Draws per cell.
    objective : "solver" or "roundness"
        Small moments of inertia with short interfaces, or round parts with even widths.
    roundness, evenness : float
        Weights of round shapes and even widths in the objective ``roundness``. At equal weights widths
        become even at the expense of the largest inscribed circles.
    seconds : float, optional
        Wall-clock time limit. After it the best labels so far are returned, which then differ between runs.

    Raises
    ------
    OptionError
        If ``moves`` is not a positive integer, the objective is unknown, ``seconds`` is not positive, or a
        weight is negative or not finite, or both weights are 0.

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
            raise OptionError("anneal: roundness and evenness must not both be 0")

    def refine(self, graph: Graph, labels: Int, seeds: UInt64, target: Target) -> Int:
        """Return the labels ``(n,)`` after annealing block by block."""
        result, limit = labels.copy(), TimeLimit(self.seconds)
        for b in range(graph.n_blocks):
            span = slice(int(graph.offsets[b]), int(graph.offsets[b + 1]))
            part_ids, local = np.unique(labels[span], return_inverse=True)
            if 1 < len(part_ids) < len(local):
                make = self._for_solver if self.objective == "solver" else self._round
                result[span] = part_ids[make(graph[b], frozen_int(local), int(seeds[b]), target, limit)]
        return frozen_int(result)

    def _for_solver(self, graph: Graph, labels: Int, seed: int, target: Target, limit: TimeLimit) -> Int:
        """Anneal one block for solvers, and return the better labels, old or new."""
        tool = SolverAnnealing(graph, np.inf if target.h_star is None else target.h_star * (1 + ROUNDING))
        after = tool.outward(tool.annealed(tool.inward(labels), _FOR_SOLVERS, self.moves, seed, limit))
        better = OBJECTIVES[self.objective].value
        return after if better(graph, after) < better(graph, labels) else labels

    def _round(self, graph: Graph, labels: Int, seed: int, target: Target, limit: TimeLimit) -> Int:
        """Anneal one block for round parts, and return the better labels, old or new."""
        widths = graph.part_diameters(labels)
        most, ramps = float(widths.max()), _RAMPS.for_cells(len(labels) / len(widths))
        if not most > 0.0:
            return labels
        # 1. Size: from the number of parts, or from the target with an infinite penalty for wider parts.
        tool, weights = Annealing(graph), Weights(self.evenness, self.roundness, 0.0)
        if target.h_star is None:
            size = _size(tool, len(widths), most)
        else:
            size = most if most > target.h_star * (1 + ROUNDING) else float(target.h_star)
            ramps = ramps._replace(soft=_NEVER, stiff=_NEVER)
        # 2. Anneal, and reject labels that are too wide or not better.
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
    """Return the expected width of a block's ``parts`` parts, or ``most`` if the cells have measure zero."""
    whole = float(tool.graph.measures.sum())
    even = (whole / (_FILLED[tool.graph.dim] * parts)) ** (1.0 / tool.graph.dim)
    return max(even, float(tool.widths.max())) if even > 0.0 else most  # no part is narrower than its cells


def _weight(name: str, value: float) -> float:
    real = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    if not real or not 0.0 <= value < np.inf:
        raise OptionError(f"anneal: {name} must be a number, 0 or more, not {value!r}")
    return float(value)
