"""Descent: a refiner for any objective that can tell what a move changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agglo_core.arrays import Float, Int, Mask, UInt64, frozen_int
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.graph.moves import boundary_moves, part_sums
from agglo_core.graph.objectives import numbered_parts
from agglo_core.protocols import IncrementalMetric, Target
from agglo_core.refine.objective_choice import ChosenObjective, chosen_objective
from agglo_core.registry import Registry

_FLOOR = 0.85
"""Smallest allowed measure of a part over its measure at entry (of two parts: over the smaller one's)."""
_NOISE = 1e-9
"""Changes below this share of the largest in their block are taken for rounding."""


@dataclass(frozen=True)
class _Moves:
    """Cells, the parts they are in, the parts they go to, and what that changes: ``(q,)`` each."""

    cells: Int
    own: Int
    parts: Int
    changes: Float

    def __getitem__(self, kept: Mask | Int) -> _Moves:
        return _Moves(self.cells[kept], self.own[kept], self.parts[kept], self.changes[kept])


class DescentRefiner:
    """Moves boundary cells to neighbouring parts wherever that improves an objective of your choice.

    In a sweep all moves are evaluated at once, and the best of them that share no part are made. In a block
    whose objective did not improve the sweep is undone, and the block is left alone from then on. No part is
    emptied or falls into more pieces, and none falls below 0.85 times its measure at entry (of two
    parts: the smaller one's).

    Parameters
    ----------
    objective : str or metric
        An objective (interface, cut, compactness, shape, balance, normalised_cut), or a quality metric with
        a method ``changes``, by name or as an object: the sum of its values over the parts.
    sweeps : int
        Largest number of sweeps.
    registry : Registry, optional
        Where the name of a metric is looked up; by default that of the program.

    Attributes
    ----------
    objective : str
        Its name.
    metric : object or None
        The metric, if it is one.

    Raises
    ------
    OptionError
        If there is no such objective, or it cannot tell what a move changes.

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
        self._chosen = chosen_objective(objective, registry)
        self.objective, self.metric = self._chosen.name, self._chosen.metric
        self.sweeps = int(sweeps)

    def refine(self, graph: Graph, labels: Int, seeds: UInt64, target: Target) -> Int:
        """Labels ``(n,)`` after the sweeps; seeds and target are not used."""
        parts = numbered_parts(graph, labels)
        k = int(parts.max(initial=-1)) + 1
        local, block = np.empty(k, np.int64), np.empty(k, np.int64)
        local[parts], block[parts] = labels, graph.block_ids
        floors = _floors(graph, parts, block)
        active = np.ones(graph.n_blocks, bool)
        for _ in range(self.sweeps):
            moves = _chosen(self._allowed(graph, parts, floors, active[block]), k)
            active &= _holds(block[moves.own], graph.n_blocks)
            if not active.any():
                break
            moved = parts.copy()
            moved[moves.cells] = moves.parts
            active &= _improved(self._chosen, graph, parts, frozen_int(moved), moves, block)
            parts = frozen_int(np.where(active[graph.block_ids], moved, parts))
        return frozen_int(local[parts])

    def _allowed(self, graph: Graph, parts: Int, floors: Float, active: Mask) -> _Moves:
        """Moves in ``active`` parts that pay and leave their part connected and large enough."""
        from agglo_core.refine.articulation import cut_cells

        cells, to = boundary_moves(graph, parts)
        kept = active[to]
        cells, to = frozen_int(cells[kept]), frozen_int(to[kept])
        moves = _Moves(cells, parts[cells], to, self._chosen.changes(graph, parts, cells, to))
        block = graph.block_ids[cells]
        largest = np.zeros(graph.n_blocks)
        np.maximum.at(largest, block, np.abs(moves.changes))
        moves = moves[moves.changes < -_NOISE * largest[block]]
        rest = part_sums(parts, graph.measures)[moves.own] - graph.measures[moves.cells]
        left = np.bincount(parts)[moves.own] > 1
        tight = cut_cells(graph.indptr, graph.indices, parts)[moves.cells]
        return moves[left & ~tight & (rest >= floors[moves.own])]


def _floors(graph: Graph, parts: Int, block: Int) -> Float:
    """Least measure of each part ``(k,)``."""
    measures = part_sums(parts, graph.measures)
    smallest = np.full(graph.n_blocks, np.inf)
    np.minimum.at(smallest, block, measures)
    floors: Float = _FLOOR * np.where(np.bincount(block)[block] == 2, smallest[block], measures)
    return floors


def _chosen(moves: _Moves, k: int) -> _Moves:
    """The best moves, then the next best that share no part with them, until none is left."""
    q = len(moves.cells)
    rank = np.empty(q, np.int64)
    rank[np.argsort(moves.changes, kind="stable")] = np.arange(q)
    chosen: list[Int] = []
    free = np.arange(q)
    while len(free):
        best = np.full(k, q)
        for ends in (moves.own[free], moves.parts[free]):
            np.minimum.at(best, ends, rank[free])
        first = free[(best[moves.own[free]] == rank[free]) & (best[moves.parts[free]] == rank[free])]
        chosen.append(first)
        taken = _holds(np.concatenate((moves.own[first], moves.parts[first])), k)
        free = free[~(taken[moves.own[free]] | taken[moves.parts[free]])]
    return moves[np.concatenate(chosen) if chosen else free]


def _improved(
    objective: ChosenObjective, graph: Graph, before: Int, after: Int, moves: _Moves, block: Int
) -> Mask:
    """Mask ``(B,)`` of the blocks whose objective is better than before the moves.

    Totals are compared if the objective has values of parts. A metric cannot be measured on a graph: there,
    undoing the moves, each on its own, must make things worse in total.
    """
    if objective.of_parts is not None:
        now, then = (
            part_sums(block, objective.of_parts(graph, labels), graph.n_blocks) for labels in (after, before)
        )
        better: Mask = now < then
        return better
    back = objective.changes(graph, after, frozen_int(moves.cells), frozen_int(moves.own))
    return part_sums(block[moves.own], back, graph.n_blocks) > 0.0


def _holds(members: Int, size: int) -> Mask:
    """Mask ``(size,)`` of the numbers that are among ``members``."""
    found: Mask = np.zeros(size, bool)
    found[members] = True
    return found
