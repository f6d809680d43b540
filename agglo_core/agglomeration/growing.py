"""Recursions that the bisector makes by itself: what it returns is checked once a level, not once a depth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np

from agglo_core.agglomeration.goals import CountGoal, Goal, SizeGoal
from agglo_core.agglomeration.growth import Growth, GrowthToSize
from agglo_core.agglomeration.polishing import PostPass
from agglo_core.agglomeration.run import Run
from agglo_core.arrays import Int, frozen_float, frozen_int
from agglo_core.errors import PluginError
from agglo_core.graph import Graph
from agglo_core.progress import phase
from agglo_core.registry.attribution import attributed


def grown_levels(graph: Graph, goals: Sequence[Goal], run: Run, post: PostPass) -> list[Int] | None:
    """Labels of each coarse level, finest first; None if the bisector wants to be asked depth by depth.

    The coarsest goes first, the parts of one level being the pieces that the next starts from.
    """
    if any(run.for_target(goal.target) is not run for goal in goals):
        return None
    labels = graph.components()
    growth = run.growth(graph, labels)
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


def _restarted(graph: Graph, pieces: Int, growth: Growth | None, run: Run) -> Growth | None:
    """Growth of other pieces than those of the last call."""
    restart = getattr(growth, "restart", None)
    if restart is None:
        return run.growth(graph, pieces)
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
    """Labels of the parts of a level; unless ``tested``, somebody else is to test their connections."""
    seeds = run.seeds(stage, int(labels.max()) + 1)
    with run.statistics.timed("grow"), phase(run.progress, "agglomerating") as tell:
        if isinstance(goal, CountGoal):
            return run.grow(graph, labels, growth, _quotas(graph, labels, goal), seeds, tell, tested=tested)
        to_size = cast(GrowthToSize, growth)  # ``_serves`` has seen to it
        return run.grow_to_size(graph, labels, to_size, goal.limit, seeds, tell, tested=tested)


def _quotas(graph: Graph, labels: Int, goal: CountGoal) -> Int:
    if not labels.any():  # one piece: a connected mesh, most of the time
        return goal.shares(frozen_float([graph.mass.sum()]), frozen_int([graph.n]))
    return goal.shares(frozen_float(np.bincount(labels, graph.mass)), frozen_int(np.bincount(labels)))
