"""Post-passes on a finished level: merge small parts, polish all interfaces at once.

Both stay inside given blocks (in a recursion the parts of the next coarser level, in a k-way hierarchy the
connected components) and never make a part miss its size target.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from agglo_core.agglomeration.goals import Goal, SizeGoal
from agglo_core.agglomeration.rules.parts import PartRules
from agglo_core.agglomeration.run import Run
from agglo_core.arrays import Int, Mask, frozen_int
from agglo_core.errors import PluginError
from agglo_core.graph import Graph
from agglo_core.graph.connection import broken_parts
from agglo_core.hierarchy import by_first_cell
from agglo_core.progress import Tell, phase
from agglo_core.protocols import Target


@runtime_checkable
class PartRefiner(Protocol):
    """Optional: a refiner of finished levels that needs no graph of the blocks, which takes time to make."""

    def refine_parts(self, graph: Graph, labels: Int, block: Int, target: Target) -> Int:
        """Do what ``refine`` does if the parts ``p`` of each ``block[p]`` were the blocks of the graph.

        ``labels (n,)`` number the parts through all blocks. No cell may leave its block.
        """


@dataclass(frozen=True)
class PostPass:
    """The post-passes of a run, with the rules for whole parts."""

    merge: bool
    polish: bool
    rules: PartRules | None = None

    @property
    def active(self) -> bool:
        """True if there is a pass to run."""
        return self.merge or self.polish or self.rules is not None

    def apply(
        self, graph: Graph, blocks: Int, labels: Int, goal: Goal, run: Run, stage: int, *, tested: bool = True
    ) -> Int:
        """Labels ``(n,)`` after the post-passes, each inside ``blocks (n,)``.

        If ``tested`` is False the parts may be disconnected or too wide: the polish tests all of them.
        """
        if self.merge and isinstance(goal, SizeGoal):
            with run.statistics.timed("merge"), phase(run.progress, "merging") as tell:
                labels = merge_parts(graph, blocks, labels, goal.limit, tell)
        if self.polish:
            with run.statistics.timed("polish"), phase(run.progress, "polishing"):
                labels = _polish(graph, blocks, labels, goal, run, stage, tested=tested)
        if self.rules is not None:
            labels = self.rules.kept(graph, blocks, labels, goal, run, stage)
        return labels


def merge_parts(graph: Graph, blocks: Int, labels: Int, limit: float, tell: Tell) -> Int:
    """Merge neighbours whose union has a diameter of at most ``limit``, roundest unions first.

    The larger the share of its parts' boundary that becomes interior, the rounder a union is. In each round
    every part proposes its best neighbour; mutual proposals merge.
    """
    from agglo_core.agglomeration.levels.merging_kernels import merged_parts

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


def _polish(graph: Graph, blocks: Int, labels: Int, goal: Goal, run: Run, stage: int, *, tested: bool) -> Int:
    """One k-way pass of the post-refiners in each block; moves that spoil a part are undone."""
    owner = np.zeros(int(labels.max()) + 1, np.int64)
    if blocks.any():  # else one: a connected mesh, most of the time
        owner[labels] = blocks
    target = Target(parts=len(owner), h_star=goal.target.h_star)
    if all(member.offers("refine_parts") for member in run.post_refiners):
        after = run.refine_parts(graph, labels, frozen_int(owner), target)
    else:
        after = _refined_by_block(graph, labels, owner, target, run, stage)
    kept, broken, wide = _without_bad_moves(graph, labels, after, goal.limit, tested=tested)
    if broken.any():
        raise PluginError(f"{run.bisector.title} left a part disconnected")
    if not tested:
        run.note_widths(kept, wide, goal.limit)
    return kept


def _refined_by_block(graph: Graph, labels: Int, owner: Int, target: Target, run: Run, stage: int) -> Int:
    """Labels after the post-refiners, which are given the blocks of the parts as those of a graph."""
    pieces, cells = graph.split(owner[labels])
    by_block = np.argsort(owner, kind="stable")
    first = np.concatenate(([0], np.cumsum(np.bincount(owner))))
    local = np.empty(len(owner), np.int64)
    local[by_block] = np.arange(len(owner)) - first[owner[by_block]]
    seeds = run.seeds(stage, pieces.n_blocks)
    moved = run.refine(pieces, frozen_int(local[labels[cells]]), seeds, target, post=True)
    result = np.empty(graph.n, np.int64)
    result[cells] = by_block[first[pieces.block_ids] + moved]
    return frozen_int(result)


def _without_bad_moves(
    graph: Graph, before: Int, after: Int, limit: float, *, tested: bool
) -> tuple[Int, Mask, Mask]:
    """Undo all moves into or out of parts that became empty, disconnected or too wide, until none is left.

    A part is emptied where the move that filled it is undone, and not yet that which took its last cell:
    then the other faults wait. Only parts that changed since they were looked at are looked at again, and
    unless those before were ``tested``, all at first. Also returns which are disconnected and wide still.
    """
    asked = np.ones(int(before.max()) + 1, bool)
    broken, wide, bad = (np.zeros_like(asked) for _ in range(3))  # a refiner has emptied none
    moved = None
    if tested:
        moved, asked = _moved(before, after, len(asked))
    result = after
    while asked.any():
        if not bad.any():
            broken = broken & ~asked | broken_parts(graph.indptr, graph.indices, result, asked)
            if np.isfinite(limit):
                wide = wide & ~asked | graph.wide_parts(result, limit, asked)
            bad, asked = broken | wide, np.zeros_like(asked)
            if not bad.any():
                break
        if moved is None:
            moved = _moved(before, after, len(asked))[0]
        back = bad[result[moved]] | bad[before[moved]]
        cells = moved[back]
        if len(cells) == 0:
            break
        asked[before[cells]] = asked[result[cells]] = True
        result = result.copy()
        result[cells] = before[cells]
        moved = moved[~back]
        bad = np.bincount(result, minlength=len(bad)) == 0
    return frozen_int(result), broken, wide


def _moved(before: Int, after: Int, count: int) -> tuple[Int, Mask]:
    """The cells that moved, and which of ``count`` parts they left or joined."""
    moved = np.flatnonzero(after != before)
    changed = np.zeros(count, bool)
    changed[before[moved]] = changed[after[moved]] = True
    return moved, changed
