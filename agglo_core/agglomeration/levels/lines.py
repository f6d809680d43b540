"""Agglomeration along lines of strongly coupled cells, as in boundary layers.

A part consists of whole lines, or lies within one line. A level consists of whole lines as long as there are
enough lines and the lines are narrow enough. Finer levels split each line lengthwise, so that coarsening goes
along lines first. Source: Mavriplis, "Directional agglomeration multigrid techniques for high-Reynolds-number
viscous flows" (AIAA J. 37, 1999).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from agglo_core.agglomeration.goals import CountGoal, Goal
from agglo_core.agglomeration.levels.ordered import compute_levels
from agglo_core.agglomeration.levels.polishing import PostPass
from agglo_core.agglomeration.run import Run
from agglo_core.arrays import Float, Int, Mask, frozen_int
from agglo_core.graph import Graph
from agglo_core.hierarchy import by_first_cell

STRONG = 4.0
"""Dimensionless ratio: couplings at least this many times the weakest coupling of both cells form lines.

A larger value forms fewer and shorter lines, only where cells are thinner.
Benchmark: benchmarks/constants.py.
"""


def line_levels(
    graph: Graph, goals: Sequence[Goal], run: Run, post: PostPass, *, kway: bool, nested: bool
) -> list[Int]:
    """Compute levels whose parts follow lines of strongly coupled cells: labels ``(n,)``, finest first."""
    lines, inside = lines_of_cells(graph)
    count = int(lines.max()) + 1
    # 1. Sort the goals: counts up to the number of lines need whole lines, larger counts split lines. Size
    #    goals may need both.
    whole = [goal for goal in goals if not isinstance(goal, CountGoal) or goal.parts <= count]
    split = [goal for goal in goals if not isinstance(goal, CountGoal) or goal.parts > count]
    coarse: list[Int] = []
    fine: list[Int] = []
    # 2. Coarse levels: agglomerate the quotient graph, with one node per line.
    if whole:
        rules = post.rules and post.rules.via(lines)
        quotient = graph.coarsen(lines)
        coarse = compute_levels(quotient, whole, run, replace(post, rules=rules), kway=kway, nested=nested)
        run.statistics.oversized_cells = 0  # the count so far refers to lines
    # 3. Fine levels: split each line separately, on the graph without edges between lines.
    if split:
        alone, as_made = graph.without_edges(~inside), PostPass(False, False)
        fine = compute_levels(alone, split, run, as_made, kway=False, nested=nested)
    # 4. Combine both: where a part is a single line, use the pieces of this line.
    return [
        _replace_single_lines(
            coarse[whole.index(goal)][lines] if goal in whole else lines,
            fine[split.index(goal)] if goal in split else lines,
            lines,
        )
        for goal in goals
    ]


def _replace_single_lines(labels: Int, cut: Int, lines: Int) -> Int:
    """Divide each part that is a single line of cells into this line's pieces from the partition ``cut``."""
    of_pairs = np.unique(np.stack((labels, lines)), axis=1)[0]
    single = np.bincount(of_pairs, minlength=int(labels.max()) + 1) == 1
    pieces = labels * (int(cut.max()) + 2) + np.where(single[labels], cut + 1, 0)
    return by_first_cell(frozen_int(np.unique(pieces, return_inverse=True)[1]))


def lines_of_cells(graph: Graph) -> tuple[Int, Mask]:
    """Find lines of strongly coupled cells: each cell's line ``(n,)``, and a mask of the edges in lines.

    Lines are numbered by first cell. The coupling between two cells is their interface divided by their
    centroid distance. A pair is in a line if each cell is among the other's two strongest neighbours, and
    their coupling is at least four times the weakest coupling of both cells.
    """
    rows, columns = np.repeat(np.arange(graph.n), np.diff(graph.indptr)), graph.indices.astype(np.int64)
    # 1. Coupling of each pair, and the weakest coupling of each cell.
    distance = np.linalg.norm(graph.centroids[rows] - graph.centroids[columns], axis=1)
    coupling: Float = graph.interface / np.where(distance > 0, distance, np.inf)
    weakest = np.full(graph.n, np.inf)
    np.minimum.at(weakest, rows, coupling)
    # 2. Rank the neighbours of each cell by coupling, and mark strong couplings to the first two.
    rank = np.empty(len(rows), np.int64)
    rank[np.lexsort((columns, -coupling, rows))] = np.arange(len(rows))
    first = rank - graph.indptr[rows] < 2
    strong = first & (coupling >= STRONG * np.maximum(weakest[rows], weakest[columns]))
    # 3. Keep the pairs in which both cells mark each other. Lines are the components of these pairs.
    keys = rows * graph.n + columns
    inside = strong & np.isin(keys, (columns * graph.n + rows)[strong])
    return frozen_int(graph.without_edges(~inside).components()), inside
