"""Search for good k-way partitions: effort, objective, time limit and balance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from agglo_core.anneal.annealed_parts import ROUNDING
from agglo_core.anneal.round_parts import round_parts
from agglo_core.anneal.solver_parts import solver_parts
from agglo_core.anneal.start_parts import Rival, Start, partition_by_bisection
from agglo_core.arrays import Int, frozen_int, splitmix
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.progress import TimeLimit, checked_seconds
from agglo_core.protocols import Target
from agglo_core.refine.part_sizes import FREE, Balance, check_size, check_tolerance


@dataclass(frozen=True)
class PartSearch:
    """Search for good partitions of connected graphs by simulated annealing.

    Attributes
    ----------
    effort : {"quick", "fast", "good", "best"}
    objective : {"solver", "roundness"}
        Small moments of inertia and short interfaces for solvers, or round parts with even widths.
    seconds : float, optional
        Wall-clock time limit for the search on a connected graph.
    balance : Balance
        Required evenness of part sizes, for solvers and part counts only.

    Examples
    --------
    >>> from agglo_core.anneal.part_search import PartSearch
    >>> PartSearch.checked("mine", "fast", "roundness").objective
    'roundness'
    >>> PartSearch.checked("mine", "most", "roundness")
    Traceback (most recent call last):
        ...
    agglo_core.errors.OptionError: mine: effort must be quick, fast, good or best, given 'most'
    """

    effort: Literal["quick", "fast", "good", "best"]
    objective: Literal["solver", "roundness"] = "solver"
    seconds: float | None = None
    balance: Balance = FREE

    @classmethod
    def checked(
        cls,
        owner: str,
        effort: object,
        objective: object,
        seconds: object = None,
        balance: Any = None,
        size: str | None = None,
    ) -> PartSearch | None:
        """Create the search from a component's options, or return None if no effort is given.

        Raises
        ------
        OptionError
            If an option is unknown or contradicts another option.
        """
        if effort not in (None, "quick", "fast", "good", "best"):
            raise OptionError(f"{owner}: effort must be quick, fast, good or best, given {effort!r}")
        if objective not in ("solver", "roundness"):
            raise OptionError(f"{owner}: objective must be solver or roundness, given {objective!r}")
        limit = checked_seconds(owner, seconds)
        part_balance, kind = FREE, check_size(owner, size)
        if balance is not None:
            part_balance = Balance(check_tolerance(owner, balance, "balance"), kind)
        if effort is None and (limit is not None or objective == "roundness" or part_balance.bounded):
            raise OptionError(
                f"{owner}: objective, seconds and balance require an effort (quick, fast, good or best), "
                "but none is given"
            )
        if part_balance.bounded and objective == "roundness":
            raise OptionError(f"{owner}: balance requires the objective solver, not roundness")
        return None if effort is None else cls(effort, objective, limit, part_balance)

    def parts(
        self, graph: Graph, target: Target, seed: int, start: Start, rival: Rival = partition_by_bisection
    ) -> Int:
        """Partition a connected one-block graph into connected parts that meet the target.

        Returns the labels ``(n,)``. With a size only single cells are wider, and the part count is free.
        With a count the number of parts is exact. Without a better result the labels of ``rival`` are
        returned. For solvers the better of both is annealed, and with a size fewer parts are better.

        Parameters
        ----------
        graph : Graph
        target : Target
            With a size, its count is at most a guess.
        seed : int
        start : callable
            ``start(graph, k)`` returns labels for about k parts, connected or not.
        rival : callable
            ``rival(graph, target)`` returns labels for connected parts that meet the target. Default:
            inertial bisections.
        """
        limit = TimeLimit(self.seconds)
        if target.h_star is not None and self.balance.bounded:
            raise OptionError(
                "balance applies to a number of parts (n_parts, cells_per_part), not to a size (h_star, "
                "h_factor)"
            )
        if target.h_star is not None:
            return self._by_component(graph, target, seed, start, rival, limit)
        if (target.parts or 1) >= graph.n or (target.parts or 1) < 2:
            return frozen_int(np.arange(graph.n) if (target.parts or 1) > 1 else np.zeros(graph.n))
        return self._found(graph, target, seed, start, rival, limit)

    def _found(
        self, graph: Graph, target: Target, seed: int, start: Start, rival: Rival, limit: TimeLimit
    ) -> Int:
        given = graph, target, seed, self.effort, start, rival, limit
        return round_parts(*given) if self.objective == "roundness" else solver_parts(*given, self.balance)

    def _by_component(
        self, graph: Graph, target: Target, seed: int, start: Start, rival: Rival, limit: TimeLimit
    ) -> Int:
        """Search parts for a size target in each connected component of the cells narrower than it."""
        # 1. Separate wide cells, and split the rest into components.
        size = float(target.h_star or 0.0) * (1 + ROUNDING)
        wide = graph.part_diameters(np.arange(graph.n)) > size
        rows = np.repeat(wide, np.diff(graph.indptr))
        pieces, cells = graph.split(graph.without_edges(rows | wide[graph.indices]).components())
        # 2. Search each component that exceeds the size, and number the parts.
        fits = pieces.diameters() <= size
        seeds = splitmix(np.uint64(seed) + np.arange(pieces.n_blocks, dtype=np.uint64))
        labels, count = np.empty(graph.n, np.int64), 0
        for b in range(pieces.n_blocks):
            span = slice(int(pieces.offsets[b]), int(pieces.offsets[b + 1]))
            if fits[b] or pieces.sizes[b] == 1:
                labels[cells[span]] = count
            else:
                parts = self._found(pieces[b], target, int(seeds[b]), start, rival, limit)
                labels[cells[span]] = count + parts
            count = int(labels[cells[span]].max()) + 1
        return frozen_int(labels)
