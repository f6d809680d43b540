"""The recursion of the paper's Algorithm 1, level by level.

All pieces of one depth are blocks of one block-diagonal graph: bisect, refine, fix, test, split.
Asserted on the way: no side is empty, each phase keeps the label set, every piece is connected, the
number of pieces strictly grows.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field

import numpy as np

from agglo_core.agglomeration.polishing import PostPass
from agglo_core.agglomeration.rules import ROUNDING, ByDiameter, ByQuota, Rule, apportion, part_measures
from agglo_core.agglomeration.run import Crew, splitmix
from agglo_core.agglomeration.targets import Levels
from agglo_core.arrays import Float, Int, Mask, UInt64, frozen_float, frozen_int
from agglo_core.graph import Graph
from agglo_core.hierarchy import Tree
from agglo_core.protocols import Target

__all__ = ["grow", "recursive_levels"]

_log = logging.getLogger("agglo")


@dataclass
class _Growth:
    """A tree being built: nodes in order of depth, finished pieces written into tree order."""

    n: int
    rule: Rule
    parent: list[Int] = field(default_factory=list)
    start: list[Int] = field(default_factory=list)
    stop: list[Int] = field(default_factory=list)
    diameter: list[Float] = field(default_factory=list)
    count: int = 0

    def __post_init__(self) -> None:
        self.cells = np.full(self.n, -1, np.int64)

    def add(self, parent: Int, start: Int, sizes: Int, state: Float) -> Int:
        """Append nodes; return their numbers."""
        known = isinstance(self.rule, ByDiameter)
        self.parent.append(parent)
        self.start.append(start)
        self.stop.append(start + sizes)
        self.diameter.append(state if known else np.full(len(state), np.nan))
        self.count += len(parent)
        return np.arange(self.count - len(parent), self.count)

    def write(self, start: Int, finished: Mask, cells: Int, order: Int, offsets: Int) -> None:
        """Put the cells of finished pieces in their place."""
        chosen = np.flatnonzero(finished)
        if len(chosen) == 0:
            return
        take, counts = _rows(offsets, chosen)
        place = np.repeat(start[chosen] - (np.cumsum(counts) - counts), counts)
        self.cells[np.arange(len(take)) + place] = cells[order[take]]

    def tree(self) -> Tree:
        """The tree, once every cell has its place."""
        if (self.cells < 0).any():
            raise AssertionError("cells were lost in the recursion")
        join = np.concatenate
        return Tree(
            cells=frozen_int(self.cells),
            parent=frozen_int(join(self.parent)),
            start=frozen_int(join(self.start)),
            stop=frozen_int(join(self.stop)),
            diameter=frozen_float(join(self.diameter)),
        )


def grow(graph: Graph, labels: Int, rule: Rule, crew: Crew, stage: int = 0) -> tuple[Tree, Int]:
    """Split the connected pieces ``labels (n,)`` of ``graph`` until ``rule`` finishes all.

    Seeds follow from that of the crew, the number of the ``stage`` and the place in the tree.
    Returns the tree, whose roots are the pieces, and the nodes of its leaves.
    """
    growth = _Growth(graph.n, rule)
    crew, statistics = crew.aimed(rule.target), crew.statistics
    with statistics.timed("split"):
        source, cells = graph.split(labels)
        order, offsets = frozen_int(np.arange(graph.n)), source.offsets
        state, finished = rule.roots(source, order, offsets)
    start = np.asarray(offsets[:-1])
    nodes = growth.add(np.full(len(start), -1), start, np.diff(offsets), state)
    seeds = crew.seeds(stage, len(start))
    leaves: list[Int] = []
    while True:
        leaves.append(nodes[finished])
        growth.write(start, finished, cells, order, offsets)
        if finished.all():
            return growth.tree(), frozen_int(np.concatenate(leaves))
        going = np.flatnonzero(~finished)
        if nodes[0] > 0 or len(going) < len(nodes):  # else the blocks are the roots, as they stand
            with statistics.timed("split"):
                take, starts = _taken(order, offsets, going)
                source, cells = source.subgraph(take, starts), cells[take]
        seeds, state, nodes, start = seeds[going], state[going], nodes[going], start[going]
        sides = _split(source, crew, seeds, rule.target)
        with statistics.timed("test"):
            order, offsets = _children(source, sides)
            state, finished = rule.children(source, order, offsets, frozen_float(state))
        sizes = np.diff(offsets)
        start = np.stack((start, start + sizes[::2]), axis=1).ravel()
        nodes = growth.add(np.repeat(nodes, 2), start, sizes, state)
        seeds = splitmix(np.repeat(seeds, 2) ^ np.tile(np.array([1, 2], np.uint64), len(seeds)))


def _rows(offsets: Int, chosen: Int) -> tuple[Int, Int]:
    """Positions of the chosen rows of a CSR, one after the other, and their lengths."""
    sizes = np.diff(offsets)[chosen]
    if len(chosen) == len(offsets) - 1:
        return np.arange(offsets[-1]), sizes
    first = np.cumsum(sizes) - sizes
    return np.arange(sizes.sum()) + np.repeat(offsets[chosen] - first, sizes), sizes


def _taken(order: Int, offsets: Int, chosen: Int) -> tuple[Int, Int]:
    """What the chosen pieces hold, and where each starts."""
    if len(chosen) == len(offsets) - 1:
        return order, offsets
    rows, sizes = _rows(offsets, chosen)
    return order[rows], frozen_int(np.concatenate(([0], np.cumsum(sizes))))


def _children(level: Graph, sides: Int) -> tuple[Int, Int]:
    from agglo_core.kernels.graphs import child_order

    order, offsets = child_order(level.offsets, sides)
    return frozen_int(order), frozen_int(offsets)


def _split(level: Graph, crew: Crew, seeds: UInt64, target: Target) -> Int:
    """Sides of every node: bisected, refined, connected."""
    statistics = crew.statistics
    with statistics.timed("bisect"):
        sides = crew.bisect(level, seeds)
    with statistics.timed("refine"):
        sides = crew.refine(level, sides, seeds, target)
    with statistics.timed("fix"):
        sides = crew.fix(level, sides)
    statistics.depth += 1
    statistics.bisections += level.n_blocks
    if crew.watch is not None:
        crew.watch({"depth": statistics.depth, "pieces": 2 * level.n_blocks, "cells": level.n})
    return sides


def recursive_levels(graph: Graph, levels: Levels, crew: Crew, post: PostPass) -> list[Int]:
    """Labels of each level, finest first.

    One tree serves all size targets: level l is its cut at h*_l. Counts go coarsest first, the parts of
    one level being the pieces of the next; so do sizes with post-passes or a bisector aimed at each.
    """
    h_stars = levels.sizes
    if h_stars and not post.active and (len(h_stars) == 1 or not crew.aims(h_stars[0])):
        rule: Rule = ByDiameter(h_stars[0], coarser=tuple(h_stars[1:]))
        tree, leaves = grow(graph, graph.components(), rule, crew)
        note_oversized(tree, leaves, h_stars[0], crew)
        return [tree.labels(tree.cut(h * (1 + ROUNDING))) for h in h_stars]
    labels = graph.components()
    result: list[Int] = []
    for stage, target in enumerate(reversed(levels.sizes or levels.counts)):
        h_star = target if levels.sizes else None
        rule = ByQuota(_shares(graph, labels, int(target))) if h_star is None else ByDiameter(h_star)
        tree, leaves = grow(graph, labels, rule, crew, stage)
        if h_star is not None and stage == len(levels.sizes) - 1:
            note_oversized(tree, leaves, h_star, crew)
        labels = post.apply(graph, labels, tree.labels(leaves), h_star, crew, stage)
        result.append(labels)
    return result[::-1]


def _shares(graph: Graph, labels: Int, parts: int) -> Int:
    return apportion(parts, part_measures(graph, labels), frozen_int(np.bincount(labels)))


def note_oversized(tree: Tree, leaves: Int, h_star: float, crew: Crew) -> None:
    """Count single cells larger than the smallest target (it has the most), and warn about them."""
    count = int((tree.diameter[leaves] > h_star * (1 + ROUNDING)).sum())
    if count > crew.statistics.oversized_cells:
        crew.statistics.oversized_cells = count
        cells = "1 cell is" if count == 1 else f"{count} cells are"
        _log.warning("%s larger than h* = %g; what is larger stays alone", cells, h_star)
