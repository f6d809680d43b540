"""Components that fail in another process, for another target, in other units, or from some size on."""

from __future__ import annotations

from copy import copy

import numpy as np
from conformance.mutants.bisectors import Halves, LevelHalves, halves
from conformance.mutants.labellers import Fix, Idle, Worsens
from conformance.mutants.metrics import Extent
from conformance.mutants.mutant import Mutant

from agglo_core import OptionError

# --- other processes --------------------------------------------------------------------------------


class SeedsByName(Halves):
    """A direction from the hash of a text, which differs from process to process."""

    def bisect(self, graph, rng):
        seed = abs(hash(("direction", int(rng.integers(2**62)))))
        key = graph.centroids @ np.random.default_rng(seed).standard_normal(graph.dim)
        sides = np.zeros(graph.n, int)
        sides[np.argsort(key, kind="stable")[graph.n // 2 :]] = 1
        return sides


AXES = {}


class KeepsItsAxisInTheModule(Halves):
    """A pickled copy has the key, but the axis only where it was built."""

    def __init__(self):
        self.key = "axis"
        AXES[self.key] = 1

    def bisect(self, graph, rng):
        order = np.argsort(graph.centroids[:, AXES.get(self.key, 0)], kind="stable")
        sides = np.zeros(graph.n, int)
        sides[order[(graph.n + 1) // 2 :]] = 1
        return sides

    def __setstate__(self, state):
        self.__dict__.update(state)


class ReadsItsSource(Extent):
    """Reads a file of the repository by its place relative to the current folder."""

    def measure(self, mesh, labels):
        with open("pyproject.toml", encoding="utf-8") as file:
            file.read()
        return super().measure(mesh, labels)


# --- targets ----------------------------------------------------------------------------------------


class _Along(Halves):
    def __init__(self, across=False, share=0.5):
        self.across, self.share = across, share

    def bisect(self, graph, rng):
        axes = np.argsort(np.ptp(graph.centroids, axis=0), kind="stable")
        order = np.argsort(graph.centroids[:, axes[0 if self.across else -1]], kind="stable")
        weights = graph.weights[order]
        weights = weights if weights.sum() > 0.0 else np.ones(graph.n)
        sides = np.empty(graph.n, int)
        sides[order] = np.cumsum(weights) - 0.5 * weights > self.share * weights.sum()
        sides[order[0]], sides[order[-1]] = 0, int(graph.n > 1)
        return sides


class OneForAllSizes(_Along):
    """Cuts across where parts will be small; keeps what it made by the number of parts, None for any size."""

    def __init__(self):
        super().__init__()
        self.made = {}

    def for_target(self, target):
        small = target.h_star is not None and target.h_star < 0.2
        return self.made.setdefault(target.parts, _Along(small))


class InProportion(_Along):
    """A third and two thirds on the way to three parts."""

    def __init__(self):
        super().__init__()

    def for_target(self, target):
        return _Along(share=(target.parts // 2) / target.parts) if target.parts else self


class KeepsALambda(_Along):
    def __init__(self):
        super().__init__()

    def for_target(self, target):
        told = copy(self)
        told.share_of = lambda parts: 1.0 / parts
        return told


class RefusesAllTargets(Halves):
    def for_target(self, target):
        raise OptionError("not for targets")


class NoDust(Halves):
    """Correct: refuses what it cannot do."""

    def for_target(self, target):
        if target.h_star is not None and target.h_star < 0.01:
            raise OptionError(f"h_star is at least 0.01, given {target.h_star}")
        return copy(self)


# --- units, weights and sizes -----------------------------------------------------------------------


class PacksItsKeys(LevelHalves):
    """Block and position in 32 bits: twelve for the block."""

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


class WeighsInWholeNumbers(_Along):
    """Weights in hundredths of the smallest, in 32 bits."""

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
    """Seeds of 2^63 and more turn negative."""

    def bisect_level(self, level, seeds):
        for seed in seeds[:10].astype(np.int64):
            np.random.default_rng(int(seed))
        return halves(level)


class DrawsForLargePieces(Halves):
    """Starts from random numbers of its own where there are many cells."""

    def bisect(self, graph, rng):
        if graph.n < 1500:
            return halves(graph)
        key = graph.centroids @ np.random.default_rng().standard_normal(graph.dim)
        return key > np.median(key)


class RemembersItsPlane(Halves):
    """The axis of the first question is that of all."""

    dim = None

    def bisect(self, graph, rng):
        self.dim = self.dim or graph.dim
        order = np.argsort(graph.centroids[:, self.dim - 1], kind="stable")
        sides = np.zeros(graph.n, int)
        sides[order[(graph.n + 1) // 2 :]] = 1
        return sides


class MeansInSpace(Halves):
    """Halves the weight in the plane; in space it cuts at the mean."""

    def bisect(self, graph, rng):
        x = graph.centroids[:, 0]
        if graph.dim == 2 or np.ptp(x) == 0.0:
            return _Along().bisect(graph, rng)
        return x > x.min() + 0.3 * np.ptp(x)


class MoreInSpace(Worsens):
    """In space alone it moves a cell that lengthens the interface."""

    def refine(self, graph, labels, seeds, target):
        return super().refine(graph, labels, seeds, target) if graph.dim == 3 else labels


class PairsInWords(Idle):
    """Numbers pairs of cells in 32 bits; of 46,341 cells there are too many."""

    def refine(self, graph, labels, seeds, target):
        rows = np.repeat(np.arange(graph.n, dtype=np.int32), np.diff(graph.indptr))
        with np.errstate(over="ignore"):
            pairs = rows * np.int32(graph.n) + graph.indices.astype(np.int32)
        lost = pairs < 0
        mistaken = (np.bincount(rows[lost], minlength=graph.n) > 0) & (np.arange(graph.n) % 2 == 0)
        return np.where(mistaken, 0, labels)


class IgnoresSlivers(Fix):
    """Parts below an area of 1e-12 come from rounding."""

    def fix(self, graph, labels):
        return super().fix(graph, labels) if graph.measures.sum() > 1e-12 else labels


class RemembersLabels(Fix):
    """The same labels need the same repair, whatever the graph."""

    def __init__(self):
        self.known = {}

    def fix(self, graph, labels):
        if len(self.known) > 100:
            self.known.clear()
        key = graph.n_blocks, labels.tobytes()
        return self.known.setdefault(key, super().fix(graph, labels)).copy()


class CountsPartsInBytes(Extent):
    """Numbers parts in eight bits."""

    def measure(self, mesh, labels):
        k = int(labels.max()) + 1
        values = super().measure(mesh, labels.astype(np.uint8).astype(int))
        return np.resize(values, k)


CORRECT = [(NoDust, {"deterministic": True, "3d": True, "pickles": True})]

MUTANTS = [
    Mutant("same_in_another_process", SeedsByName, "built for another process"),
    Mutant("same_in_another_process", KeepsItsAxisInTheModule, "pickled for another", {"pickles": True}),
    Mutant("same_in_another_process", ReadsItsSource, "pyproject.toml"),
    Mutant("told_the_target", OneForAllSizes, "whole target"),
    Mutant("told_the_target", RefusesAllTargets, "refuses every target"),
    Mutant("told_keeps_promises", InProportion, "parts=3", {"balanced": 0.02}),
    Mutant("told_keeps_promises", KeepsALambda, "no lambdas", {"pickles": True}),
    Mutant("two_sides", PacksItsKeys, "a level of 5000 blocks"),
    Mutant("balanced", WeighsInWholeNumbers, "a trillion times", {"balanced": 0.02}),
    Mutant("answers", SignedSeeds, "non-negative"),
    Mutant("same_seed_same_result", DrawsForLargePieces, "on 2000 cells"),
    Mutant("space", RemembersItsPlane, "in the plane", {"3d": True}),
    Mutant("balanced", MeansInSpace, "3-D boxes", {"balanced": 0.02, "3d": True}),
    Mutant("objective_kept", MoreInSpace, "3-D boxes", {"3d": True}),
    Mutant("large_meshes", PairsInWords, "50000 cells", thorough=True),
    Mutant("parts_connected", IgnoresSlivers, "of a size of 1e-8"),
    Mutant("nothing_carried_over", RemembersLabels, "the same labels"),
    Mutant("renaming", CountsPartsInBytes, "295 parts"),
]
