"""Recursive bisection, depth by depth (paper, Algorithm 1).

All pieces at a depth are blocks in a block-diagonal graph (``level``, as in the bisectors' ``bisect_level``).
The steps are: bisect, refine, fix, test, split. Invariants: no side is empty, each phase keeps the label set,
every piece is connected, and the piece count strictly increases.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from agglo_core.agglomeration.goals import CountGoal, Goal, SizeGoal
from agglo_core.agglomeration.levels.growth import grow_levels
from agglo_core.agglomeration.levels.polishing import PostPass
from agglo_core.agglomeration.run import Run
from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_int, splitmix
from agglo_core.graph import Graph
from agglo_core.hierarchy import Tree
from agglo_core.progress import Notify, phase
from agglo_core.split.side_shares import side_shares


@dataclass
class _TreeBuilder:
    """Tree of the recursive bisection under construction: nodes by depth, finished cells in tree order."""

    n: int
    goal: Goal
    parent: list[Int] = field(default_factory=list)
    start: list[Int] = field(default_factory=list)
    stop: list[Int] = field(default_factory=list)
    diameter: list[Float] = field(default_factory=list)
    count: int = 0
    placed: int = 0

    def __post_init__(self) -> None:
        self.cells = np.full(self.n, -1, np.int64)

    def add(self, parent: Int, start: Int, sizes: Int, state: Float) -> Int:
        """Append tree nodes, and return their indices."""
        by_size = isinstance(self.goal, SizeGoal)
        self.parent.append(parent)
        self.start.append(start)
        self.stop.append(start + sizes)
        self.diameter.append(state if by_size else np.full(len(state), np.nan))
        self.count += len(parent)
        return np.arange(self.count - len(parent), self.count)

    def write(self, start: Int, finished: Mask, cells: Int, order: Int, offsets: Int) -> None:
        """Write the finished pieces' cells to their places in tree order."""
        pieces = np.flatnonzero(finished)
        if len(pieces) == 0:
            return
        take, counts = _rows(offsets, pieces)
        place = np.repeat(start[pieces] - (np.cumsum(counts) - counts), counts)
        self.cells[np.arange(len(take)) + place] = cells[order[take]]
        self.placed += len(take)

    def reached(self, expected: float) -> tuple[float, str]:
        """Return the estimated fraction of the work done, and a text for the progress display.

        Each root is expected to become ``expected`` leaves. All depths cost about equally much until pieces
        are finished, and the depth is the logarithm of the leaf count.
        """
        roots = len(self.start[0])
        leaves = (self.count + roots) // 2
        depth = np.log(leaves / roots) / np.log(max(expected, 2.0))
        share = max(self.placed / self.n, min(float(depth), 0.99))
        return share, f"depth {len(self.start) - 1}, {leaves:,} pieces"

    def tree(self) -> Tree:
        """Return the finished tree, in which every cell has its place."""
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


def grow(graph: Graph, labels: Int, goal: Goal, run: Run, stage: int = 0) -> tuple[Tree, Int]:
    """Split the connected pieces ``labels (n,)`` of ``graph`` depth by depth until all meet the goal.

    The bisector is called once per depth. A bisector with a method ``grow`` makes all splits itself: see
    ``grow_levels`` in ``growth``.

    Seeds depend on the run's seed, the ``stage`` number and the place in the tree. Returns the tree, whose
    roots are the pieces, and its leaf numbers.

    Examples
    --------
    >>> from agglo_core.authoring import ConnectivityFixer, InertialBisection
    >>> from agglo_core.registry.attribution import Member
    >>> from agglo_core.agglomeration.run import Run
    >>> from agglo_core.agglomeration.goals import SizeGoal
    >>> from agglo_core.agglomeration.levels.recursion import grow
    >>> run = Run(Member(InertialBisection(), "mine"), [], [], Member(ConnectivityFixer(), "fixer"))
    >>> strip = agglo.samples.strip(8).graph
    >>> tree, leaves = grow(strip, strip.components(), SizeGoal(0.4), run)
    >>> tree.labels(leaves)
    array([0, 0, 1, 1, 2, 2, 3, 3])
    """
    with phase(run.progress, "agglomerating") as notify:
        return _bisect_by_depth(graph, labels, goal, run, stage, notify)


def _bisect_by_depth(
    graph: Graph, labels: Int, goal: Goal, run: Run, stage: int, notify: Notify
) -> tuple[Tree, Int]:
    """Bisect the unfinished pieces depth by depth until every piece is finished."""
    tree = _TreeBuilder(graph.n, goal)
    # 1. Roots of the tree: the pieces, and whether each meets the goal.
    run, statistics = run.for_target(goal.target), run.statistics
    with statistics.timed("split"):
        source, cells = graph.split(labels)
        order, offsets = frozen_int(np.arange(graph.n)), source.offsets
        state, finished = goal.assess(source, order, offsets)
    start = np.asarray(offsets[:-1])
    nodes = tree.add(np.full(len(start), -1), start, np.diff(offsets), state)
    seeds = run.seeds(stage, len(start))
    leaves: list[Int] = []
    table = None if isinstance(goal, SizeGoal) else side_shares(goal.parts)
    expected = goal.estimate(graph) / len(start)
    while True:
        # 2. Store the finished pieces.
        leaves.append(nodes[finished])
        tree.write(start, finished, cells, order, offsets)
        notify(*tree.reached(expected))
        if finished.all():
            return tree.tree(), frozen_int(np.concatenate(leaves))
        # 3. Graph of the unfinished pieces, one block per piece.
        branches = np.flatnonzero(~finished)
        if nodes[0] > 0 or len(branches) < len(nodes):  # otherwise the blocks are still the roots
            with statistics.timed("split"):
                take, starts = _take_pieces(order, offsets, branches)
                source, cells = source.subgraph(take, starts), cells[take]
        # 4. Bisect, refine and fix all blocks.
        seeds, state, nodes, start = seeds[branches], state[branches], nodes[branches], start[branches]
        shares = table[np.minimum(state, len(table) - 1).astype(np.int64)] if table is not None else None
        sides = run.halve(source, seeds, goal.target, shares)
        # 5. Order the cells by side, and test each side.
        with statistics.timed("test"):
            order, offsets = _children(source, sides)
            state, finished = goal.assess(source, order, offsets, frozen_float(state))
        # 6. Add both sides of each block to the tree, with new seeds.
        sizes = np.diff(offsets)
        start = np.stack((start, start + sizes[::2]), axis=1).ravel()
        nodes = tree.add(np.repeat(nodes, 2), start, sizes, state)
        seeds = splitmix(np.repeat(seeds, 2) ^ np.tile(np.array([1, 2], np.uint64), len(seeds)))


