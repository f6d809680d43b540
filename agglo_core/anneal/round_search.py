"""Search for round parts on one graph: anneal, cut wide parts, dissolve poor parts, polish."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agglo_core.anneal.annealed_parts import Annealing, Shapes, Weights, too_wide
from agglo_core.anneal.rounds import Ramps, divide_into_shares
from agglo_core.anneal.start_parts import cut_in_two, dissolve_part, dissolve_parts
from agglo_core.arrays import Float, Int, Mask, frozen_int, splitmix
from agglo_core.graph import Graph
from agglo_core.progress import TimeLimit


@dataclass(frozen=True)
class Effort:
    """Work that a search may do: draws per cell, and trial counts.

    Attributes
    ----------
    moves, polish : int
        Draws per cell, in the first annealing and in the polish with true circles. Larger meshes get fewer.
    tries : int
        Number of parts dissolved one after the other, on meshes with up to 1,536 cells. On larger meshes,
        number of rounds that dissolve one in 24 parts at a time.
    sizes : int
        Number of sizes tried for a given part count. Larger meshes try half as many.
    """

    moves: int
    polish: int
    tries: int = 0
    sizes: int = 1


EFFORTS = {
    "quick": Effort(30, 10),
    "fast": Effort(250, 30),
    "good": Effort(1200, 300, 4, 3),
    "best": Effort(3000, 1500, 16, 5),
}
"""By name: below 0.01 s, below 0.02 s, about 0.1 s and below 1 s for 300 cells (benchmarks/roundness.py)."""

_FIRST = Ramps(0.5, 1e-3, 40.0, 400.0)
"""Temperatures, in units of the part score, and penalties, in scores per excess width over size.

A hot start with a stiff penalty, so that few parts fit. A cold or soft start gets stuck
(benchmarks/roundness.py).
"""

_AGAIN = Ramps(0.1, 1e-3, 160.0, 400.0)
"""After parts were cut or dissolved, or found on a graph of pieces: warm enough for these parts and their
neighbours to change, too cold to lose the other parts (benchmarks/roundness.py)."""

_LAST = Ramps(0.02, 1e-3, 400.0, 400.0)
"""In the polish: almost only moves that improve the parts (benchmarks/roundness.py)."""

_NEVER = 1e7
"""Penalty, in scores per excess width over size, that prevents all violating moves."""

_TAIL = 0.35
"""Fraction of the draws after parts were cut or dissolved: more give rounder parts, and take longer
(benchmarks/roundness.py)."""

_NEAR = 24
"""Number of parts per simultaneously dissolved part, on larger meshes.

With fewer parts, more are dissolved per round, but their shares have less room (benchmarks/roundness.py,
meshes with 4,000 cells).
"""

_MANY = 1536
"""Number of cells above which a mesh is larger: parts are dissolved in shares, and draws per cell decrease,
which takes less time and leaves parts less round (benchmarks/roundness.py, meshes with 4,000 cells)."""

_FEWER = 0.25
"""Exponent: on larger meshes, draws per cell decrease by this power of the ratio of ``_MANY`` to the cells.
Larger is faster, with less round parts (benchmarks/roundness.py --large)."""

_POLISH = 350
"""Maximum number of draws per cell in the polish on larger meshes, before this decrease
(benchmarks/roundness.py, meshes with 4,000 cells)."""

_ROUNDS, _LATE_ROUNDS = 6, 2
"""Maximum number of times that wide parts are cut and annealed, on small and on larger meshes.

