"""Post-processing of a finished level: merge small parts, and polish all interfaces at once.

Both passes stay inside given blocks. These are the next coarser level's parts in a recursion, and the
connected components in a k-way hierarchy. No pass makes a part miss its size target.
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
from agglo_core.progress import Notify, phase
from agglo_core.protocols import Target


@runtime_checkable
class PartRefiner(Protocol):
    """Optional interface of a refiner: work on the whole graph, without a subgraph per block.

    Building the block graph takes time.
    """

    def refine_parts(self, graph: Graph, labels: Int, block: Int, target: Target) -> Int:
        """Refine all parts on the whole graph, where part p lies in block ``block[p]``.

        ``labels (n,)`` number the parts through all blocks. No cell may leave its block.
        """


@dataclass(frozen=True)
class PostPass:
    """Post-processing of a finished level: merging, polishing, and enforcing rules for whole parts."""

    merge: bool
    polish: bool
    rules: PartRules | None = None

    @property
    def active(self) -> bool:
        """True if merging, polishing or rules are enabled."""
        return self.merge or self.polish or self.rules is not None

    def apply(
        self, graph: Graph, blocks: Int, labels: Int, goal: Goal, run: Run, stage: int, *, tested: bool = True
    ) -> Int:
        """Post-process the parts within their ``blocks (n,)``, and return the new labels ``(n,)``.

        If ``tested`` is False, the parts may be disconnected or too wide. The polish then checks all parts.
        """
        if self.merge and isinstance(goal, SizeGoal):
            with run.statistics.timed("merge"), phase(run.progress, "merging") as notify:
                labels = merge_parts(graph, blocks, labels, goal.limit, notify)
        if self.polish:
            with run.statistics.timed("polish"), phase(run.progress, "polishing"):
                labels = _polish(graph, blocks, labels, goal, run, stage, tested=tested)
        if self.rules is not None:
            labels = self.rules.kept(graph, blocks, labels, goal, run, stage)
        return labels


def merge_parts(graph: Graph, blocks: Int, labels: Int, limit: float, notify: Notify) -> Int:
    """Merge adjacent parts whose union has a diameter of at most ``limit``, roundest unions first.

    A union counts as rounder if a larger share of its parts' boundary becomes interior. In each round every
    part proposes its best neighbour, and mutual proposals merge.
    """
    from agglo_core.agglomeration.levels.merging_kernels import merge_by_proposals

    labels = by_first_cell(labels)
    parts = graph.coarsen(labels)
    notify(0.0, f"{parts.n:,} parts")
    owner = np.empty(parts.n, np.int64)
    owner[labels] = blocks
    csr = parts.indptr, parts.indices, parts.interface
    shapes = parts.vertex_offsets, parts.vertices, parts.points
    merged = merge_by_proposals(*csr, parts.boundary, frozen_int(owner), *shapes, float(limit))
    result = by_first_cell(merged[labels])
    notify(1.0, f"{int(result.max()) + 1:,} parts")
    return result


def _polish(graph: Graph, blocks: Int, labels: Int, goal: Goal, run: Run, stage: int, *, tested: bool) -> Int:
    """Polish the parts of each block, and undo moves that leave a part empty, disconnected or too wide."""
    # 1. Block of each part.
    owner = np.zeros(int(labels.max()) + 1, np.int64)
    if blocks.any():  # otherwise one block, the usual case: a connected mesh
        owner[labels] = blocks
    target = Target(parts=len(owner), h_star=goal.target.h_star)
    # 2. Refine, directly if all refiners have ``refine_parts``, else on the graph of the blocks.
    if all(member.offers("refine_parts") for member in run.post_refiners):
        after = run.refine_parts(graph, labels, frozen_int(owner), target)
    else:
        after = _refine_by_block(graph, labels, owner, target, run, stage)
    # 3. Undo the moves that disconnect, empty or widen a part, unless each move was tested for that.
    if tested and all(getattr(member.tool, "tests_moves", False) is True for member in run.post_refiners):
        return after
    result, broken, wide = _without_bad_moves(graph, labels, after, goal.limit, tested=tested)
    if broken.any():
        raise PluginError(f"{run.bisector.title} left a part disconnected")
    if not tested:
        run.note_widths(result, wide, goal.limit)
    return result


def _refine_by_block(graph: Graph, labels: Int, owner: Int, target: Target, run: Run, stage: int) -> Int:
    """Apply the post-refiners to the block-diagonal graph of all blocks, and return the new labels."""
    # 1. Graph of the blocks, and the number of each part within its block.
    pieces, cells = graph.split(owner[labels])
    by_block = np.argsort(owner, kind="stable")
    first = np.concatenate(([0], np.cumsum(np.bincount(owner))))
    local = np.empty(len(owner), np.int64)
    local[by_block] = np.arange(len(owner)) - first[owner[by_block]]
    # 2. Refine all blocks, and map the local labels back to part numbers.
    seeds = run.seeds(stage, pieces.n_blocks)
    moved = run.refine(pieces, frozen_int(local[labels[cells]]), seeds, target, post=True)
    result = np.empty(graph.n, np.int64)
    result[cells] = by_block[first[pieces.block_ids] + moved]
    return frozen_int(result)


def _without_bad_moves(
    graph: Graph, before: Int, after: Int, limit: float, *, tested: bool
) -> tuple[Int, Mask, Mask]:
    """Undo moves into or out of parts that became empty, disconnected or too wide, until none is left.

    A part is temporarily empty if the move that filled it is undone before its last cell's move. The other
    faults are then checked later. Only parts that changed since their last check are checked again. If the
    parts before are not ``tested``, the first round checks all parts. Also returns masks for parts still
    disconnected or too wide.
    """
    check_mask = np.ones(int(before.max()) + 1, bool)
    broken, wide, bad = (np.zeros_like(check_mask) for _ in range(3))  # no part is empty after a refiner
    moved = None
    if tested:
        moved, check_mask = _find_changes(before, after, len(check_mask))
    result = after
    while check_mask.any():
        # 1. Find the disconnected and the wide parts among the parts to check.
        if not bad.any():
            broken = broken & ~check_mask | broken_parts(graph.indptr, graph.indices, result, check_mask)
            if np.isfinite(limit):
                wide = wide & ~check_mask | graph.wide_parts(result, limit, check_mask)
            bad, check_mask = broken | wide, np.zeros_like(check_mask)
            if not bad.any():
                break
        # 2. Undo the remaining moves into or out of bad parts.
        if moved is None:
            moved = _find_changes(before, after, len(check_mask))[0]
        undo_mask = bad[result[moved]] | bad[before[moved]]
        cells = moved[undo_mask]
        if len(cells) == 0:
            break
        check_mask[before[cells]] = check_mask[result[cells]] = True
        result = result.copy()
        result[cells] = before[cells]
        moved = moved[~undo_mask]
        # 3. Parts that are empty now are bad in the next round.
        bad = np.bincount(result, minlength=len(bad)) == 0
    return frozen_int(result), broken, wide


def _find_changes(before: Int, after: Int, count: int) -> tuple[Int, Mask]:
    """Return the cells that changed their part, and a mask ``(count,)`` of the parts that changed."""
    moved = np.flatnonzero(after != before)
    changed = np.zeros(count, bool)
    changed[before[moved]] = changed[after[moved]] = True
    return moved, changed
