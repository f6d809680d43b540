"""Rounds of simulated annealing: decreasing temperatures, part groups for threads, a time limit."""

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
"""Minimum number of cells, and of parts, in a share.

Smaller shares keep more threads busy, but more parts cannot trade cells with a neighbour in another share
(benchmarks/roundness.py --large).
"""

_ROUNDS = 80
"""Maximum number of temperatures. More cool more evenly, with fewer draws at each (benchmarks/roundness.py).
"""

_DRAWS = 300_000
"""Number of draws between two divisions into shares, or two time checks.

Fewer draws cost more divisions, more draws exceed a time limit further (benchmarks/roundness.py --large).
"""

_PAUSES = 4
"""Number of time checks when parts stay in their shares, which then stay in the cache. More are slower
(benchmarks/roundness.py --large)."""

_SHARINGS = 10
"""Minimum number of divisions into shares. Fewer leave the borders of shares visible in the parts
(benchmarks/roundness.py --large)."""

_LAST_ROUNDS, _LAST_DRAWS = 8, 4.0
"""Maximum number of rounds, and of draws per cell and round, after the time limit.

More bring the parts closer to rest, and exceed the limit further.
"""

_Make = Callable[[Any, Any, int, int, Float, Any, int], object]
"""Makes draws: workspace, shares, first share and last share plus 1, rounds, seed and stamp."""


class Ramps(NamedTuple):
    """First and last temperature of a run, first and last penalty for violated bounds (0 for none)."""

    hot: float
    cold: float
    soft: float = 0.0
    stiff: float = 0.0

    def for_cells(self, cells: float) -> Ramps:
        """Return ramps for ``cells`` cells per part: temperatures are lower beyond ``_USUAL`` cells."""
        scale = min(1.0, _USUAL / cells)
        return self._replace(hot=scale * self.hot, cold=scale * self.cold)

    def _penalties(self, count: int) -> Float:
        some = self.soft > 0.0 and self.stiff > 0.0
        return np.geomspace(self.soft, self.stiff, count) if some else np.zeros(count)

    def rounds(self, draws: float) -> Float:
        """Return temperatures, penalties and draws per cell for all rounds ``(3, R)``."""
        count = int(np.clip(draws, 1, _ROUNDS))
        hot, soft = np.geomspace(self.hot, self.cold, count), self._penalties(count)
        return frozen_float(np.stack((hot, soft, np.full(count, draws / count))))


_USUAL = 14.0
"""Cells per part for which the temperatures are tuned. In larger parts a single cell changes less
(benchmarks/roundness.py, brain)."""


def rooms_of(room: Any) -> list[Any]:
    """Return the workspace for searches, and one copy for each further thread."""
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
    """Run all annealing rounds, with disjoint groups of parts (shares) in parallel.

    The labels do not depend on the thread count. Parts are divided into shares repeatedly, unless the share
    of each part, ``of_part``, is given. After the time limit, few draws bring the parts to rest. If the limit
    is over before the first round, nothing is drawn.
    """
    # 1. Number of shares, and of rounds between two divisions.
    n, k, n_rounds, stamp = len(parts.labels), len(parts.tally), 0, 0
    seeds, count = np.array([seed], np.uint64), max(1, min(n // _CELLS, k // _PARTS))
    most = rounds.shape[1] if count == 1 else max(1, rounds.shape[1] // _SHARINGS)
    batch_size = int(np.clip(_DRAWS / (n * rounds[2, 0]), 1, most))
    batch_size = batch_size if of_part is None else -(-rounds.shape[1] // _PAUSES)
    while n_rounds < rounds.shape[1]:
        # 2. At the time limit, replace the remaining rounds by a short ending.
        if n_rounds == 0 and limit.over():
            return
        if limit.over():
            rounds, n_rounds = _select_rounds(rounds[:, n_rounds:]), 0
            batch_size, limit = rounds.shape[1], TimeLimit()
        # 3. Divide into shares, and run some rounds in all threads.
        batch, seeds = frozen_float(rounds[:, n_rounds : n_rounds + batch_size]), splitmix(seeds)
        labels = frozen_int(parts.labels)
        shares = _shares(
            labels, divide_into_shares(graph, labels, k, count, int(seeds[0])) if of_part is None else of_part
        )
        _share_out(make, shares, rooms, batch, np.uint64(seeds[0]), stamp)
        stamp += n * int(np.sum(np.floor(batch[2]) + 1))
        n_rounds += batch_size


def _select_rounds(rounds: Float) -> Float:
    """Select a few of the remaining rounds, including the last, with few draws each."""
    chosen = np.unique(np.linspace(0, rounds.shape[1] - 1, _LAST_ROUNDS).round().astype(np.int64))
    few = rounds[:, chosen].copy()
    few[2] = np.minimum(few[2], _LAST_DRAWS)
    return few


def _share_out(make: _Make, shares: Any, workspaces: list[Any], rounds: Float, seed: Any, stamp: int) -> None:
    count = len(shares.starts) - 1
    if len(workspaces) == 1 or count < len(workspaces):
        make(workspaces[0], shares, 0, count, rounds, seed, stamp)
        return
    cuts = (count * np.arange(len(workspaces) + 1) // len(workspaces)).tolist()

    def make_shares(workspace: Any, start: int, stop: int) -> None:
        make(workspace, shares, start, stop, rounds, seed, stamp)

    list(mapped(make_shares, workspaces, cuts[:-1], cuts[1:]))


def divide_into_shares(graph: Graph, labels: Int, k: int, count: int, seed: int) -> Int:
    """Divide the parts into ``count`` groups (shares) along a randomly oriented curve: ``(k,)``."""
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
    """Return the cells sorted by share, the group of parts to which their part belongs."""
    from agglo_core.anneal.state import Shares

    each = frozen_int(of_part[labels])
    starts = np.concatenate(([0], np.cumsum(np.bincount(each, minlength=int(of_part.max()) + 1))))
    return Shares(label_order(each).astype(np.int32), starts, of_part.astype(np.int32))
