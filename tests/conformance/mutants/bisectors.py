"""Correct bisectors, and bisectors that break one law first."""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
from conformance.mutants.mutant import Mutant

from agglo_core import Component, OptionError
from agglo_core.authoring import split_at_median
from agglo_core.split.geometric import CoordinateBisection


def halves(graph):
    """Return sides by the median of x, then y, in each block."""
    order = np.lexsort((graph.centroids[:, 1], graph.centroids[:, 0], graph.block_ids))
    sizes = np.diff(graph.offsets)[graph.block_ids]
    place = np.arange(graph.n) - graph.offsets[graph.block_ids]
    sides = np.empty(graph.n, np.int64)
    sides[order] = place >= (sizes + 1) // 2
    return sides


class Halves:
    def bisect(self, graph, rng):
        return halves(graph)


class LevelHalves:
    def bisect_level(self, level, seeds):
        return halves(level)


class GrowsStripes(CoordinateBisection):
    """Split across the longest side, but grow stripes along a fixed axis."""

    def grow(self, graph, pieces, refiners, fixer):
        turned = replace(graph, centroids=graph.centroids * ([1.0] + [1e-6] * (graph.dim - 1)))
        return CoordinateBisection().grow(turned, pieces, (), fixer)


class GrowsNothing(CoordinateBisection):
    """Split as usual, but fail in grow, which only runs call."""

    def grow(self, graph, pieces, refiners, fixer):
        raise KeyError("no such part")


class Probable(Halves):
    def bisect(self, graph, rng):
        return 0.1 + 0.8 * halves(graph)


