"""Choice of cuts by lookahead: try several, split both sides completely, and keep the best cut."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from agglo_core.agglomeration.goals import SizeGoal
from agglo_core.agglomeration.levels.recursion import grow
from agglo_core.agglomeration.run import Run
from agglo_core.authoring import (
    ConnectivityFixer,
    Float,
    Graph,
    Int,
    InterfaceRefiner,
    Target,
    UInt64,
    frozen_int,
)
from agglo_core.graph.sweep import sweep
from agglo_core.registry.attribution import Member
from agglo_gnn.plane.features import rasterise

_LARGEST = 4000
"""Number of cells above which lookahead is skipped: one cut changes the number of parts little, and the
time of its candidates grows with the cells."""
# Weight of ⟨(1 − diam / h_star)²⟩, added to 1 and multiplied by the interface length: a larger value favours
# parts near the allowed size (benchmarks/gnn.py lookahead).
_UNEVEN = 4.0


@dataclass(frozen=True)
class _Quick:
    """Bisector without lookahead that splits both sides of each candidate cut."""

    sides: Callable[[Graph], Int]

    def bisect_level(self, level: Graph, seeds: UInt64) -> Int:
        return self.sides(level)


def look_ahead(level: Graph, quick: Callable[[Graph], Int], count: int, h_star: float) -> Int:
    """Return the sides ``(n,)`` of each block's candidate cut that finally leads to the fewest parts.

    Candidates are the cut of ``quick`` and the best thresholds along axes at equal angles from the
    principal axis, refined and connected. Each side is then split by ``quick`` until no part exceeds
    ``h_star``. Among cuts with equally many parts, the smallest total interface counts, times 1 + 4
    ⟨(1 − diam / h_star)²⟩ to favour parts near the allowed size; among equal cuts the first. All candidates
    of all blocks are rolled out together, as blocks of one graph.

    Parameters
    ----------
    level : Graph
    quick : callable
        Returns the sides of all blocks in a graph.
    count : int
        Candidates per block.
    h_star : float
        Largest part diameter.
    """
    sides = np.array(quick(level))
    # 1. Blocks with more than two and not too many cells
    sizes = np.diff(level.offsets)
    block_ids = np.flatnonzero((sizes > 2) & (sizes <= _LARGEST))
    if len(block_ids) == 0 or count < 2:
        return sides
    # 2. Candidate cuts, refined and connected
    blocks = level.take(block_ids)
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
    # 3. Roll out, and keep the best cut of each block
    parts, length = _roll_out(trials, cuts, run, h_star)
    best = _first_least(parts.reshape(count, -1), length.reshape(count, -1))
    sides[np.isin(level.block_ids, block_ids)] = cuts.reshape(count, -1)[
        best[blocks.block_ids], np.arange(blocks.n)
    ]
    return sides


def _cuts(blocks: Graph, quick: Callable[[Graph], Int], count: int) -> Int:
    """Return the sides for all candidate cuts ``(count · n,)``, candidate by candidate."""
    u, v = rasterise(blocks).cells.T
    angles = np.arange(count - 1) * np.pi / (count - 1)
    turned = [sweep(blocks, np.cos(angle) * u + np.sin(angle) * v) for angle in angles]
    return np.concatenate([quick(blocks), *turned])


def _copies(graph: Graph, count: int) -> Graph:
    """Return a graph with ``count`` copies of all blocks, one after the other."""
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
    """Split both sides of each cut completely, and return the part count and the interface length.

    The length is increased by a penalty for parts below the allowed size.
    """
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
    """Return for each column the row with the fewest parts, among these the shortest interface."""
    fewest = parts == parts.min(axis=0)
    shortest = np.where(fewest, length, np.inf)
    return frozen_int(np.argmax(shortest <= shortest.min(axis=0) * (1 + 1e-9), axis=0))
