"""Bisector ``kmeans``: deterministic 2-means in block batches, and k-means for k-way partitions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from scipy.spatial import cKDTree

from agglo_core.agglomeration.goals import SizeGoal
from agglo_core.anneal.part_search import PartSearch
from agglo_core.authoring import (
    CompactnessRefiner,
    ConnectivityFixer,
    Float,
    Graph,
    Int,
    InterfaceRefiner,
    OptionError,
    Target,
    UInt64,
    frozen_int,
)
from agglo_core.graph.ordering import curve_order
from agglo_core.progress import ignore_progress
from agglo_core.split.piece_growth import PieceGrowth
from agglo_kmeans.lattice import lattice_parts

_LATTICE_STEPS = 1
"""Lloyd steps from a lattice. More fit the parts better to curved outlines, and take longer
(benchmarks/solver_shapes.py --objective, brain)."""

_SIZE_STEPS = 3
"""Lloyd steps from a lattice for a target size. With one, a sixth less time, but 2 to 3 % more parts of
triangles and of the brain (benchmarks/gnn.py sizes)."""

_SIZE_SHARE = 0.85
"""Lattice points for a target size, relative to the count in the target. Lattice parts fill more of a disc
than bisections: with 0.78 or 1, there are up to 8 % more parts (benchmarks/gnn.py sizes)."""


class KMeans:
    """Bisect by 2-means on the cell centroids, weighted by ``graph.weights`` (paper, §2.2).

    All blocks are split in one call. Lloyd's iteration starts from the halves on both sides of a principal
    axis. If no axis stands out (principal moment ratio above 0.8), eight rotated axes are tried and the
    lowest energy is kept. In 3-D: three principal and four diagonal axes. The method is deterministic and
    uses no random numbers.

    Parameters
    ----------
    iterations : int
        Lloyd steps in the k-way ``partition`` from runs of a curve. From a lattice there are fewer.
    effort : "quick", "fast", "good" or "best", optional
        Anneal the k-way partition: about 7, 9, 30 or 200 ms for 300 cells, more for roundness. If nothing
        better is found, the bisections' result is returned. The result depends on the seed, and on
        the mesh orientation. For solvers, annealing starts from a hexagonal lattice of parts in 2-D, or
        from the bisections if these are better.
    objective : "solver" or "roundness"
        Annealing goal: small moments of inertia with short interfaces, good for solvers; or round parts
        with even width, and few parts for a given size.
    seconds : float, optional
        Wall-clock limit for annealing, per level and connected component: the best partition so far is
        returned, which then differs from run to run.
    balance : float, optional
        With an effort and a part count: largest relative deviation of part sizes from their mean, if
        more than a cell; with 0, cell counts differ by at most 1.
    curve : bool
        Whether part counts may start from runs of a space-filling curve instead of bisections. Where cells
        have similar sizes and shapes, the polished parts are as round, in half the time.
    size : "cells", "measure" or "weights", optional
        Balanced quantity. Default: the run's quantity (its ``weights=`` or ``balance=``), otherwise
        cells.

    Raises
    ------
    OptionError
        For any other value.
    """

    needs_points = True

    def __init__(
        self,
        iterations: int = 8,
        effort: Literal["quick", "fast", "good", "best"] | None = None,
        objective: Literal["solver", "roundness"] = "solver",
        seconds: float | None = None,
        balance: float | None = None,
        size: Literal["cells", "measure", "weights"] | None = None,
        curve: bool = True,
    ) -> None:
        self.curve = curve
        if not isinstance(iterations, int) or isinstance(iterations, bool) or iterations < 0:
            raise OptionError(f"kmeans: iterations must be a whole number, 0 or more, given {iterations!r}")
        self.iterations = iterations
        self.search = PartSearch.checked("kmeans", effort, objective, seconds, balance, size)

    @property
    def final_parts(self) -> bool:
        """True if refiners and polish must leave the k-way partition unchanged."""
        return self.search is not None

    def bisect_level(self, level: Graph, seeds: UInt64) -> Int:
        """Bisect each block, and return each node's side ``(n,)``, 0 or 1.

        The ``seeds`` are ignored.
        """
        from agglo_kmeans.kernel import two_means

        sides: Int = two_means(level.offsets, level.centroids, level.weights)
        return sides

    def allows_curve(self, refiners: Sequence[Any], fixer: Any, post_refiners: Sequence[Any]) -> bool:
        """Return True if part counts may start from runs of a curve: with the default components."""
        return (
            self.curve
            and [type(refiner) for refiner in refiners] == [InterfaceRefiner]
            and type(fixer) is ConnectivityFixer
            and [type(refiner) for refiner in post_refiners[:1]] == [CompactnessRefiner]
        )

    def grow(self, graph: Graph, pieces: Int, refiners: Sequence[Any], fixer: Any) -> PieceGrowth | None:
        """Return all recursive splits as one compiled call, or None unless refiners and fixer are built in.

        Only the built-in refiner, or none, and the built-in fixer allow this.
        """
        from agglo_kmeans.kernel import split_by_means

        return PieceGrowth.for_components(graph, pieces, split_by_means, refiners, fixer)

    def partition(self, graph: Graph, target: Target, seed: int) -> Int:
        """Partition a graph by k-means with ``target.parts`` means, and return the labels ``(n,)``.

        The means start as equal-mass runs of a space-filling curve, or for a target size in 2-D as a
        hexagonal lattice, followed by a few Lloyd steps. Some labels may be unused. For a target size the
        number of parts is free. ``seed`` only matters with an ``effort``.
        """
        parts = target.parts or 1
        if self.search is None and target.h_star is None:
            return self._lloyd(graph, parts)
        if self.search is None:
            return self._around_lattice(graph, parts, _SIZE_SHARE, _SIZE_STEPS)
        start = self._around_lattice if self.search.objective == "solver" else self._lloyd
        return self.search.parts(graph, target, seed, start, self._bisected)

    def _around_lattice(self, graph: Graph, k: int, share: float = 1.0, steps: int = _LATTICE_STEPS) -> Int:
        """Partition around ``share`` times k lattice points if possible, otherwise by ``_lloyd``."""
        labels = lattice_parts(graph, max(1, round(share * k)))
        return self._lloyd(graph, k) if labels is None else _lloyd_steps(graph, labels, steps)

    def _bisected(self, graph: Graph, target: Target) -> Int:
        """Partition a connected graph by recursive bisection, and return the labels."""
        growth = self.grow(graph, frozen_int(np.zeros(graph.n)), [InterfaceRefiner()], ConnectivityFixer())
        assert growth is not None  # refiner and fixer are the built-in ones
        seeds = np.zeros(1, np.uint64)
        if target.h_star is None:
            return growth.split(frozen_int([target.parts or 1]), seeds, ignore_progress)[0]
        return growth.split_to_size(SizeGoal(target.h_star).limit, seeds, ignore_progress)[0]

    def _lloyd(self, graph: Graph, k: int) -> Int:
        """Partition into at most k parts by Lloyd steps from equal-mass runs of a space-filling curve."""
        mass = _positive(graph.mass)
        order = curve_order(graph.centroids)
        rank = np.cumsum(mass[order]) - 0.5 * mass[order]
        labels = np.empty(graph.n, np.int64)
        labels[order] = np.minimum((rank / mass.sum() * k).astype(np.int64), k - 1)
        return _lloyd_steps(graph, labels, self.iterations)


def _lloyd_steps(graph: Graph, labels: Int, steps: int) -> Int:
    """Assign each cell to the nearest mean of a part, ``steps`` times, and return the labels."""
    weights = _positive(graph.weights)
    for _ in range(steps):
        used, labels = np.unique(labels, return_inverse=True)
        total = np.bincount(labels, weights, minlength=len(used))
        means = [np.bincount(labels, weights * x) / total for x in graph.centroids.T]
        labels = cKDTree(np.stack(means, axis=1)).query(graph.centroids)[1]
    return frozen_int(labels)


def _positive(weights: Float) -> Float:
    """Make weights positive: if some are 0, add the mean to all."""
    return weights if weights.all() else weights + (weights.mean() or 1.0)
