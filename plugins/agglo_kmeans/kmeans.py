"""Batched deterministic 2-means, and k-means for direct k-way partitions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from scipy.spatial import cKDTree

from agglo_core.authoring import (
    ConnectivityFixer,
    Float,
    Graph,
    Int,
    InterfaceRefiner,
    OptionError,
    PartSearch,
    PieceGrowth,
    SizeGoal,
    Target,
    UInt64,
    curve_order,
    frozen_int,
    to_nobody,
)


class KMeans:
    """2-means on the cell centroids, weighted by ``graph.weights`` (paper, §2.2).

    All blocks are split in one call. Lloyd's iteration starts from the halves either side
    of a principal axis; where no axis stands out (ratio of principal moments above 0.8) eight rotated
    axes are tried and the least energy kept. In 3-D: three principal and four diagonal axes.
    Deterministic: no random numbers.

    Parameters
    ----------
    iterations : int
        Lloyd steps of the k-way ``partition``.
    effort : "fast", "good" or "best", optional
        Anneal the k-way partition: about 5, 50 or 500 ms for 300 cells, more for roundness. What the
        bisections find is returned where nothing better is found. Depends on the seed, and on how the mesh
        is turned.
    objective : "solver" or "roundness"
        What annealed parts are to be: of small moments of inertia with short interfaces, which solvers
        want; or round and of even width, with few parts of a given size.
    seconds : float, optional
        When annealing ends, by a clock on the wall, for each level and connected component: the best so far
        is returned, which then differs from run to run.
    balance : float, optional
        With an effort, and a number of parts: how far sizes of parts may be from their mean, relatively, if
        that is more than a cell; 0 makes numbers of cells differ by at most 1.
    size : "cells", "measure" or "weights", optional
        Quantity that is balanced. Default: that of the run (its ``weights=`` or ``balance=``), else cells.

    Raises
    ------
    OptionError
        If an option is anything else.
    """

    def __init__(
        self,
        iterations: int = 8,
        effort: Literal["fast", "good", "best"] | None = None,
        objective: Literal["solver", "roundness"] = "solver",
        seconds: float | None = None,
        balance: float | None = None,
        size: Literal["cells", "measure", "weights"] | None = None,
    ) -> None:
        if not isinstance(iterations, int) or isinstance(iterations, bool) or iterations < 0:
            raise OptionError(f"kmeans: iterations must be a whole number, 0 or more, given {iterations!r}")
        self.iterations = iterations
        self.search = PartSearch.checked("kmeans", effort, objective, seconds, balance, size)

    @property
    def final_parts(self) -> bool:
        """True if refiners and polish are to leave the k-way partition as it is."""
        return self.search is not None

    def bisect_level(self, level: Graph, seeds: UInt64) -> Int:
        """Side of each node ``(n,)``; ``seeds`` are not used."""
        from agglo_kmeans.kernel import two_means

        sides: Int = two_means(level.offsets, level.centroids, level.weights)
        return sides

    def grow(self, graph: Graph, pieces: Int, refiners: Sequence[Any], fixer: Any) -> PieceGrowth | None:
        """All splits of a run in one call; None unless refiner (if any) and fixer are the built-in ones."""
        from agglo_kmeans.kernel import split_by_means

        return PieceGrowth.for_components(graph, pieces, split_by_means, refiners, fixer)

    def partition(self, graph: Graph, target: Target, seed: int) -> Int:
        """Labels ``(n,)`` of a direct k-means with ``target.parts`` means.

        The means start as equal-mass runs of a space-filling curve; a few Lloyd steps follow. Some
        labels may be left unused. ``seed`` is used only with an ``effort``; then, if the target has a size,
        the number of parts is free.
        """
        if self.search is None:
            return self._lloyd(graph, target.parts or 1)
        return self.search.parts(graph, target, seed, self._lloyd, self._bisected)

    def _bisected(self, graph: Graph, target: Target) -> Int:
        """Labels that the bisections find for a connected graph."""
        growth = self.grow(graph, frozen_int(np.zeros(graph.n)), [InterfaceRefiner()], ConnectivityFixer())
        seeds = np.zeros(1, np.uint64)
        if target.h_star is None:
            return growth.split(frozen_int([target.parts or 1]), seeds, to_nobody)[0]
        return growth.split_to_size(SizeGoal(target.h_star).limit, seeds, to_nobody)[0]

    def _lloyd(self, graph: Graph, k: int) -> Int:
        """Labels of about k parts after some Lloyd steps."""
        weights, mass = _positive(graph.weights), _positive(graph.mass)
        order = curve_order(graph.centroids)
        rank = np.cumsum(mass[order]) - 0.5 * mass[order]
        labels = np.empty(graph.n, np.int64)
        labels[order] = np.minimum((rank / mass.sum() * k).astype(np.int64), k - 1)
        for _ in range(self.iterations):
            used, labels = np.unique(labels, return_inverse=True)
            total = np.bincount(labels, weights, minlength=len(used))
            means = [np.bincount(labels, weights * x) / total for x in graph.centroids.T]
            labels = cKDTree(np.stack(means, axis=1)).query(graph.centroids)[1]
        return frozen_int(labels)


def _positive(weights: Float) -> Float:
    """The weights, or all of them larger by their mean if some are 0."""
    return weights if weights.all() else weights + (weights.mean() or 1.0)