More rounds leave fewer parts to be cut in the polish, and take longer (benchmarks/roundness.py).
"""

_CUTS = 60
"""Maximum number of times that wide parts are halved before the polish, a safeguard."""


class Search:
    """Search for round parts of a connected one-block graph, with labels in the cell order of ``tool``.

    Parameters
    ----------
    graph : Graph
    size : float
        Largest diameter of a part, or the reference size of scores.
    seed : int
    effort : Effort
    weights : Weights
    limit : TimeLimit
        After it no further changes are tried.
    """

    def __init__(
        self, graph: Graph, size: float, seed: int, effort: Effort, weights: Weights, limit: TimeLimit
    ) -> None:
        self.tool, self.size, self.weights, self.limit = Annealing(graph), size, weights, limit
        self._effort, self._small = effort, graph.n <= _MANY
        share = 1.0 if self._small else (_MANY / graph.n) ** _FEWER
        polish = effort.polish if self._small else min(effort.polish, _POLISH)
        self._moves, self._polish = effort.moves * share, polish * share
        self._seed = np.array([seed], np.uint64)

    @property
    def sizes(self) -> int:
        """Number of part sizes to try for a given part count."""
        few = self.tool.graph.n <= 2 * _MANY
        return self._effort.sizes if few else max(1, self._effort.sizes // 2)

    def annealed(self, labels: Int, ramps: Ramps = _FIRST, share: float = 1.0) -> tuple[Int, Shapes]:
        """Anneal with a fraction ``share`` of the draws, and return labels and shapes."""
        draws = share * self._moves
        return self.tool.annealed(labels, self.size, ramps, draws, *self._rest())

    def cooled(self, labels: Int) -> tuple[Int, Shapes]:
        """Anneal parts with many cells each, found on a coarser graph, at low temperature."""
        ramps = _AGAIN.for_cells(len(labels) / (int(labels.max()) + 1))
        return self.tool.annealed(labels, self.size, ramps, self._polish, *self._rest())

    def fitted(self, labels: Int) -> tuple[Int, Shapes]:
        """Anneal repeatedly, and cut parts that are too wide before each new run."""
        labels, shapes = self.annealed(labels)
        for _ in range(_ROUNDS if self._small else _LATE_ROUNDS):
            wide = self._wide(labels, shapes)
            if not wide.any() or self.limit.over():
                break
            labels = cut_in_two(self.tool.graph, labels, wide)
            labels, shapes = self.annealed(labels, _AGAIN, _TAIL)
        return labels, shapes

    def thinned(self, labels: Int, shapes: Shapes) -> tuple[Int, Shapes]:
        """Dissolve the worst parts one after the other, as long as the score increases."""
        # 1. Large meshes: dissolve many parts at a time.
        if not self._small:
            return self._thinned_together(labels, shapes)
        best, failures = self._value(labels, shapes), set[int]()
        for _ in range(self._effort.tries):
            # 2. Try the worst part that has not failed since the last success.
            worth = shapes.widths / self.size + shapes.ratios
            candidates = [int(p) for p in np.argsort(worth, kind="stable") if int(p) not in failures]
            if not candidates or len(worth) < 2 or self.limit.over():
                break
            after, new_shapes = self._without(labels, candidates[0])
            value = self._value(after, new_shapes)
            if value > best:
                labels, shapes, best = after, new_shapes, value
                failures.clear()
            else:
                failures.add(candidates[0])
        return labels, shapes

    def _thinned_together(self, labels: Int, shapes: Shapes) -> tuple[Int, Shapes]:
        """Dissolve the worst part in each group of parts (share), and keep the groups that improve."""
        for _ in range(self._effort.tries):
            k = len(shapes.widths)
            if k < 2 * _NEAR or self.limit.over():
                break
            seed, weights, limit = self._rest()
            # 1. Divide the parts into shares, dissolve one part per share, and anneal.
            of_part = divide_into_shares(self.tool.graph, labels, k, k // _NEAR, seed)
            new_parts = dissolve_parts(self.tool.graph, labels, self._poorest(shapes, of_part), of_part)
            part_ids, fewer = np.unique(new_parts, return_inverse=True)
            arguments = frozen_int(fewer), self.size, _AGAIN, _TAIL * self._moves, seed, weights, limit
            after, new_shapes = self.tool.annealed(*arguments, frozen_int(of_part[part_ids]))
            # 2. Keep the new labels in the shares that improved.
            better = self._worth(after, new_shapes, of_part[part_ids], len(of_part)) > self._worth(
                labels, shapes, of_part, k
            )
            mixed = np.where(better[of_part[labels]], part_ids[after], labels)
            labels = frozen_int(np.unique(mixed, return_inverse=True)[1])
            shapes = self.tool.seen(labels)
        return labels, shapes

    def _poorest(self, shapes: Shapes, of_part: Int) -> Mask:
        """Return a mask ``(k,)`` of the worst part in each group ``of_part (k,)``."""
        order = np.lexsort((shapes.widths / self.size + shapes.ratios, of_part))
        chosen = np.zeros(len(order), bool)
        chosen[order[np.unique(of_part[order], return_index=True)[1]]] = True
        return chosen

    def _worth(self, labels: Int, shapes: Shapes, of_part: Int, count: int) -> Float:
        """Return each group's mean part score ``(count,)``, or −∞ if one of its parts is too wide."""
        scores = self.weights.even * shapes.widths / self.size + self.weights.round * shapes.ratios
        scores += self.weights.central * shapes.central
        scores = np.where(self._wide(labels, shapes), -np.inf, scores)
        parts = np.bincount(of_part, minlength=count)
        result: Float = np.bincount(of_part, scores, count) / np.maximum(parts, 1)
        return result

    def polished(self, labels: Int, shapes: Shapes, *, cut: bool = True) -> tuple[Int, Shapes]:
        """Anneal with true circles at low temperature, and with ``cut`` first cut parts that are too wide."""
        wide = self._wide(labels, shapes)
        for _ in range(_CUTS if cut else 0):
            if not wide.any():
                break
            labels = cut_in_two(self.tool.graph, labels, wide)
            wide = self._wide(labels, self.tool.shapes(labels))
        # 2. Anneal at low temperature.
        ramps = _LAST.for_cells(len(labels) / (int(labels.max()) + 1))
        ramps = ramps._replace(soft=_NEVER, stiff=_NEVER) if cut else ramps
        return self.tool.polished(labels, self.size, ramps, self._polish, *self._rest())

    def _without(self, labels: Int, part: int) -> tuple[Int, Shapes]:
        after, shapes = self.annealed(dissolve_part(self.tool.graph, labels, part), _AGAIN, _TAIL)
        wide = self._wide(after, shapes)
        if wide.any():
            after, shapes = self.annealed(cut_in_two(self.tool.graph, after, wide), _AGAIN, _TAIL)
        return after, shapes

    def _value(self, labels: Int, shapes: Shapes) -> float:
        return -np.inf if self._wide(labels, shapes).any() else shapes.score(self.weights)

    def _wide(self, labels: Int, shapes: Shapes) -> Mask:
        """Return a mask ``(k,)`` of the parts wider than the size, except single cells."""
        return too_wide(shapes, labels, self.size)

    def _rest(self) -> tuple[int, Weights, TimeLimit]:
        """Return the last arguments of an annealing run: a new seed, the weights and the time limit."""
        self._seed = splitmix(self._seed)
        return int(self._seed[0]), self.weights, self.limit
