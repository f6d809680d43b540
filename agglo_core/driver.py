"""The recursion of the paper's Algorithm 1, level by level.

All pieces of one depth are blocks of one block-diagonal graph: bisect, refine, fix, test, split.
Asserted on the way: no side is empty, each phase keeps the label set, every piece is connected, the
number of pieces strictly grows.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from agglo_core.arrays import Float, Int, Mask, UInt64, frozen_float, frozen_int
from agglo_core.crew import Crew, Statistics, splitmix
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.hierarchy import Tree
from agglo_core.protocols import Target

__all__ = ["ROUNDING", "ByDiameter", "ByQuota", "Growth", "apportion", "grow"]

ROUNDING = 1e-9
"""A part meets a size target h* if its diameter is at most h* (1 + ROUNDING)."""

_log = logging.getLogger("agglo")


class Rule(Protocol):
    """When a piece is finished. ``order`` lists the cells of the pieces, ``offsets`` cuts it."""

    @property
    def target(self) -> Target:
        """What components are told."""
        ...

    def roots(self, graph: Graph, order: Int, offsets: Int) -> tuple[Float, Mask]:
        """State of each first piece, and whether it is finished."""
        ...

    def children(self, level: Graph, order: Int, offsets: Int, state: Float) -> tuple[Float, Mask]:
        """The same for the two halves of each block, given the state of the blocks."""
        ...


def _diameters(graph: Graph, order: Int, offsets: Int) -> Float:
    from agglo_core.kernels.geometry import block_diameters

    return frozen_float(block_diameters(offsets, order, graph.vertex_offsets, graph.vertices, graph.points))


@dataclass(frozen=True)
class ByDiameter:
    """Pieces are finished at ``diam <= h_star``; a single cell is, too. State: the diameter."""

    h_star: float

    @property
    def target(self) -> Target:
        """What components are told."""
        return Target(h_star=self.h_star)

    def roots(self, graph: Graph, order: Int, offsets: Int) -> tuple[Float, Mask]:
        """Diameters, and whether each is small enough."""
        diameter = _diameters(graph, order, offsets)
        return diameter, (diameter <= self.h_star * (1 + ROUNDING)) | (np.diff(offsets) == 1)

    def children(self, level: Graph, order: Int, offsets: Int, state: Float) -> tuple[Float, Mask]:
        """The same for the two halves of each block."""
        return self.roots(level, order, offsets)


@dataclass(frozen=True)
class ByQuota:
    """A piece holds a number of parts; a split shares it by measure; at 1 it is finished."""

    quotas: Int

    @property
    def target(self) -> Target:
        """What components are told."""
        return Target(parts=int(self.quotas.sum()))

    def roots(self, graph: Graph, order: Int, offsets: Int) -> tuple[Float, Mask]:
        """The given quotas."""
        return frozen_float(self.quotas), self.quotas == 1

    def children(self, level: Graph, order: Int, offsets: Int, state: Float) -> tuple[Float, Mask]:
        """``clamp(round(k · measure share), 1, min(k − 1, cells))`` on each side; they add up to k."""
        measure = np.add.reduceat(level.measures[order], offsets[:-1]).reshape(-1, 2)
        cells = np.diff(offsets).reshape(-1, 2)
        share = measure[:, 0] / measure.sum(axis=1)
        low = np.maximum(1.0, state - cells[:, 1])
        high = np.minimum(state - 1.0, cells[:, 0])
        first = np.clip(np.round(state * share), low, high)
        quotas = np.stack((first, state - first), axis=1).ravel()
        return frozen_float(quotas), quotas == 1


@dataclass
class Growth:
    """A tree being built: nodes in order of depth, finished pieces written into tree order."""

    n: int
    parent: list[Int] = field(default_factory=list)
    start: list[Int] = field(default_factory=list)
    stop: list[Int] = field(default_factory=list)
    diameter: list[Float] = field(default_factory=list)
    count: int = 0

    def __post_init__(self) -> None:
        self.cells = np.full(self.n, -1, np.int64)

    def add(self, parent: Int, start: Int, sizes: Int, diameter: Float) -> Int:
        """Append nodes; return their numbers."""
        self.parent.append(parent)
        self.start.append(start)
        self.stop.append(start + sizes)
        self.diameter.append(diameter)
        self.count += len(parent)
        return np.arange(self.count - len(parent), self.count)

    def write(self, start: Int, sizes: Int, cells: Int) -> None:
        """Put the cells of finished pieces in their place."""
        shift = np.repeat(start - (np.cumsum(sizes) - sizes), sizes)
        self.cells[np.arange(len(cells)) + shift] = cells

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


def part_measures(graph: Graph, labels: Int) -> Float:
    """Measure of each part ``(k,)``."""
    return frozen_float(np.bincount(labels, weights=graph.measures))


def apportion(k: int, measures: Float, cells: Int) -> Int:
    """Share k parts among pieces by measure: at least 1 each, at most their cells, exactly k in all.

    Raises
    ------
    OptionError
        If there are more pieces than parts, or fewer cells.
    """
    if k < len(measures):
        raise OptionError(
            f"{k} parts are too few: the mesh has {len(measures)} pieces that share no face or level part"
        )
    if k > cells.sum():
        raise OptionError(f"{k} parts are too many: there are {int(cells.sum())} cells")
    ideal = k * measures / measures.sum()
    quotas = np.clip(np.floor(ideal), 1, cells).astype(np.int64)
    while (gap := k - int(quotas.sum())) != 0:
        step = 1 if gap > 0 else -1
        movable = quotas < cells if gap > 0 else quotas > 1
        want = np.where(movable, (ideal - quotas) * step, -np.inf)
        chosen = np.argsort(-want, kind="stable")[: min(abs(gap), int(movable.sum()))]
        quotas[chosen] += step
    return frozen_int(quotas)


def grow(
    graph: Graph,
    growth: Growth,
    labels: Int,
    parents: Int | None,
    rule: Rule,
    crew: Crew,
    seed: int,
    statistics: Statistics,
) -> Int:
    """Split the connected pieces ``labels (n,)`` of ``graph`` until ``rule`` finishes all.

    ``parents`` are the tree nodes of the pieces, or None to make them roots. Returns the nodes of the
    finished pieces.
    """
    with statistics.timed("split"):
        level, cells = graph.split(labels)
        order = frozen_int(np.arange(level.n))
        state, finished = rule.roots(level, order, level.offsets)
    seeds = splitmix(np.uint64(seed) + np.arange(1, level.n_blocks + 1, dtype=np.uint64) * np.uint64(2**32))
    sizes = np.diff(level.offsets)
    if parents is None:
        start = np.asarray(level.offsets[:-1])
        nodes = growth.add(np.full(level.n_blocks, -1), start, sizes, _known_diameter(rule, state))
    else:
        nodes, start = parents, np.concatenate(growth.start)[parents]
    done: list[Int] = []
    pieces = level.n_blocks
    source, offsets, sides = level, level.offsets, np.zeros(level.n, np.int64)
    while True:
        done.append(nodes[finished])
        _write_finished(growth, start, sizes, finished, cells[order], offsets)
        if finished.all():
            return frozen_int(np.concatenate(done))
        with statistics.timed("split"):
            going = np.flatnonzero(~finished)
            level, cells = _next_level(source, cells, order, offsets, going, sides)
        seeds, state, nodes, start = seeds[going], state[going], nodes[going], start[going]
        sides = _split(level, crew, seeds, rule.target, statistics)
        with statistics.timed("test"):
            source = level
            order, offsets = _children(level, sides)
            state, finished = rule.children(level, order, offsets, frozen_float(state))
        sizes = np.diff(offsets)
        start = np.stack((start, start + sizes[::2]), axis=1).ravel()
        nodes = growth.add(np.repeat(nodes, 2), start, sizes, _known_diameter(rule, state))
        seeds = splitmix(np.repeat(seeds, 2) ^ np.tile(np.array([1, 2], np.uint64), len(seeds)))
        pieces = _report(crew, statistics, level.n_blocks, pieces + level.n_blocks)


def _known_diameter(rule: Rule, state: Float) -> Float:
    return state if isinstance(rule, ByDiameter) else np.full(len(state), np.nan)


def _children(level: Graph, sides: Int) -> tuple[Int, Int]:
    from agglo_core.kernels.graphs import child_order

    order, offsets = child_order(level.offsets, frozen_int(sides))
    return frozen_int(order), frozen_int(offsets)


def _next_level(
    source: Graph, cells: Int, order: Int, offsets: Int, going: Int, sides: Int
) -> tuple[Graph, Int]:
    """Block-diagonal graph of the pieces ``going`` and the fine cell of each of its nodes."""
    sizes = np.diff(offsets)[going]
    starts = np.concatenate(([0], np.cumsum(sizes)))
    take = order[np.arange(starts[-1]) + np.repeat(offsets[going] - starts[:-1], sizes)]
    return source.subgraph(take, starts, sides), cells[take]


def _split(level: Graph, crew: Crew, seeds: UInt64, target: Target, statistics: Statistics) -> Int:
    """Sides of every node: bisected, refined, connected."""
    with statistics.timed("bisect"):
        sides = crew.bisect(level, seeds, statistics)
    with statistics.timed("refine"):
        sides = crew.refine(level, sides, seeds, target)
    with statistics.timed("fix"):
        return crew.fix(level, sides, statistics)


def _write_finished(growth: Growth, start: Int, sizes: Int, finished: Mask, cells: Int, offsets: Int) -> None:
    chosen = np.flatnonzero(finished)
    counts = sizes[chosen]
    first = np.cumsum(counts) - counts
    take = np.arange(counts.sum()) + np.repeat(offsets[chosen] - first, counts)
    growth.write(start[chosen], counts, cells[take])


def _report(crew: Crew, statistics: Statistics, bisections: int, pieces: int) -> int:
    statistics.depth += 1
    statistics.bisections += bisections
    if crew.watch is not None:
        crew.watch({"depth": statistics.depth, "bisected": bisections, "pieces": pieces})
    return pieces


def note_oversized(tree: Tree, leaves: Int, h_star: float, statistics: Statistics) -> None:
    """Count single cells larger than the smallest target, and warn about them."""
    large = tree.diameter[leaves] > h_star * (1 + ROUNDING)
    count = int(large.sum())
    if count:
        statistics.oversized_cells += count
        _log.warning("%d cells are larger than h* = %g and stay alone", count, h_star)


def levels_by_size(
    graph: Graph, h_stars: Sequence[float], crew: Crew, seed: int, statistics: Statistics
) -> list[Int]:
    """One tree serves all targets: level l is its cut at ``h_stars[l]`` (ascending)."""
    growth = Growth(graph.n)
    rule = ByDiameter(h_stars[0])
    leaves = grow(graph, growth, graph.components(), None, rule, crew, seed, statistics)
    tree = growth.tree()
    note_oversized(tree, leaves, h_stars[0], statistics)
    return [tree.labels(tree.cut(h * (1 + ROUNDING))) for h in h_stars]


def levels_by_count(
    graph: Graph, counts: Sequence[int], crew: Crew, seed: int, statistics: Statistics
) -> list[Int]:
    """Exact counts (ascending in size, so coarsest last): each part takes a quota of the next count."""
    growth = Growth(graph.n)
    labels, parents = graph.components(), None
    levels: list[Int] = []
    for k in sorted(counts):
        measures = part_measures(graph, labels)
        quotas = apportion(k, measures, frozen_int(np.bincount(labels)))
        leaves = grow(graph, growth, labels, parents, ByQuota(quotas), crew, seed + len(levels), statistics)
        start, stop = np.concatenate(growth.start)[leaves], np.concatenate(growth.stop)[leaves]
        order = np.argsort(start)
        labels = np.empty(graph.n, np.int64)
        labels[growth.cells] = np.repeat(np.arange(len(leaves)), (stop - start)[order])
        labels, parents = frozen_int(labels), frozen_int(leaves[order])
        levels.append(labels)
    return levels[::-1]
