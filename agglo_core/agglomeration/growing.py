"""Recursions that the bisector makes by itself: what it returns is checked once a level, not once a depth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agglo_core.agglomeration.goals import CountGoal, Goal
from agglo_core.agglomeration.growth import Growth
from agglo_core.agglomeration.polishing import PostPass
from agglo_core.agglomeration.quotas import apportion
from agglo_core.agglomeration.run import Run
from agglo_core.arrays import Int, frozen_float, frozen_int
from agglo_core.graph import Graph
from agglo_core.progress import phase

__all__ = ["grown_levels"]


def grown_levels(graph: Graph, goals: Sequence[Goal], run: Run, post: PostPass) -> list[Int] | None:
    """Labels of each coarse level, finest first; None if the bisector wants to be asked depth by depth.

    Counts go coarsest first, the parts of one level being the pieces that the next starts from; those that
    post-passes change are pieces of a new growth.
    """
    counts = [goal for goal in reversed(goals) if isinstance(goal, CountGoal) and goal.quotas is None]
    if len(counts) < len(goals) or any(run.for_target(goal.target) is not run for goal in counts):
        return None
    labels = graph.components()
    growth: Growth | None = None
    result: list[Int] = []
    for stage, goal in enumerate(counts):
        growth = run.growth(graph, labels) if growth is None else growth
        if growth is None:
            return None
        own = run.on_level(stage, len(goals))
        parts = _split(graph, labels, goal, growth, own, stage)
        labels = post.apply(graph, labels, parts, goal, own, stage)
        if post.active:
            growth = None
        result.append(labels)
    return result[::-1]


def _split(graph: Graph, labels: Int, goal: CountGoal, growth: Growth, run: Run, stage: int) -> Int:
    measures = frozen_float(np.bincount(labels, graph.measures))
    quotas = apportion(goal.parts, measures, frozen_int(np.bincount(labels)))
    seeds = run.seeds(stage, len(quotas))
    with run.statistics.timed("grow"), phase(run.progress, "agglomerating") as tell:
        return run.grow(graph, labels, growth, quotas, seeds, tell)
