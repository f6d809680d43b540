"""Direct k-way partitions: from one call per connected component to exact, connected levels."""

from __future__ import annotations

import numpy as np

from agglo_core.agglomeration.polishing import PostPass
from agglo_core.agglomeration.recursion import grow, note_oversized
from agglo_core.agglomeration.rules import ByDiameter, ByQuota, Rule, apportion, part_measures
from agglo_core.agglomeration.run import Crew
from agglo_core.agglomeration.targets import Levels
from agglo_core.arrays import Int, UInt64, frozen_int
from agglo_core.graph import Graph
from agglo_core.hierarchy import by_first_cell
from agglo_core.protocols import Target

__all__ = ["kway_levels"]


def kway_levels(graph: Graph, levels: Levels, nested: bool, crew: Crew, post: PostPass) -> list[Int]:
    """Labels of each level, finest first.

    Nested hierarchies are built bottom-up: each level partitions the dual graph of the one below.
    Otherwise every level partitions the fine graph on its own.
    """
    result: list[Int] = []
    current, fine_to_current = graph, frozen_int(np.arange(graph.n))
    for stage, target in enumerate(levels.sizes or levels.counts):
        size = target if levels.sizes else None
        parts = _estimate(graph, target) if levels.sizes else int(target)
        labels = _one_level(current, parts, size, crew, stage)
        labels = post.apply(current, current.components(), labels, size, crew, stage)
        result.append(by_first_cell(labels[fine_to_current]))
        if nested:
            fine_to_current = result[-1]
            current = graph.coarsen(fine_to_current)
    return result


def _estimate(graph: Graph, h_star: float) -> int:
    """Number of parts to ask for at ``h_star``: real parts fill about half a ball of that diameter."""
    ball = np.pi / 4 if graph.dim == 2 else np.pi / 6
    side = float((graph.measures.sum() / (0.5 * ball)) ** (1.0 / graph.dim)) / h_star
    return graph.n if side > graph.n else max(1, int(np.ceil(side**graph.dim)))


def _one_level(graph: Graph, parts: int, h_star: float | None, crew: Crew, stage: int) -> Int:
    """One level on ``graph``: partition each component, refine, repair, then split what remains to split."""
    labels = graph.components()
    sizes = np.bincount(labels)
    if h_star is not None:
        parts = int(np.clip(parts, len(sizes), graph.n))
    quotas = apportion(parts, part_measures(graph, labels), frozen_int(sizes))
    pieces, cells = graph.split(labels)
    seeds, statistics = crew.seeds(stage, pieces.n_blocks), crew.statistics
    with statistics.timed("partition"):
        local = _partition_components(pieces, quotas, crew, seeds)
    target = Target(parts=parts, h_star=h_star)
    with statistics.timed("refine"):
        local = crew.refine(pieces, local, seeds, target)
    with statistics.timed("fix"):
        local = crew.fix(pieces, local)
    found = frozen_int(np.maximum.reduceat(local, pieces.offsets[:-1]) + 1)
    first = np.cumsum(found) - found
    labels = np.empty(graph.n, np.int64)
    labels[cells] = local + np.repeat(first, np.diff(pieces.offsets))
    return _finish(graph, frozen_int(labels), quotas, found, h_star, crew, stage)


def _partition_components(pieces: Graph, quotas: Int, crew: Crew, seeds: UInt64) -> Int:
    """Labels local to each component, gaps closed."""
    local = np.zeros(pieces.n, np.int64)
    for b in np.flatnonzero(quotas > 1):
        nodes = slice(int(pieces.offsets[b]), int(pieces.offsets[b + 1]))
        local[nodes] = crew.partition(pieces[int(b)], int(quotas[b]), int(seeds[b]))
    return frozen_int(local)


def _finish(
    graph: Graph, labels: Int, quotas: Int, found: Int, h_star: float | None, crew: Crew, stage: int
) -> Int:
    """Bisect parts that are too large, or as many as are missing to the exact count."""
    rule: Rule
    if h_star is not None:
        rule = ByDiameter(h_star)
    else:
        measures = part_measures(graph, labels)
        cells = frozen_int(np.bincount(labels))
        stops = np.cumsum(found)
        shares = [
            apportion(int(quota), measures[stop - count : stop], cells[stop - count : stop])
            for quota, count, stop in zip(quotas, found, stops, strict=True)
            if count < quota
        ]
        extra = np.ones(len(measures), np.int64)
        if shares:
            extra[np.repeat(found < quotas, found)] = np.concatenate(shares)
        rule = ByQuota(frozen_int(extra))
    tree, leaves = grow(graph, labels, rule, crew, stage)
    if h_star is not None:
        note_oversized(tree, leaves, h_star, crew)
    return tree.labels(leaves)
