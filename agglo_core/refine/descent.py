"""Descent refiner for any objective that can evaluate single moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agglo_core.arrays import Float, Int, Mask, UInt64, frozen_int
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.graph.moves import boundary_moves, part_sums
from agglo_core.graph.objectives import numbered_parts
from agglo_core.protocols import IncrementalMetric, Target
from agglo_core.refine.objective_choice import ChosenObjective, choose_objective
from agglo_core.registry import Registry

_FLOOR = 0.85
"""Smallest allowed measure of a part, relative to its measure at entry (for two parts: to the smaller
part's).

A larger value keeps parts more equal, but forbids more moves.
Benchmark: benchmarks/constants.py.
"""
_NOISE = 1e-9
"""Relative tolerance: changes below this fraction of the block's largest change count as rounding."""


@dataclass(frozen=True)
class _Moves:
    """Moves ``(q,)``: cells, their parts, their target parts, and the objective changes."""

    cells: Int
    own: Int
    parts: Int
    changes: Float

    def __getitem__(self, kept: Mask | Int) -> _Moves:
        return _Moves(self.cells[kept], self.own[kept], self.parts[kept], self.changes[kept])


class DescentRefiner:
    """Move boundary cells to adjacent parts wherever this improves a chosen objective.

    Each sweep evaluates all moves at once, and makes the best moves that share no part. If a block's
    objective does not improve, its sweep is undone and the block is not visited again. No part is emptied or
    falls into more components, and no part falls below 0.85 times its measure at entry (for two parts: times
    the smaller part's measure).

    Parameters
    ----------
    objective : str or metric
        Built-in objective (interface, cut, compactness, shape, balance, normalised_cut), or a quality metric
        with a method ``changes``, by name or as an object. The values of a metric are summed over the parts.
    sweeps : int
        Maximum number of sweeps.
    registry : Registry, optional
        Registry for metric names. Default: the registry of the program.

    Attributes
    ----------
    objective : str
        Name of the objective.
    metric : object or None
        The metric, if the objective is a metric.

    Raises
    ------
    OptionError
        If the objective is unknown, or cannot evaluate single moves.

    Examples
    --------
    >>> from agglo_core import agglomerate, samples
    >>> from agglo_core.refine.descent import DescentRefiner
    >>> rounder = DescentRefiner("compactness")
    >>> agglomerate(samples.squares(8), n_parts=4, bisector="inertial", refiners=[rounder]).parts
    [4]
    """

    def __init__(
        self,
        objective: str | IncrementalMetric = "interface",
        sweeps: int = 60,
        *,
        registry: Registry | None = None,
    ) -> None:
        whole = isinstance(sweeps, int | np.integer) and not isinstance(sweeps, bool)
        if not whole or sweeps < 1:
            raise OptionError(f"descent: sweeps must be a whole number, 1 or more, not {sweeps!r}")
        self._chosen = choose_objective(objective, registry)
        self.objective, self.metric = self._chosen.name, self._chosen.metric
        self.sweeps = int(sweeps)

    def refine(self, graph: Graph, labels: Int, seeds: UInt64, target: Target) -> Int:
        """Return the labels ``(n,)`` after the sweeps, independent of seeds and target."""
        # 1. Number the parts through all blocks.
        parts = numbered_parts(graph, labels)
        k = int(parts.max(initial=-1)) + 1
        local, block = np.empty(k, np.int64), np.empty(k, np.int64)
        local[parts], block[parts] = labels, graph.block_ids
        floors = _floors(graph, parts, block)
        active = np.ones(graph.n_blocks, bool)
        # 2. Sweeps: make the best independent moves, and undo them in blocks without improvement.
        for _ in range(self.sweeps):
            moves = _choose_moves(self._allowed(graph, parts, floors, active[block]), k)
            active &= _holds(block[moves.own], graph.n_blocks)
            if not active.any():
                break
            moved = parts.copy()
            moved[moves.cells] = moves.parts
            active &= _find_improved_blocks(self._chosen, graph, parts, frozen_int(moved), moves, block)
            parts = frozen_int(np.where(active[graph.block_ids], moved, parts))
        return frozen_int(local[parts])

    def _allowed(self, graph: Graph, parts: Int, floors: Float, active: Mask) -> _Moves:
        """Return improving moves to ``active`` parts, if the old part stays connected and large enough."""
        from agglo_core.refine.articulation import cut_cells

        # 1. All moves of boundary cells, with their changes.
        cells, to = boundary_moves(graph, parts)
        kept = active[to]
        cells, to = frozen_int(cells[kept]), frozen_int(to[kept])
        moves = _Moves(cells, parts[cells], to, self._chosen.changes(graph, parts, cells, to))
        # 2. Drop the moves that do not pay.
        block = graph.block_ids[cells]
        largest = np.zeros(graph.n_blocks)
        np.maximum.at(largest, block, np.abs(moves.changes))
        moves = moves[moves.changes < -_NOISE * largest[block]]
        # 3. Drop the moves that make a part too small, empty or disconnected.
        home_measures = part_sums(parts, graph.measures)[moves.own] - graph.measures[moves.cells]
        keeps_cell = np.bincount(parts)[moves.own] > 1
        tight = cut_cells(graph.indptr, graph.indices, parts)[moves.cells]
        return moves[keeps_cell & ~tight & (home_measures >= floors[moves.own])]


def _floors(graph: Graph, parts: Int, block: Int) -> Float:
    """Return the smallest allowed measure per part ``(k,)``."""
    measures = part_sums(parts, graph.measures)
    smallest = np.full(graph.n_blocks, np.inf)
    np.minimum.at(smallest, block, measures)
    floors: Float = _FLOOR * np.where(np.bincount(block)[block] == 2, smallest[block], measures)
    return floors


def _choose_moves(moves: _Moves, k: int) -> _Moves:
    """Choose the best moves greedily so that no two moves share a part."""
    q = len(moves.cells)
    rank = np.empty(q, np.int64)
    rank[np.argsort(moves.changes, kind="stable")] = np.arange(q)
    picks: list[Int] = []
    free = np.arange(q)
    while len(free):
        best = np.full(k, q)
        for ends in (moves.own[free], moves.parts[free]):
            np.minimum.at(best, ends, rank[free])
        # A move is chosen if it is the best free move for both of its parts.
        first = free[(best[moves.own[free]] == rank[free]) & (best[moves.parts[free]] == rank[free])]
        picks.append(first)
        taken = _holds(np.concatenate((moves.own[first], moves.parts[first])), k)
        free = free[~(taken[moves.own[free]] | taken[moves.parts[free]])]
    return moves[np.concatenate(picks) if picks else free]


def _find_improved_blocks(
    objective: ChosenObjective, graph: Graph, before: Int, after: Int, moves: _Moves, block: Int
) -> Mask:
    """Return a mask ``(B,)`` of the blocks with a better objective after the moves.

    Objectives with part values are compared by their totals. A metric cannot be measured on a graph. Instead,
    undoing the moves one at a time must worsen the objective in total.
    """
    if objective.of_parts is not None:
        totals_after, totals_before = (
            part_sums(block, objective.of_parts(graph, labels), graph.n_blocks) for labels in (after, before)
        )
        better: Mask = totals_after < totals_before
        return better
    back = objective.changes(graph, after, frozen_int(moves.cells), frozen_int(moves.own))
    return part_sums(block[moves.own], back, graph.n_blocks) > 0.0


def _holds(members: Int, size: int) -> Mask:
    """Return a mask ``(size,)`` that is True at the indices in ``members``."""
    found: Mask = np.zeros(size, bool)
    found[members] = True
    return found
