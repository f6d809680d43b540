"""Components that confuse contact with adjacency, or work only without ties or only in 2-D."""

from __future__ import annotations

import numpy as np
from conformance.mutants.bisectors import Halves, OnlyPartition
from conformance.mutants.mutant import Mutant

from agglo_core.split.geometric import InertialBisection


class GrowsOverPoints(Halves):
    """Collect half of the cells in order of reachability over common points."""

    def bisect(self, graph, rng):
        owner = np.repeat(np.arange(graph.n), np.diff(graph.vertex_offsets))
        reached = np.zeros(graph.n, bool)
        reached[np.lexsort(graph.centroids.T)[0]] = True
        while True:
            points = np.unique(graph.vertices[reached[owner]])
            more = np.zeros(graph.n, bool)
            more[owner[np.isin(graph.vertices, points)]] = True
            more &= ~reached
            found = np.flatnonzero(more)[: graph.n // 2 - reached.sum()]
            if not len(found):
                return ~reached if reached.any() and not reached.all() else np.arange(graph.n) > 0
            reached[found] = True


class DrawsThePartition(OnlyPartition):
    """Promise deterministic answers, but draw direct partitions at random."""

    def partition(self, graph, target, seed):
        drawn = np.random.default_rng(seed).permutation(graph.n)
        return np.asarray(super().partition(graph, target, seed))[drawn]


class LengthsInThePlane:
    """Treat the root of a measure as a length, and move cells at the end where this length is large."""

    def bisect(self, graph, rng):
        sides = np.asarray(InertialBisection().bisect_level(graph, np.zeros(1, np.uint64)))
        if graph.dim == 2 or graph.n < 9:
            return sides
        long = np.sqrt(graph.measures.mean()) > np.ptp(graph.centroids, axis=0).max() / 4
        centred = graph.centroids - graph.centroids.mean(axis=0)
        order = np.argsort(np.linalg.norm(centred, axis=1))
        return np.where(long & np.isin(np.arange(graph.n), order[-2:]), 1 - sides, sides)


class TiesByHash(Halves):
    """Break ties within a tenth of the extent by the hash of a string."""

    def bisect(self, graph, rng):
        drawn = np.random.default_rng(abs(hash(f"halves of {graph.n}"))).random(graph.n)
        x = graph.centroids[:, int(np.argmax(np.ptp(graph.centroids, axis=0)))]
        sides = np.zeros(graph.n, int)
        sides[np.lexsort((drawn, np.round(x / max(np.ptp(x), 1e-300), 1)))[graph.n // 2 :]] = 1
        return sides


MUTANTS = [
    Mutant("connected", GrowsOverPoints, "a side is in", {"connected": True}),
    Mutant("deterministic", DrawsThePartition, "with another seed", {"deterministic": True, "kway": True}),
    Mutant("invariant", LengthsInThePlane, "scaled by 1e7", {"3d": True, "invariant": True}),
    Mutant("same_in_another_process", TiesByHash, "hash"),
]
CORRECT: list[tuple[object, dict[str, bool]]] = []