class RandomCut:
    """Cut in a random direction drawn from the seed."""

    def bisect(self, graph, rng):
        score = graph.centroids @ rng.standard_normal(graph.dim)
        sides = np.zeros(graph.n, int)
        sides[np.argsort(score, kind="stable")[graph.n // 2 :]] = 1
        return sides


class OnlyPartition:
    def partition(self, graph, target, seed):
        return np.argsort(np.argsort(graph.centroids[:, 0], kind="stable")) * target.parts // graph.n


class AnyOption(Halves):
    def __init__(self, **options):
        self.options = options


def split_along(level, key):
    """Return sides by the median of a key in each block."""
    order = np.lexsort((key, level.block_ids))
    sides = np.empty(level.n, np.int64)
    place = np.arange(level.n) - level.offsets[level.block_ids]
    sides[order] = place >= (level.sizes[level.block_ids] + 1) // 2
    return sides


class LevelWideData:
    """Scale cell data by the maximum over the whole level instead of the block."""

    def bisect_level(self, level, seeds):
        key = level.centroids[:, 0].copy()
        for values in level.data.values():
            if values.ndim == 1:
                key += values / np.abs(values).max()
        return split_along(level, key)


class BoxOfAllPoints:
    """Use the bounding box of the points of all blocks instead of the block."""

    def bisect(self, graph, rng):
        axis = int(np.argmax(np.ptp(graph.points, axis=0)))
        return split_along(graph, graph.centroids[:, axis])


class AxisInThePlane:
    """Use the principal axis of x and y, even in 3-D."""

    def bisect(self, graph, rng):
        x = graph.centroids[:, :2] - graph.centroids[:, :2].mean(axis=0)
        return split_along(graph, x @ np.linalg.eigh(x.T @ x)[1][:, -1])


class CannotBuild(Halves):
    def __init__(self):
        raise ZeroDivisionError


class Anonymous(Halves):
    def __init__(self, **options):
        if options:
            raise OptionError("bad option")


class RaisesOnRings(Halves):
    def bisect(self, graph, rng):
        if graph.n > 4 and (np.diff(graph.indptr) == 2).all():
            raise RuntimeError("no ends")
        return halves(graph)


class ScalesInPlace(Halves):
    def bisect(self, graph, rng):
        weights = graph.weights
        weights /= weights.sum()
        return halves(graph)


class AddsData(Halves):
    def bisect(self, graph, rng):
        graph.data["seen"] = np.ones(graph.n)
        return halves(graph)


class ListOfSides(Halves):
    def bisect(self, graph, rng):
        return halves(graph).tolist()


class NamesOfSides(Halves):
    def bisect(self, graph, rng):
        return np.where(halves(graph), "right", "left")


class ColumnOfSides(LevelHalves):
    def bisect_level(self, level, seeds):
        return halves(level)[:, None]


class OneAndTwo(Halves):
    def bisect(self, graph, rng):
        return halves(graph) + 1


class FloatsAboveOne(Halves):
    def bisect(self, graph, rng):
        return 1.5 * halves(graph)


class NotANumber(Halves):
    def bisect(self, graph, rng):
        return np.where(halves(graph), np.nan, 0.0)


class OneSide(Halves):
    def bisect(self, graph, rng):
        return np.zeros(graph.n, int)


class GlobalNumpy(Halves):
    def bisect(self, graph, rng):
        return RandomCut().bisect(graph, np.random)


class GlobalPython(Halves):
    def bisect(self, graph, rng):
        return halves(graph) if random.random() < 0.5 else 1 - halves(graph)


class SeedsNumpy(Halves):
    def bisect(self, graph, rng):
        np.random.seed(0)  # noqa: NPY002 - the bug
        return RandomCut().bisect(graph, np.random)


class ForgetsTheSeed(Halves):
    def bisect(self, graph, rng):
        return RandomCut().bisect(graph, np.random.default_rng())


class SwapsSides(Halves):
    def __init__(self):
        self.swapped = False

    def bisect(self, graph, rng):
        self.swapped = not self.swapped
        return halves(graph) ^ self.swapped


class Prints(Halves):
    def bisect(self, graph, rng):
        print("cells:", graph.n)  # noqa: T201
        return halves(graph)


class CrashesOnOneCell(Halves):
    def bisect(self, graph, rng):
        _ = graph.centroids[graph.indices[0]]
        return halves(graph)


class LeftInOnePlace(Halves):
    def bisect(self, graph, rng):
        apart = np.ptp(graph.centroids, axis=0).max() > 0
        return halves(graph) if apart else np.zeros(graph.n, int)


class LevelWideScale(LevelHalves):
    """Compare cells with a third of the extent of the whole level."""

    def bisect_level(self, level, seeds):
        first = np.minimum.reduceat(level.centroids[:, 0], level.offsets[:-1])[level.block_ids]
        x = level.centroids[:, 0] - first
        sides = (x > 0.3 * x.max()).astype(int)
        ones = np.add.reduceat(sides, level.offsets[:-1])[level.block_ids]
        return np.where((ones > 0) & (ones < np.diff(level.offsets)[level.block_ids]), sides, halves(level))


class RemembersFirstBlock(Halves):
    def __init__(self):
        self.first = None

    def bisect(self, graph, rng):
        self.first = self.first or graph.n
        return halves(graph) if graph.n >= self.first / 4 else 1 - halves(graph)


class PlaneOnly(Halves):
    def bisect(self, graph, rng):
        _, _ = graph.centroids.T
        return halves(graph)


class FailsInSmallPieces(Halves):
    def bisect(self, graph, rng):
        if 9 < graph.n < 16:
            raise KeyError("a piece this small")
        return halves(graph)


class FromOne(Halves, OnlyPartition):
    def partition(self, graph, target, seed):
        return super().partition(graph, target, seed) + (target.parts > 2)


class TwoParts(OnlyPartition):
    def partition(self, graph, target, seed):
        return np.minimum(super().partition(graph, target, seed), 1)


class UnequalHalves(Halves):
    def bisect(self, graph, rng):
        sides = np.ones(graph.n, int)
        sides[np.argsort(graph.centroids[:, 0], kind="stable")[: max(1, graph.n // 5)]] = 0
        return sides


class SharesOfTheFirst(LevelHalves):
    def bisect_shares(self, level, seeds, shares):
        return split_at_median(level, level.centroids[:, 0], level.centroids, np.full_like(shares, shares[0]))


class OneSideInSpace(Halves):
    def bisect(self, graph, rng):
        return halves(graph) * (graph.dim == 2)


class HoldsALambda(Halves):
    def __init__(self):
        self.rule = lambda graph: halves(graph)


CORRECT = [
    (ListOfSides, {"deterministic": True}),
    (Halves, {"deterministic": True, "balanced": 0.4, "3d": True, "pickles": True}),
    (LevelHalves, {"deterministic": True, "balanced": 0.4, "3d": True, "pickles": True}),
    (Probable, {"deterministic": True, "3d": True}),
    (RandomCut, {"3d": True, "pickles": True}),
    (OnlyPartition, {"kway": True, "deterministic": True}),
]

MUTANTS = [
    Mutant("builds", AnyOption, "name each option"),
    Mutant("builds", CannotBuild, "ZeroDivisionError"),
    Mutant("builds", Component("bisector", "anonymous", f"{__name__}:Anonymous"), "does not name"),
    Mutant("side_array", RaisesOnRings, "no ends"),
    Mutant("answers", ScalesInPlace, "change a copy"),
    Mutant("surroundings_kept", AddsData, "work on a copy"),
    Mutant("answers", NamesOfSides, "integers or booleans or floats"),
    Mutant("answers", ColumnOfSides, "shape"),
    Mutant("side_array", OneAndTwo, "subtract the smallest"),
    Mutant("side_array", FloatsAboveOne, "probabilities of side 1"),
    Mutant("side_array", NotANumber, "probabilities of side 1"),
    Mutant("two_sides", OneSide, "split at the median"),
    Mutant("surroundings_kept", GlobalNumpy, "draw from the generator"),
    Mutant("surroundings_kept", GlobalPython, "draw from the generator"),
    Mutant("surroundings_kept", SeedsNumpy, "draw from the generator"),
    Mutant("same_seed_same_result", ForgetsTheSeed, "take all random numbers from the rng"),
    Mutant("same_seed_same_result", SwapsSides, "keep nothing between calls"),
    Mutant("surroundings_kept", Prints, "logging"),
    Mutant("answers", CrashesOnOneCell, "IndexError"),
    Mutant("two_sides", LeftInOnePlace, "return any halving"),
    Mutant("a_level_is_its_blocks", LevelWideScale, "within each block"),
    Mutant("a_level_is_its_blocks", LevelWideData, "within each block"),
    Mutant("a_level_is_its_blocks", BoxOfAllPoints, "within each block"),
    Mutant("a_level_is_its_blocks", RemembersFirstBlock, "nothing from the previous block"),
    Mutant("space_served_or_refused", PlaneOnly, "only for 2-D"),
    Mutant("side_array", FailsInSmallPieces, "a piece this small"),
    Mutant("works_in_a_run", GrowsNothing, "no such part"),
    Mutant("grows_alike", GrowsStripes, "use the same splits"),
    Mutant("promises_can_be_kept", Halves, "no method partition", {"kway": True}),
    Mutant("promises_can_be_kept", Component("bisector", "quiet", f"{__name__}:OnlyPartition"), "promise it"),
    Mutant("deterministic", RandomCut, "drop the promise deterministic", {"deterministic": True}),
    Mutant("connected", Halves, "drop the promise", {"connected": True}),
    Mutant("balanced", UnequalHalves, "promise a wider", {"balanced": 0.1}),
    Mutant("invariant", Halves, "principal axes", {"invariant": True}),
    Mutant("invariant", AxisInThePlane, "principal axes", {"invariant": True, "3d": True}),
    Mutant("kway_labels", FromOne, "expected 0..", {"kway": True}),
    Mutant("kway_parts", TwoParts, "the number requested", {"kway": True}),
    Mutant("shares_kept", SharesOfTheFirst, "was requested"),
    Mutant("two_sides", OneSideInSpace, "on one side", {"3d": True}),
    Mutant("pickles", HoldsALambda, "no lambdas", {"pickles": True}),
]
