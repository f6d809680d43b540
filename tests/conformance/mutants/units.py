"""Components that fail for thousands of blocks, extreme weights and units, in 3-D, or above some size."""

from __future__ import annotations

import numpy as np
from conformance.mutants.bisectors import Halves, LevelHalves, halves
from conformance.mutants.elsewhere import Along
from conformance.mutants.labellers import Fix, Idle, Worsens
from conformance.mutants.metrics import Extent
from conformance.mutants.mutant import Mutant


class PacksItsKeys(LevelHalves):
    """Pack block and position into 32 bits, with twelve bits for the block."""

    def bisect_level(self, level, seeds):
        low = np.minimum.reduceat(level.centroids, level.offsets[:-1], axis=0)
        extent = np.maximum.reduceat(level.centroids, level.offsets[:-1], axis=0) - low
        extent, away = extent.max(axis=1), (level.centroids - low[level.block_ids]).max(axis=1)
        place = away / np.where(extent > 0.0, extent, 1.0)[level.block_ids]
        key = level.block_ids.astype(np.uint32) << np.uint32(20)
        order = np.argsort(key | (place * (2**20 - 1)).astype(np.uint32), kind="stable")
        rank = np.arange(level.n) - level.offsets[level.block_ids]
        sides = np.empty(level.n, int)
        sides[order] = rank >= (level.sizes[level.block_ids] + 1) // 2
        return sides


class WeighsInWholeNumbers(Along):
    """Round weights to hundredths of the smallest weight, in 32 bits."""

    def __init__(self):
        super().__init__()

    def bisect(self, graph, rng):
        positive = graph.weights[graph.weights > 0.0]
        unit = positive.min() / 100 if len(positive) else 1.0
        whole = np.rint(graph.weights / unit).astype(np.int64).astype(np.int32)
        order = np.argsort(graph.centroids[:, np.argmax(np.ptp(graph.centroids, axis=0))], kind="stable")
        total = np.cumsum(whole[order], dtype=np.int32)
        sides = np.empty(graph.n, int)
        sides[order] = 2 * total.astype(np.int64) - whole[order] > total[-1]
        sides[order[0]], sides[order[-1]] = 0, int(graph.n > 1)
        return sides


class SignedSeeds(LevelHalves):
    """Convert seeds to signed integers, so that seeds from 2^63 on are negative."""

    def bisect_level(self, level, seeds):
        for seed in seeds[:10].astype(np.int64):
            np.random.default_rng(int(seed))
        return halves(level)


class DrawsForLargePieces(Halves):
    """Draw unseeded random numbers for large pieces."""

    def bisect(self, graph, rng):
        if graph.n < 1500:
            return halves(graph)
        key = graph.centroids @ np.random.default_rng().standard_normal(graph.dim)
        return key > np.median(key)


class RemembersItsPlane(Halves):
    """Use the axis of the first call for all calls."""

    dim = None

    def bisect(self, graph, rng):
        self.dim = self.dim or graph.dim
        order = np.argsort(graph.centroids[:, self.dim - 1], kind="stable")
        sides = np.zeros(graph.n, int)
        sides[order[(graph.n + 1) // 2 :]] = 1
        return sides


class MeansInSpace(Halves):
    """Halve the weight in 2-D, but cut at the mean in 3-D."""

    def bisect(self, graph, rng):
        x = graph.centroids[:, 0]
        if graph.dim == 2 or np.ptp(x) == 0.0:
            return Along().bisect(graph, rng)
        return x > x.min() + 0.3 * np.ptp(x)


class MoreInSpace(Worsens):
    """Move a cell so that the interface grows, only in 3-D."""

    def refine(self, graph, labels, seeds, target):
        return super().refine(graph, labels, seeds, target) if graph.dim == 3 else labels


class PairsInWords(Idle):
    """Number pairs of cells in 32 bits, which overflows at 46,341 cells."""

    def refine(self, graph, labels, seeds, target):
        rows = np.repeat(np.arange(graph.n, dtype=np.int32), np.diff(graph.indptr))
        with np.errstate(over="ignore"):
            pairs = rows * np.int32(graph.n) + graph.indices.astype(np.int32)
        lost = pairs < 0
        mistaken = (np.bincount(rows[lost], minlength=graph.n) > 0) & (np.arange(graph.n) % 2 == 0)
        return np.where(mistaken, 0, labels)


class IgnoresSlivers(Fix):
    """Skip the repair if the total measure is below 1e-12."""

    def fix(self, graph, labels):
        return super().fix(graph, labels) if graph.measures.sum() > 1e-12 else labels


class RemembersLabels(Fix):
    """Cache repairs by labels, independent of the graph."""

    def __init__(self):
        self.known = {}

    def fix(self, graph, labels):
        if len(self.known) > 100:
            self.known.clear()
        key = graph.n_blocks, labels.tobytes()
        return self.known.setdefault(key, super().fix(graph, labels)).copy()


class CountsPartsInBytes(Extent):
    """Number parts in eight bits."""

    def measure(self, mesh, labels):
        k = int(labels.max()) + 1
        values = super().measure(mesh, labels.astype(np.uint8).astype(int))
        return np.resize(values, k)


MUTANTS = [
    Mutant("two_sides", PacksItsKeys, "6000 blocks"),
    Mutant("balanced", WeighsInWholeNumbers, "promise a wider tolerance", {"balanced": 0.02}),
    Mutant("answers", SignedSeeds, "non-negative"),
    Mutant("same_seed_same_result", DrawsForLargePieces, "on a graph of 2"),
    Mutant("space", RemembersItsPlane, "on a 2-D mesh", {"3d": True}),
    Mutant("balanced", MeansInSpace, "promise a wider tolerance", {"balanced": 0.02, "3d": True}),
    Mutant("objective_kept", MoreInSpace, "interface went from", {"3d": True}),
    Mutant("components_not_raised", PairsInWords, "neighbours in its part", thorough=True),
    Mutant("components_not_raised", IgnoresSlivers, "give every piece"),
    Mutant("nothing_carried_over", RemembersLabels, "the same size"),
    Mutant("renaming", CountsPartsInBytes, "must belong to label i"),
]
CORRECT: list[tuple[object, dict[str, bool]]] = []
