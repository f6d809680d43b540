"""Post-passes on a finished level: merge small parts, polish all interfaces at once.

Both stay inside given blocks (in a recursion the parts of the next coarser level, in a k-way hierarchy the
connected components) and never make a part miss its size target.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agglo_core.agglomeration.goals import Goal, SizeGoal
from agglo_core.agglomeration.run import Run
from agglo_core.arrays import Int, frozen_int
from agglo_core.graph import Graph
from agglo_core.hierarchy import by_first_cell
from agglo_core.progress import Tell, phase
from agglo_core.protocols import Target

__all__ = ["PostPass", "merge_parts"]


@dataclass(frozen=True)
class PostPass:
    """Which post-passes to run."""

    merge: bool
    polish: bool

    @property
    def active(self) -> bool:
        """Whether there is anything to do."""
        return self.merge or self.polish

    def apply(self, graph: Graph, blocks: Int, labels: Int, goal: Goal, run: Run, stage: int) -> Int:
        """Labels ``(n,)`` after the post-passes, each inside ``blocks (n,)``."""
        if self.merge and isinstance(goal, SizeGoal):
            with run.statistics.timed("merge"), phase(run.progress, "merging") as tell:
                labels = merge_parts(graph, blocks, labels, goal.limit, tell)
        if self.polish:
            with run.statistics.timed("polish"), phase(run.progress, "polishing"):
                labels = _polish(graph, blocks, labels, goal, run, stage)
        return labels


def merge_parts(graph: Graph, blocks: Int, labels: Int, limit: float, tell: Tell) -> Int:
    """Merge neighbours whose union has a diameter of at most ``limit``, roundest unions first.

    The larger the share of its parts' boundary that becomes interior, the rounder a union is. In each round
    every part proposes its best neighbour; mutual proposals merge.
    """
    from agglo_core.kernels.merging import merged_parts

    labels = by_first_cell(labels)
    parts = graph.coarsen(labels)
    tell(0.0, f"{parts.n:,} parts")
    owner = np.empty(parts.n, np.int64)
    owner[labels] = blocks
    csr = parts.indptr, parts.indices, parts.interface
    shapes = parts.vertex_offsets, parts.vertices, parts.points
    merged = merged_parts(*csr, parts.boundary, frozen_int(owner), *shapes, float(limit))
    result = by_first_cell(merged[labels])
    tell(1.0, f"{int(result.max()) + 1:,} parts")
    return result


def _polish(graph: Graph, blocks: Int, labels: Int, goal: Goal, run: Run, stage: int) -> Int:
    """One k-way pass of the post-refiners in each block; moves that spoil a part are undone."""
    pieces, cells = graph.split(blocks)
    before = labels[cells]
    owner = np.empty(int(labels.max()) + 1, np.int64)
    owner[labels] = blocks
    by_block = np.argsort(owner, kind="stable")
    first = np.concatenate(([0], np.cumsum(np.bincount(owner))))
    local = np.empty(len(owner), np.int64)
    local[by_block] = np.arange(len(owner)) - first[owner[by_block]]
    seeds = run.seeds(stage, pieces.n_blocks)
    target = Target(parts=len(owner), h_star=goal.target.h_star)
    moved = run.refine(pieces, frozen_int(local[before]), seeds, target, post=True)
    after = by_block[first[pieces.block_ids] + moved]
    result = np.empty(graph.n, np.int64)
    result[cells] = _without_bad_moves(pieces, before, after, goal.limit)
    return frozen_int(result)


def _without_bad_moves(pieces: Graph, before: Int, after: Int, limit: float) -> Int:
    """Undo all moves into or out of parts that became empty, disconnected or too wide, until none is left.

    A part is emptied where the move that filled it is undone, and not yet that which took its last cell.
    """
    while True:
        bad = np.bincount(after, minlength=int(before.max()) + 1) == 0
        if not bad.any():
            component = pieces.components(after)
            part_of = np.zeros(int(component.max()) + 1, np.int64)
            part_of[component] = after
            bad = np.bincount(part_of, minlength=len(bad)) > 1
            if np.isfinite(limit):
                bad |= pieces.part_diameters(after) > limit
        back = (bad[after] | bad[before]) & (after != before)
        if not back.any():
            return after
        after = np.where(back, before, after)
