"""Choosing a cut by what it leads to: several are tried, both sides split to the end, the best is kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from agglo_core.authoring import (
    ConnectivityFixer,
    Float,
    Graph,
    Int,
    InterfaceRefiner,
    Member,
    Run,
    SizeGoal,
    Target,
    UInt64,
    frozen_int,
    grow,
    sweep,
)
from agglo_gnn.plane.features import rasterise

_LARGEST = 4000
"""Cells beyond which a cut is not worth the search: one cut changes the number of parts little."""
_UNEVEN = 4.0  # how much parts smaller than allowed count against a cut


@dataclass(frozen=True)
class _Quick:
    """The bisector of the roll-outs, in the form the recursion needs."""

    sides: Callable[[Graph], Int]

    def bisect_level(self, level: Graph, seeds: UInt64) -> Int:
        return self.sides(level)


def look_ahead(level: Graph, quick: Callable[[Graph], Int], count: int, h_star: float) -> Int:
    """Sides ``(n,)`` of the candidate cut of each block that leads to the fewest parts.

    Candidates are the cut of ``quick`` and the best thresholds along axes evenly turned from the
    principal one, refined and connected; each side is then split by ``quick`` until no part exceeds
    ``h_star``. Of cuts that lead to equally many parts the one of least total interface is taken, times
    1 + 4 ⟨(1 − diam / h_star)²⟩ so that parts come near the size allowed; of equal ones the first. All
    candidates of all blocks are rolled out together, as the blocks of one graph.

    Parameters
    ----------
    level : Graph
    quick : callable
        Sides of all blocks of a graph.
    count : int
        Candidates of each block.
    h_star : float
        Largest diameter of a part.
    """
    sides = np.array(quick(level))
    sizes = np.diff(level.offsets)
    wanted = np.flatnonzero((sizes > 2) & (sizes <= _LARGEST))
    if len(wanted) == 0 or count < 2:
        return sides
    blocks = level.take(wanted)
    trials = _copies(blocks, count)
    cuts = _cuts(blocks, quick, count)
    run = Run(
        bisector=Member(_Quick(quick), "gnn"),
        refiners=[Member(InterfaceRefiner(), "interface")],
        post_refiners=[],
        fixer=Member(ConnectivityFixer(), "connectivity"),
    )
    seeds: UInt64 = np.zeros(trials.n_blocks, np.uint64)
    cuts = run.fix(trials, run.refine(trials, frozen_int(cuts), seeds, Target(h_star=h_star)))
    parts, length = _roll_out(trials, cuts, run, h_star)
    best = _first_least(parts.reshape(count, -1), length.reshape(count, -1))
    sides[np.isin(level.block_ids, wanted)] = cuts.reshape(count, -1)[
        best[blocks.block_ids], np.arange(blocks.n)
    ]
    return sides


def _cuts(blocks: Graph, quick: Callable[[Graph], Int], count: int) -> Int:
    """Sides of all candidates ``(count · n,)``, one candidate of all blocks after the other."""
    u, v = rasterise(blocks).cells.T
    angles = np.arange(count - 1) * np.pi / (count - 1)
    turned = [sweep(blocks, np.cos(angle) * u + np.sin(angle) * v) for angle in angles]
    return np.concatenate([quick(blocks), *turned])


def _copies(graph: Graph, count: int) -> Graph:
    """``count`` copies of all blocks, one after the other."""
    shift = np.repeat(np.arange(count) * graph.n, len(graph.indices))

    def stacked(offsets: Int) -> Int:
        return np.concatenate(([0], np.cumsum(np.tile(np.diff(offsets), count))))

    measures = np.tile(graph.measures, count)
    return replace(
        graph,
        indptr=stacked(graph.indptr),
        indices=(np.tile(graph.indices, count) + shift).astype(np.int32),
        interface=np.tile(graph.interface, count),
        centroids=np.tile(graph.centroids, (count, 1)),
        measures=measures,
        boundary=np.tile(graph.boundary, count),
        weights=np.tile(graph.weights, count),
        vertex_offsets=stacked(graph.vertex_offsets),
        vertices=np.tile(graph.vertices, count),
        offsets=stacked(graph.offsets),
        data={},
    )


def _roll_out(trials: Graph, cuts: Int, run: Run, h_star: float) -> tuple[Int, Float]:
    """Number of parts that each cut leads to, and the length of their interfaces, more if they are small."""
    pieces = frozen_int(2 * trials.block_ids + cuts)
    tree, leaves = grow(trials, pieces, SizeGoal(h_star), run)
    owner = trials.block_ids[tree.cells[tree.start[leaves]]]
    count = np.bincount(owner, minlength=trials.n_blocks)
    short = np.bincount(owner, (1 - tree.diameter[leaves] / h_star) ** 2, minlength=trials.n_blocks)
    labels = tree.labels(leaves)
    rows = np.repeat(np.arange(trials.n), np.diff(trials.indptr))
    crossing = labels[rows] != labels[trials.indices]
    length = np.bincount(trials.block_ids[rows], crossing * trials.interface, minlength=trials.n_blocks)
    return count, length * (1 + _UNEVEN * short / count)


def _first_least(parts: Int, length: Float) -> Int:
    """Row of the fewest parts in each column, then the shortest interface, then the first."""
    fewest = parts == parts.min(axis=0)
    shortest = np.where(fewest, length, np.inf)
    return frozen_int(np.argmax(shortest <= shortest.min(axis=0) * (1 + 1e-9), axis=0))
