"""Build connected levels by a direct k-way partition of each connected component."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from agglo_core.agglomeration.goals import CountGoal, Goal, SizeGoal, apportion
from agglo_core.agglomeration.levels.polishing import PostPass
from agglo_core.agglomeration.levels.recursion import grow, note_oversized
from agglo_core.agglomeration.run import Run
from agglo_core.arrays import Int, UInt64, frozen_float, frozen_int
from agglo_core.graph import Graph
from agglo_core.hierarchy import by_first_cell
from agglo_core.progress import Notify, phase
from agglo_core.protocols import Target


def kway_levels(graph: Graph, goals: Sequence[Goal], nested: bool, run: Run, post: PostPass) -> list[Int]:
    """Compute the levels by direct k-way partitions, and return their labels, finest first.

    Nested hierarchies are built bottom-up: each level partitions the previous level's dual graph. Otherwise
    every level partitions the fine graph. If the partitioner declares ``final_parts``, its partitions are
    neither refined nor polished.
    """
    post = replace(post, polish=post.polish and not run.final_parts)
    result: list[Int] = []
    own_post = post
    current, fine_to_current = graph, frozen_int(np.arange(graph.n))
    for stage, goal in enumerate(goals):
        own = run.on_level(stage, len(goals))
        labels = _one_level(current, goal.estimate(graph), goal, own, stage)
        labels = own_post.apply(current, current.components(), labels, goal, own, stage)
        result.append(by_first_cell(labels[fine_to_current]))
        if nested and stage + 1 < len(goals):
            fine_to_current = result[-1]
            current = graph.coarsen(fine_to_current)
            own_post = replace(post, rules=post.rules and post.rules.via(fine_to_current))
    return result


def _one_level(graph: Graph, parts: int, goal: Goal, run: Run, stage: int) -> Int:
    """Compute one level: partition each component, refine, repair, and split parts that are too large."""
    # 1. Number of parts of each connected component.
    pieces, cells = graph.split(graph.components())
    count = goal if isinstance(goal, CountGoal) else CountGoal(parts, exact=False)
    quotas = count.shares(frozen_float(np.bincount(pieces.block_ids, pieces.mass)), pieces.sizes)
    parts = int(quotas.sum())
    # 2. Partition the components, refine the partition, and connect its parts.
    seeds, statistics = run.seeds(stage, pieces.n_blocks), run.statistics
    with statistics.timed("partition"), phase(run.progress, "partitioning") as notify:
        local = _partition_components(pieces, quotas, goal, run, seeds, notify)
    if not run.final_parts:
        target = Target(parts=parts, h_star=goal.target.h_star)
        with statistics.timed("refine"):
            local = run.refine(pieces, local, seeds, target)
    with statistics.timed("fix"):
        local = run.fix(pieces, local)
    # 3. Number the parts through all components.
    counts = frozen_int(np.maximum.reduceat(local, pieces.offsets[:-1]) + 1)
    first = np.cumsum(counts) - counts
    labels = np.empty(graph.n, np.int64)
    labels[cells] = local + np.repeat(first, np.diff(pieces.offsets))
    # 4. Bisect the parts that miss the goal.
    return _finish(graph, frozen_int(labels), quotas, counts, goal, run, stage)


def _partition_components(
    pieces: Graph, quotas: Int, goal: Goal, run: Run, seeds: UInt64, notify: Notify
) -> Int:
    """Partition each component into its quota of parts, numbered from 0 in each component."""
    local = np.zeros(pieces.n, np.int64)
    own_count = run.final_parts and isinstance(goal, SizeGoal)  # else a component with quota 1 is a part
    for b in np.flatnonzero((pieces.sizes if own_count else quotas) > 1):
        nodes = slice(int(pieces.offsets[b]), int(pieces.offsets[b + 1]))
        target = Target(parts=int(quotas[b]), h_star=goal.target.h_star)
        local[nodes] = run.partition(pieces[int(b)], target, int(seeds[b]))
        notify(nodes.stop / pieces.n, f"{b + 1:,} of {pieces.n_blocks:,} components")
    return frozen_int(local)


def _finish(graph: Graph, labels: Int, quotas: Int, counts: Int, goal: Goal, run: Run, stage: int) -> Int:
    """Bisect parts that are too large, or further parts until the exact count is reached."""
    if not isinstance(goal, SizeGoal):
        if (counts == quotas).all():
            return labels
        goal = replace(goal, quotas=_apportion_quotas(graph, labels, quotas, counts))
    tree, leaves = grow(graph, labels, goal, run, stage)
    note_oversized(tree, leaves, goal, run)
    return tree.labels(leaves)


def _apportion_quotas(graph: Graph, labels: Int, quotas: Int, counts: Int) -> Int:
    """Return the number of pieces into which each part must be split to reach the exact count.

    Component c has ``counts[c]`` parts and must reach its quota.
    """
    measures = frozen_float(np.bincount(labels, graph.mass))
    cells = frozen_int(np.bincount(labels))
    stops = np.cumsum(counts)
    shares = [
        apportion(int(quota), measures[stop - count : stop], cells[stop - count : stop])
        for quota, count, stop in zip(quotas, counts, stops, strict=True)
        if count < quota
    ]
    result = np.ones(len(measures), np.int64)
    if shares:
        result[np.repeat(counts < quotas, counts)] = np.concatenate(shares)
    return frozen_int(result)
