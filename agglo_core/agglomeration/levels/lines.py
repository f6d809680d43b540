"""Lines of strongly coupled cells, as in boundary layers: whole in a part, or a part within one of them.

A level is made of whole lines as long as there are enough of them, and narrow enough ones; below that each
line is split along itself: coarsening goes along lines first. Source: Mavriplis, "Directional agglomeration
multigrid techniques for high-Reynolds-number viscous flows" (AIAA J. 37, 1999).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from agglo_core.agglomeration.goals import CountGoal, Goal
from agglo_core.agglomeration.levels.ordered import ordered_levels
from agglo_core.agglomeration.levels.polishing import PostPass
from agglo_core.agglomeration.run import Run
from agglo_core.arrays import Float, Int, Mask, frozen_int
from agglo_core.graph import Graph
from agglo_core.hierarchy import by_first_cell

STRONG = 4.0
"""Couplings this many times the weakest of both cells make lines."""


def line_levels(
    graph: Graph, goals: Sequence[Goal], run: Run, post: PostPass, *, kway: bool, nested: bool
) -> list[Int]:
    """Labels ``(n,)`` of each level, finest first; as ``ordered_levels`` returns them."""
    lines, inside = lines_of_cells(graph)
    count = int(lines.max()) + 1
    whole = [goal for goal in goals if not isinstance(goal, CountGoal) or goal.parts <= count]
    split = [goal for goal in goals if not isinstance(goal, CountGoal) or goal.parts > count]
    coarse: list[Int] = []
    fine: list[Int] = []
    if whole:
        rules = post.rules and post.rules.via(lines)
        quotient = graph.coarsen(lines)
        coarse = ordered_levels(quotient, whole, run, replace(post, rules=rules), kway=kway, nested=nested)
        run.statistics.oversized_cells = 0  # lines, so far
    if split:
        alone, as_made = graph.without_edges(~inside), PostPass(False, False)
        fine = ordered_levels(alone, split, run, as_made, kway=False, nested=nested)
    return [
        _combined(
            coarse[whole.index(goal)][lines] if goal in whole else lines,
            fine[split.index(goal)] if goal in split else lines,
            lines,
        )
        for goal in goals
    ]


def _combined(labels: Int, cut: Int, lines: Int) -> Int:
    """Parts of whole lines, but where a part is a single line those into which it is ``cut``."""
    of_pairs = np.unique(np.stack((labels, lines)), axis=1)[0]
    single = np.bincount(of_pairs, minlength=int(labels.max()) + 1) == 1
    pieces = labels * (int(cut.max()) + 2) + np.where(single[labels], cut + 1, 0)
    return by_first_cell(frozen_int(np.unique(pieces, return_inverse=True)[1]))


def lines_of_cells(graph: Graph) -> tuple[Int, Mask]:
    """The line of each cell ``(n,)``, numbered by first cell, and which entries of the graph lie in lines.

    The coupling of two cells is their interface over the distance of their centroids. A pair is in a line if
    each is among the two strongest of the other, and at least four times the weakest of both.
    """
    rows, columns = np.repeat(np.arange(graph.n), np.diff(graph.indptr)), graph.indices.astype(np.int64)
    distance = np.linalg.norm(graph.centroids[rows] - graph.centroids[columns], axis=1)
    coupling: Float = graph.interface / np.where(distance > 0, distance, np.inf)
    weakest = np.full(graph.n, np.inf)
    np.minimum.at(weakest, rows, coupling)
    rank = np.empty(len(rows), np.int64)
    rank[np.lexsort((columns, -coupling, rows))] = np.arange(len(rows))
    first = rank - graph.indptr[rows] < 2
    strong = first & (coupling >= STRONG * np.maximum(weakest[rows], weakest[columns]))
    keys = rows * graph.n + columns
    inside = strong & np.isin(keys, (columns * graph.n + rows)[strong])
    return frozen_int(graph.without_edges(~inside).components()), inside