def _rows(offsets: Int, rows: Int) -> tuple[Int, Int]:
    """Return the indices of the entries in the CSR ``rows``, concatenated, and the row lengths."""
    sizes = np.diff(offsets)[rows]
    if len(rows) == len(offsets) - 1:
        return np.arange(offsets[-1]), sizes
    first = np.cumsum(sizes) - sizes
    return np.arange(sizes.sum()) + np.repeat(offsets[rows] - first, sizes), sizes


def _take_pieces(order: Int, offsets: Int, pieces: Int) -> tuple[Int, Int]:
    """Return the cells of these ``pieces``, one piece after the other, and the piece offsets."""
    if len(pieces) == len(offsets) - 1:
        return order, offsets
    rows, sizes = _rows(offsets, pieces)
    return order[rows], frozen_int(np.concatenate(([0], np.cumsum(sizes))))


def _children(level: Graph, sides: Int) -> tuple[Int, Int]:
    from agglo_core.compiled.graphs import child_order

    order, offsets = child_order(level.offsets, sides)
    return frozen_int(order), frozen_int(offsets)


def recursive_levels(graph: Graph, goals: Sequence[Goal], run: Run, post: PostPass) -> list[Int]:
    """Compute the levels by recursive bisection, and return their labels, finest first.

    Without post-passes a single tree serves all sizes: each level cuts the tree. Counts are computed coarsest
    first, and each level's parts are the initial pieces for the next level. Sizes are also computed in this
    order if there are post-passes or the bisector depends on the target.
    """
    # 1. Growth, if the bisector supports these goals.
    grown = grow_levels(graph, goals, run, post)
    if grown is not None:
        return grown
    # 2. One tree for all sizes.
    if not post.active and _one_tree_serves(goals, run):
        return _levels_of_one_tree(graph, goals, run)
    # 3. Otherwise one recursion per level, coarsest first, from the parts of the previous level.
    labels = graph.components()
    result: list[Int] = []
    for stage, goal in enumerate(reversed(goals)):
        level_run = run.on_level(stage, len(goals))
        tree, leaves = grow(graph, labels, goal, level_run, stage)
        if goal is goals[0]:
            note_oversized(tree, leaves, goal, level_run)
        labels = post.apply(graph, labels, tree.labels(leaves), goal, level_run, stage)
        result.append(labels)
    return result[::-1]


def _one_tree_serves(goals: Sequence[Goal], run: Run) -> bool:
    finest = goals[0]
    return isinstance(finest, SizeGoal) and (len(goals) == 1 or run.for_target(finest.target) is run)


def _levels_of_one_tree(graph: Graph, goals: Sequence[Goal], run: Run) -> list[Int]:
    sizes = [goal for goal in goals if isinstance(goal, SizeGoal)]
    finest = replace(sizes[0], coarser=tuple(goal.h_star for goal in sizes[1:]))
    tree, leaves = grow(graph, graph.components(), finest, run)
    note_oversized(tree, leaves, finest, run)
    return [tree.labels(tree.cut(goal.limit)) for goal in sizes]


def note_oversized(tree: Tree, leaves: Int, goal: Goal, run: Run) -> None:
    """Record how many single cells exceed the target size, and keep the maximum over the levels."""
    if isinstance(goal, SizeGoal):
        count = int((tree.diameter[leaves] > goal.limit).sum())
        run.statistics.oversized_cells = max(count, run.statistics.oversized_cells)


def warn_of_large_cells(goals: Sequence[Goal], run: Run) -> None:
    """Log a warning with the number of single cells that exceed the smallest target size."""
    count, finest = run.statistics.oversized_cells, goals[0]
    if count and isinstance(finest, SizeGoal):
        cells = "1 cell is" if count == 1 else f"{count} cells are"
        message = "%s larger than h* = %g; each such cell stays a part"
        logging.getLogger("agglo").warning(message, cells, finest.h_star)


def note_repeated_levels(goals: Sequence[Goal], parts: Sequence[int]) -> None:
    """Log a note on levels that have one part, or as many parts as the next finer level.

    Levels with an exact part count are as requested and are left out.
    """
    remarks = []
    for level, (goal, count) in enumerate(zip(goals, parts, strict=True)):
        if isinstance(goal, CountGoal) and goal.exact:
            continue
        if level and count == parts[level - 1]:
            remarks.append(f"level {level} has as many parts as level {level - 1}")
        elif count == 1:
            remarks.append(f"level {level} has one part")
    if remarks:
        message = "numbers of parts by level: %s; %s. n_parts=… sets them"
        logging.getLogger("agglo").info(message, ", ".join(map(str, parts)), ", ".join(remarks))
