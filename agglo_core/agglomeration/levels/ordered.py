"""The levels of a run, found with the cells along a curve: neighbours are near in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from agglo_core.agglomeration.goals import Goal
from agglo_core.agglomeration.levels.kway import kway_levels
from agglo_core.agglomeration.levels.polishing import PostPass
from agglo_core.agglomeration.levels.recursion import recursive_levels
from agglo_core.agglomeration.run import Run
from agglo_core.arrays import Int, frozen_index, frozen_int, trusted_copy
from agglo_core.graph import Graph
from agglo_core.graph.ordering import curve_order
from agglo_core.progress import phase


def ordered_levels(
    graph: Graph, goals: Sequence[Goal], run: Run, post: PostPass, *, kway: bool, nested: bool
) -> list[Int]:
    """Labels ``(n,)`` of each level, finest first, numbered by first cell."""
    with run.statistics.timed("order"), phase(run.progress, "ordering the cells"):
        order = curve_order(graph.centroids)
        ordered = graph.subgraph(order, frozen_int([0, graph.n]))
        if any(goal.limit < np.inf for goal in goals):  # otherwise nobody asks for points, but may
            ordered = _with_points_as_met(ordered)
        if post.rules is not None:
            place = np.empty(graph.n, np.int64)
            place[order] = np.arange(graph.n)
            post = replace(post, rules=post.rules.via(place))
    levels = _levels(ordered, goals, run, post, kway=kway, nested=nested)
    return [_by_first_cell(labels, order) for labels in levels]


def _by_first_cell(labels: Int, order: Int) -> Int:
    """Labels of the cells ``order``, given for each of its places and numbered by first cell."""
    from agglo_core.compiled.graphs import numbered_as_met

    given = np.empty(len(order), np.int32)
    given[order] = labels.astype(np.int32)  # as it is, each label would be converted by itself
    return frozen_int(numbered_as_met(frozen_index(given), int(labels.max()) + 1)[0])


def _with_points_as_met(graph: Graph) -> Graph:
    """The graph with its points in the order in which the cells have them: near in memory, too."""
    from agglo_core.compiled.graphs import numbered_as_met

    vertices, points = numbered_as_met(graph.vertices, len(graph.points))
    made = trusted_copy(graph, vertices=frozen_index(vertices), points=graph.points.take(points, axis=0))
    return made.with_loads(graph.loads)


def _levels(
    graph: Graph, goals: Sequence[Goal], run: Run, post: PostPass, *, kway: bool, nested: bool
) -> list[Int]:
    """Levels by direct partitions, by one nested recursion, or each level on its own."""
    if kway:
        return kway_levels(graph, goals, nested, run, post)
    if nested:
        return recursive_levels(graph, goals, run, post)
    return [
        recursive_levels(graph, [goal], run.on_level(place, len(goals)), post)[0]
        for place, goal in enumerate(goals)
    ]
