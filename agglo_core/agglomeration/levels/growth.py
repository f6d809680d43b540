"""Growth: all splits of a run made by the bisector in one call.

A bisector that has ``grow`` splits pieces again and again by itself, refined and fixed. What it returns is
checked once a level instead of once a depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np

from agglo_core.agglomeration.border import checked_sizes, checked_split
from agglo_core.agglomeration.goals import CountGoal, Goal, SizeGoal
from agglo_core.agglomeration.levels.polishing import PostPass
from agglo_core.agglomeration.run import Run
from agglo_core.arrays import Int, UInt64, frozen_float, frozen_int
from agglo_core.errors import PluginError
from agglo_core.graph import Graph
from agglo_core.progress import Tell, phase
from agglo_core.registry.attribution import attributed


class Growth(Protocol):
    """Pieces of a graph that are split again and again."""

    def split(self, quotas: Int, seeds: UInt64, tell: Tell) -> tuple[Int, Int]:
        """Split piece i, with the seed ``seeds[i]``, into ``quotas[i]`` connected pieces.

        Returns the new labels ``(n,)``, numbered by first node, which are the pieces of the next call; and
        for each depth the pieces split, the cells in them and the pieces that had to be mended,
        ``(depths, 3)``.
        ``tell`` is called with the share of the work that is done, and a text.
        """


@runtime_checkable
class GrowthToSize(Growth, Protocol):
    """Optional: growth that also stops at a size."""

    def split_to_size(self, limit: float, seeds: UInt64, tell: Tell) -> tuple[Int, Int]:
        """Split the pieces until none but single cells is wider than ``limit``; returns as ``split``."""


@runtime_checkable
class RestartedGrowth(Growth, Protocol):
    """Optional: growth that goes on from other pieces of its graph, and need not be made anew."""

    def restart(self, pieces: Int) -> None:
        """Let the connected ``pieces (n,)`` be those that the next call splits."""


@runtime_checkable
class Growing(Protocol):
    """Optional: a bisector that makes all splits of a run by itself, fixed and refined."""

    def grow(self, graph: Graph, pieces: Int, refiners: Sequence[Any], fixer: Any) -> Growth | None:
        """Growth of the connected ``pieces (n,)``, or None: then the driver asks depth by depth.

        The parts must be as good as those that ``bisect_level``, the refiners and the fixer make together; a
        bisector that cannot do what these components do returns None.
        """


def grown_levels(graph: Graph, goals: Sequence[Goal], run: Run, post: PostPass) -> list[Int] | None:
    """Labels of each coarse level, finest first; None if the bisector does not serve these goals.

    The coarsest goes first, the parts of one level being the pieces that the next starts from.
    """
    if any(run.for_target(goal.target) is not run for goal in goals):
        return None
    labels = graph.components()
    growth = _offered(graph, labels, run)
    if growth is None or not all(_serves(growth, goal) for goal in goals):
        return None
    result: list[Int] = []
    for stage, goal in enumerate(reversed(goals)):
        own = run.on_level(stage, len(goals))
        if stage and post.active:
            growth = _restarted(graph, labels, growth, own)
        if growth is None:
            raise PluginError(f"{run.bisector.title} grew one level of the run, and declines the next")
        parts = _split(graph, labels, goal, growth, own, stage, tested=not post.polish)
        if stage == len(goals) - 1:
            growth = None  # its arrays make room
        labels = post.apply(graph, labels, parts, goal, own, stage, tested=not post.polish)
        result.append(labels)
    return result[::-1]


def _offered(graph: Graph, pieces: Int, run: Run) -> Growth | None:
    """Growth that the bisector offers for the connected ``pieces (n,)`` and the components of the run."""
    if not run.bisector.offers("grow"):
        return None
    tool, refiners = run.bisector.tool, [member.tool for member in run.refiners]
    with attributed(run.bisector.title):
        made: Growth | None = tool.grow(graph, pieces, refiners, run.fixer.tool)
    return made


def _restarted(graph: Graph, pieces: Int, growth: Growth | None, run: Run) -> Growth | None:
    """Growth of other pieces than those of the last call."""
    restart = getattr(growth, "restart", None)
    if restart is None:
        return _offered(graph, pieces, run)
    with attributed(run.bisector.title):
        restart(pieces)
    return growth


def _serves(growth: Growth, goal: Goal) -> bool:
    if isinstance(goal, SizeGoal):
        return callable(getattr(growth, "split_to_size", None))
    return goal.quotas is None


def _split(
    graph: Graph, labels: Int, goal: Goal, growth: Growth, run: Run, stage: int, *, tested: bool
) -> Int:
    """Labels ``(n,)`` of the connected parts of a level.

    If ``tested`` is False, connections and widths are not checked: the polish that follows does so.
    """
    seeds, owner = run.seeds(stage, int(labels.max()) + 1), run.bisector
    with run.statistics.timed("grow"), phase(run.progress, "agglomerating") as tell:
        if isinstance(goal, CountGoal):
            quotas = _quotas(graph, labels, goal)
            with attributed(owner.title):
                given, depths = growth.split(quotas, seeds, tell)
            parts = checked_split(owner, graph, labels, quotas, given, tested=tested)
        else:
            to_size = cast(GrowthToSize, growth)  # ``_serves`` has seen to it
            with attributed(owner.title):
                given, depths = to_size.split_to_size(goal.limit, seeds, tell)
            parts = checked_sizes(owner, graph, labels, given, tested=tested)
            if tested:
                run.note_widths(parts, graph.wide_parts(parts, goal.limit), goal.limit)
        run.count_depths(depths)
    return parts


def _quotas(graph: Graph, labels: Int, goal: CountGoal) -> Int:
    if not labels.any():  # one piece: a connected mesh, most of the time
        return goal.shares(frozen_float([graph.mass.sum()]), frozen_int([graph.n]))
    return goal.shares(frozen_float(np.bincount(labels, graph.mass)), frozen_int(np.bincount(labels)))
