"""The search for round parts on one graph: anneal, cut what is too wide, dissolve what is poor, polish."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agglo_core.anneal.annealed_parts import Annealing, Shapes, Weights, too_wide
from agglo_core.anneal.rounds import Ramps, shared_out
from agglo_core.anneal.start_parts import cut_in_two, dissolved, dissolved_together
from agglo_core.arrays import Float, Int, Mask, frozen_int, splitmix
from agglo_core.graph import Graph
from agglo_core.progress import TimeLimit


@dataclass(frozen=True)
class Effort:
    """How much is done.

    Attributes
    ----------
    moves, polish : int
        Draws for each cell at first, and with true circles at last; fewer on larger meshes.
    tries : int
        How many parts are dissolved in turn, on meshes of up to 1,536 cells; on larger ones one of
        each two dozen at a time, as often.
    sizes : int
        How many sizes are tried where the number of parts is given; of larger meshes half as many.
    """

    moves: int
    polish: int
    tries: int = 0
    sizes: int = 1


EFFORTS = {"fast": Effort(250, 30), "good": Effort(1200, 300, 4, 3), "best": Effort(3000, 1500, 16, 5)}
"""By name: below .02, about .1 and below 1 s for 300 cells."""

_FIRST = Ramps(0.5, 1e-3, 40.0, 400.0)
"""A hot start with a stiff penalty, so that few parts fit; a cold or soft one jams."""

_AGAIN = Ramps(0.1, 1e-3, 160.0, 400.0)
_LAST = Ramps(0.02, 1e-3, 400.0, 400.0)
_NEVER = 1e7
"""Penalty that no move overcomes."""

_TAIL = 0.35
"""Share of the draws after parts were cut or dissolved."""

_NEAR = 24
"""On larger meshes a part of each so many may be dissolved at the same time."""

_MANY = 1536
_FEWER = 0.25
"""On meshes of more cells there are fewer draws for each, by the ratio to this power."""

_POLISH = 350
"""And at most so many, before that, in the polish."""

_ROUNDS, _LATE_ROUNDS = 6, 2
_CUTS = 60


class Search:
    """Searches a graph of one connected block; labels are in the order of ``tool``.

    Parameters
    ----------
    graph : Graph
    size : float
        Largest diameter of a part, or the one that scores refer to.
    seed : int
    effort : Effort
    weights : Weights
    limit : TimeLimit
        Once it is over nothing more is tried.
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
        """How many sizes are to be tried."""
        few = self.tool.graph.n <= 2 * _MANY
        return self._effort.sizes if few else max(1, self._effort.sizes // 2)

    def annealed(self, labels: Int, ramps: Ramps = _FIRST, share: float = 1.0) -> tuple[Int, Shapes]:
        """Labels after a share of the draws, and the shapes as the fast kernel sees them."""
        draws = share * self._moves
        return self.tool.annealed(labels, self.size, ramps, draws, *self._rest())

    def cooled(self, labels: Int) -> tuple[Int, Shapes]:
        """Labels after draws that mend parts of many cells each, which were found on a coarser graph."""
        ramps = _AGAIN.for_cells(len(labels) / (int(labels.max()) + 1))
        return self.tool.annealed(labels, self.size, ramps, self._polish, *self._rest())

    def fitted(self, labels: Int) -> tuple[Int, Shapes]:
        """Labels annealed again and again, with parts that were too wide cut in two in between."""
        labels, shapes = self.annealed(labels)
        for _ in range(_ROUNDS if self._small else _LATE_ROUNDS):
            wide = self._wide(labels, shapes)
            if not wide.any() or self.limit.over():
                break
            labels = cut_in_two(self.tool.graph, labels, wide)
            labels, shapes = self.annealed(labels, _AGAIN, _TAIL)
        return labels, shapes

    def thinned(self, labels: Int, shapes: Shapes) -> tuple[Int, Shapes]:
        """Labels with the worst parts dissolved, one after the other, as long as the score rises."""
        if not self._small:
            return self._thinned_together(labels, shapes)
        best, failed = self._value(labels, shapes), set[int]()
        for _ in range(self._effort.tries):
            worth = shapes.widths / self.size + shapes.ratios
            left = [int(p) for p in np.argsort(worth, kind="stable") if int(p) not in failed]
            if not left or len(worth) < 2 or self.limit.over():
                break
            after, seen = self._without(labels, left[0])
            value = self._value(after, seen)
            if value > best:
                labels, shapes, best = after, seen, value
                failed.clear()
            else:
                failed.add(left[0])
        return labels, shapes

    def _thinned_together(self, labels: Int, shapes: Shapes) -> tuple[Int, Shapes]:
        """Labels with the worst part of each of many shares dissolved; what does not pay there is undone."""
        for _ in range(self._effort.tries):
            k = len(shapes.widths)
            if k < 2 * _NEAR or self.limit.over():
                break
            seed, weights, limit = self._rest()
            of_part = shared_out(self.tool.graph, labels, k, k // _NEAR, seed)
            left = dissolved_together(self.tool.graph, labels, self._poorest(shapes, of_part), of_part)
            there, fewer = np.unique(left, return_inverse=True)
            given = frozen_int(fewer), self.size, _AGAIN, _TAIL * self._moves, seed, weights, limit
            after, seen = self.tool.annealed(*given, frozen_int(of_part[there]))
            better = self._worth(after, seen, of_part[there], len(of_part)) > self._worth(
                labels, shapes, of_part, k
            )
            mixed = np.where(better[of_part[labels]], there[after], labels)
            labels = frozen_int(np.unique(mixed, return_inverse=True)[1])
            shapes = self.tool.seen(labels)
        return labels, shapes

    def _poorest(self, shapes: Shapes, of_part: Int) -> Mask:
        """Which parts ``(k,)`` are the worst of their share."""
        order = np.lexsort((shapes.widths / self.size + shapes.ratios, of_part))
        chosen = np.zeros(len(order), bool)
        chosen[order[np.unique(of_part[order], return_index=True)[1]]] = True
        return chosen

    def _worth(self, labels: Int, shapes: Shapes, of_part: Int, count: int) -> Float:
        """Mean score of the parts of each share ``(count,)``; −∞ where one is too wide."""
        own = self.weights.even * shapes.widths / self.size + self.weights.round * shapes.ratios
        own += self.weights.central * shapes.central
        own = np.where(self._wide(labels, shapes), -np.inf, own)
        parts = np.bincount(of_part, minlength=count)
        result: Float = np.bincount(of_part, own, count) / np.maximum(parts, 1)
        return result

    def polished(self, labels: Int, shapes: Shapes, *, cut: bool = True) -> tuple[Int, Shapes]:
        """Labels after the polish with true circles; with ``cut`` no part is too wide then."""
        wide = self._wide(labels, shapes)
        for _ in range(_CUTS if cut else 0):
            if not wide.any():
                break
            labels = cut_in_two(self.tool.graph, labels, wide)
            wide = self._wide(labels, self.tool.shapes(labels))
        ramps = _LAST.for_cells(len(labels) / (int(labels.max()) + 1))
        ramps = ramps._replace(soft=_NEVER, stiff=_NEVER) if cut else ramps
        return self.tool.polished(labels, self.size, ramps, self._polish, *self._rest())

    def _without(self, labels: Int, part: int) -> tuple[Int, Shapes]:
        after, shapes = self.annealed(dissolved(self.tool.graph, labels, part), _AGAIN, _TAIL)
        wide = self._wide(after, shapes)
        if wide.any():
            after, shapes = self.annealed(cut_in_two(self.tool.graph, after, wide), _AGAIN, _TAIL)
        return after, shapes

    def _value(self, labels: Int, shapes: Shapes) -> float:
        return -np.inf if self._wide(labels, shapes).any() else shapes.score(self.weights)

    def _wide(self, labels: Int, shapes: Shapes) -> Mask:
        return too_wide(shapes, labels, self.size)

    def _rest(self) -> tuple[int, Weights, TimeLimit]:
        """Another seed, and what stays the same."""
        self._seed = splitmix(self._seed)
        return int(self._seed[0]), self.weights, self.limit
