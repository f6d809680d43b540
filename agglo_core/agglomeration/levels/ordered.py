"""Compute the levels with the cells ordered along a space-filling curve.

In this order adjacent cells are close in memory.
"""

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
from agglo_core.graph.frame import moving_frame
from agglo_core.graph.ordering import curve_order
from agglo_core.progress import phase


def compute_levels(
    graph: Graph, goals: Sequence[Goal], run: Run, post: PostPass, *, kway: bool, nested: bool
) -> list[Int]:
    """Order the cells along a space-filling curve, compute the levels, and return their labels ``(n,)``.

    The finest level comes first. Labels are numbered by first cell.
    """
    with run.statistics.timed("order"), phase(run.progress, "ordering the cells"):
        # 1. Renumber the graph along the curve.
        order = curve_order(graph.centroids, moving_frame(graph.centroids, graph.weights))
        ordered = graph.subgraph(order, frozen_int([0, graph.n]))
        if any(goal.limit < np.inf for goal in goals):  # only size goals read the points regularly
            ordered = _with_points_as_met(ordered)
        # 2. Renumber the part rules with the cells.
        if post.rules is not None:
            place = np.empty(graph.n, np.int64)
            place[order] = np.arange(graph.n)
            post = replace(post, rules=post.rules.via(place))
    # 3. Compute the levels and map their labels back to the original numbering.
    levels = _levels(ordered, goals, run, post, kway=kway, nested=nested)
    return [_by_first_cell(labels, order) for labels in levels]


def _by_first_cell(labels: Int, order: Int) -> Int:
    """Map labels of the reordered cells to the original cells, and number them by first cell."""
    from agglo_core.compiled.graphs import number_as_met

    given = np.empty(len(order), np.int32)
    given[order] = labels.astype(np.int32)  # one vectorised conversion, instead of one per label
    return frozen_int(number_as_met(frozen_index(given), int(labels.max()) + 1)[0])


def _with_points_as_met(graph: Graph) -> Graph:
    """Renumber the graph's points in the order in which the cells list them."""
    from agglo_core.compiled.graphs import number_as_met

    vertices, points = number_as_met(graph.vertices, len(graph.points))
    made = trusted_copy(graph, vertices=frozen_index(vertices), points=graph.points.take(points, axis=0))
    return made.with_loads(graph.loads)


def _levels(
    graph: Graph, goals: Sequence[Goal], run: Run, post: PostPass, *, kway: bool, nested: bool
) -> list[Int]:
    """Compute the levels by direct partitions, by one nested recursion, or each level separately."""
    if kway:
        return kway_levels(graph, goals, nested, run, post)
    if nested:
        return recursive_levels(graph, goals, run, post)
    return [
        recursive_levels(graph, [goal], run.on_level(place, len(goals)), post)[0]
        for place, goal in enumerate(goals)
    ]
