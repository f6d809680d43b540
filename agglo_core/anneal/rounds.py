"""Rounds of annealing: temperatures in turn, shares of parts for several threads, a time limit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int, label_order, splitmix
from agglo_core.graph import Graph
from agglo_core.graph.ordering import curve_order
from agglo_core.progress import TimeLimit
from agglo_core.threads import mapped, thread_count

_CELLS, _PARTS = 1536, 64
"""A share has at least so many cells, and so many parts."""

_ROUNDS = 80
"""Temperatures at most."""

_DRAWS = 300_000
"""So many draws are made before parts are shared out anew, or the time is looked at."""

_PAUSES = 4
"""So often the time is looked at where parts stay in their shares, which then stay in the cache."""

_SHARINGS = 10
"""Parts are shared out at least so often."""

_LAST_ROUNDS, _LAST_DRAWS = 8, 4.0
"""What is left to do once the time is over."""

_Make = Callable[[Any, Any, int, int, Float, Any, int], object]
"""Makes draws: room, shares, the first of them and the one after the last, rounds, seed and stamp."""


class Ramps(NamedTuple):
    """First and last temperature, first and last penalty of parts that exceed bounds; 0 for none."""

    hot: float
    cold: float
    soft: float = 0.0
    stiff: float = 0.0

    def for_cells(self, cells: float) -> Ramps:
        """Ramps for parts of so many cells: temperatures fall in proportion beyond ``_USUAL``."""
        scale = min(1.0, _USUAL / cells)
        return self._replace(hot=scale * self.hot, cold=scale * self.cold)

    def _penalties(self, count: int) -> Float:
        some = self.soft > 0.0 and self.stiff > 0.0
        return np.geomspace(self.soft, self.stiff, count) if some else np.zeros(count)

    def rounds(self, draws: float) -> Float:
        """Temperatures, penalties and draws for each cell of all rounds ``(3, R)``."""
        count = int(np.clip(draws, 1, _ROUNDS))
        hot, soft = np.geomspace(self.hot, self.cold, count), self._penalties(count)
        return frozen_float(np.stack((hot, soft, np.full(count, draws / count))))


_USUAL = 14.0
"""Cells of a part that temperatures are for: the more there are, the less one of them changes."""


def rooms_of(room: Any) -> list[Any]:
    """The room for searches, and as many like it as there are further threads."""
    return [room, *(type(room)(*(each.copy() for each in room)) for _ in range(thread_count() - 1))]


def take_turns(
    make: _Make,
    graph: Graph,
    parts: Any,
    rooms: list[Any],
    rounds: Float,
    seed: int,
    limit: TimeLimit,
    of_part: Int | None = None,
) -> None:
    """Make all rounds, with several shares at the same time; labels do not depend on the number of threads.

    Parts are shared out again and again unless the share of each, ``of_part``, is given. Where the time is
    over few draws bring what there is to rest; where it was before there are none.
    """
    n, k, done, stamp = len(parts.labels), len(parts.tally), 0, 0
    seeds, count = np.array([seed], np.uint64), max(1, min(n // _CELLS, k // _PARTS))
    most = rounds.shape[1] if count == 1 else max(1, rounds.shape[1] // _SHARINGS)
    at_once = int(np.clip(_DRAWS / (n * rounds[2, 0]), 1, most))
    at_once = at_once if of_part is None else -(-rounds.shape[1] // _PAUSES)
    while done < rounds.shape[1]:
        if done == 0 and limit.over():
            return
        if limit.over():
            rounds, done = _ending(rounds[:, done:]), 0
            at_once, limit = rounds.shape[1], TimeLimit()
        now, seeds = frozen_float(rounds[:, done : done + at_once]), splitmix(seeds)
        labels = frozen_int(parts.labels)
        shares = _shares(
            labels, shared_out(graph, labels, k, count, int(seeds[0])) if of_part is None else of_part
        )
        _share_out(make, shares, rooms, now, np.uint64(seeds[0]), stamp)
        stamp += n * int(np.sum(np.floor(now[2]) + 1))
        done += at_once


def _ending(rounds: Float) -> Float:
    """A few of the rounds, the last included, with few draws."""
    chosen = np.unique(np.linspace(0, rounds.shape[1] - 1, _LAST_ROUNDS).round().astype(np.int64))
    few = rounds[:, chosen].copy()
    few[2] = np.minimum(few[2], _LAST_DRAWS)
    return few


def _share_out(make: _Make, shares: Any, rooms: list[Any], rounds: Float, seed: Any, stamp: int) -> None:
    count = len(shares.starts) - 1
    if len(rooms) == 1 or count < len(rooms):
        make(rooms[0], shares, 0, count, rounds, seed, stamp)
        return
    cuts = (count * np.arange(len(rooms) + 1) // len(rooms)).tolist()

    def own(room: Any, start: int, stop: int) -> None:
        make(room, shares, start, stop, rounds, seed, stamp)

    list(mapped(own, rooms, cuts[:-1], cuts[1:]))


def shared_out(graph: Graph, labels: Int, k: int, count: int, seed: int) -> Int:
    """The share ``(k,)`` of each part: ``count`` shares by place, along a curve turned by the seed."""
    if count == 1:
        return frozen_int(np.zeros(k))
    cells = np.bincount(labels, minlength=k)
    centres = np.stack([np.bincount(labels, x, k) / cells for x in graph.centroids.T], axis=1)
    turned = np.linalg.qr(np.random.default_rng(seed).normal(size=(graph.dim, graph.dim)))[0]
    order = curve_order(frozen_float(centres @ turned))
    result = np.empty(k, np.int64)
    result[order] = (np.cumsum(cells[order]) - 0.5 * cells[order]) * count // len(labels)
    return frozen_int(result)


def _shares(labels: Int, of_part: Int) -> Any:
    """Cells share by share."""
    from agglo_core.anneal.state import Shares

    each = frozen_int(of_part[labels])
    starts = np.concatenate(([0], np.cumsum(np.bincount(each, minlength=int(of_part.max()) + 1))))
    return Shares(label_order(each).astype(np.int32), starts, of_part.astype(np.int32))
