"""Components each of which breaks one law first, and the sound ones they are made from."""

from __future__ import annotations

import random
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, spsolve_triangular

from agglo_core import Component, OptionError
from agglo_core.components.fixers import ConnectivityFixer
from agglo_core.conformance.laws.refiner import OBJECTIVES, loose_parts
from agglo_core.conformance.reference import TwoPointFlux
from agglo_core.problems import Diffusion, Linear


@dataclass(frozen=True)
class Mutant:
    """A component and the first law it breaks; ``says`` is part of the advice it gets."""

    law: str
    given: Any
    says: str = ""
    promises: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        name = self.given.name if isinstance(self.given, Component) else self.given.__name__
        return f"{self.law}-{name}"


# --- sound components -------------------------------------------------------------------------------


def halves(graph):
    """Sides by the median of x (then y) in each block."""
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


class Probable(Halves):
    def bisect(self, graph, rng):
        return 0.1 + 0.8 * halves(graph)


class RandomCut:
    """A cut in a direction drawn from the seed."""

    def bisect(self, graph, rng):
        score = graph.centroids @ rng.standard_normal(graph.dim)
        sides = np.zeros(graph.n, int)
        sides[np.argsort(score, kind="stable")[graph.n // 2 :]] = 1
        return sides


class OnlyPartition:
    def partition(self, graph, target, seed):
        return np.argsort(np.argsort(graph.centroids[:, 0], kind="stable")) * target.parts // graph.n


class Idle:
    objective = "interface"

    def refine(self, graph, labels, seeds, target):
        return labels


class Fix(ConnectivityFixer):
    pass


class Extent:
    """Number of cells over the number of all cells."""

    better = "high"
    bounds = (0.0, 1.0)
    homogeneity = 0

    def measure(self, mesh, labels):
        return np.bincount(labels) / len(labels)


class LinearOnly(TwoPointFlux):
    """Takes systems of one unknown per cell, as many algebraic methods do."""

    def solve(self, problem, hierarchy):
        if not isinstance(problem, Linear) or len(problem.b) != hierarchy.graph.n:
            raise OptionError("a Linear problem of one unknown per cell is wanted")
        return super().solve(problem, hierarchy)


class DiffusionOnly(TwoPointFlux):
    """Takes what it discretises itself."""

    def solve(self, problem, hierarchy):
        if not isinstance(problem, Diffusion):
            raise OptionError("a Diffusion is wanted")
        return super().solve(problem, hierarchy)


SOUND = [
    (Halves, {"deterministic": True, "balanced": 0.2, "3d": True, "pickles": True}),
    (LevelHalves, {"deterministic": True, "balanced": 0.2, "3d": True, "pickles": True}),
    (Probable, {"deterministic": True, "3d": True}),
    (RandomCut, {"3d": True, "pickles": True}),
    (OnlyPartition, {"kway": True, "deterministic": True}),
    (Idle, {"deterministic": True, "invariant": True, "3d": True, "pickles": True}),
    (Fix, {"deterministic": True, "invariant": True, "3d": True, "pickles": True}),
    (Extent, {"deterministic": True, "3d": True, "pickles": True}),
    (TwoPointFlux, {"deterministic": True, "symmetric": True, "3d": True, "pickles": True}),
    (LinearOnly, {"deterministic": True, "symmetric": True, "3d": True, "pickles": True}),
    (DiffusionOnly, {"deterministic": True, "3d": True, "pickles": True}),
]


# --- bisectors --------------------------------------------------------------------------------------


class AnyOption(Halves):
    def __init__(self, **options):
        self.options = options


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
        x = graph.centroids[:, 0]
        return halves(graph) if np.ptp(x) > 0 else np.zeros(graph.n, int)


class LevelWideScale(LevelHalves):
    """Cells further out than a third of the furthest of the level."""

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
        return halves(graph) if graph.n >= self.first / 100 else 1 - halves(graph)


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


class OneSideInSpace(Halves):
    def bisect(self, graph, rng):
        return halves(graph) * (graph.dim == 2)


class HoldsALambda(Halves):
    def __init__(self):
        self.rule = lambda graph: halves(graph)


# --- refiners and fixers ----------------------------------------------------------------------------


class ListOfLabels(Idle):
    def refine(self, graph, labels, seeds, target):
        return labels.tolist()


class FixesToFloats(Fix):
    def fix(self, graph, labels):
        return super().fix(graph, labels).astype(float)


class DropsALabel(Idle):
    def refine(self, graph, labels, seeds, target):
        return np.minimum(labels, max(labels.max() - 1, 0))


class RenumbersAcrossBlocks(Fix):
    def fix(self, graph, labels):
        return np.unique(
            graph.block_ids * (labels.max() + 1) + super().fix(graph, labels), return_inverse=True
        )[1]


class TearsApart(Idle):
    """Gives the cell in the middle of its part to another part."""

    def refine(self, graph, labels, seeds, target):
        before = loose_parts(graph, labels)
        for cell, label in ((c, p) for c in range(min(graph.n, 99)) for p in np.unique(labels)):
            moved = labels.copy()
            moved[cell] = label
            after = loose_parts(graph, moved)
            if after.keys() == before.keys() and any(after[part] > before[part] for part in after):
                return moved
        return labels


class Worsens(Idle):
    """Moves a cell that lengthens the interface."""

    def refine(self, graph, labels, seeds, target):
        before, length = loose_parts(graph, labels), OBJECTIVES["interface"](graph, labels)
        for cell, label in ((c, p) for c in range(min(graph.n, 99)) for p in np.unique(labels)):
            moved = labels.copy()
            moved[cell] = label
            after = loose_parts(graph, moved)
            whole = after.keys() == before.keys() and all(after[part] <= before[part] for part in after)
            if whole and OBJECTIVES["interface"](graph, moved) > 1.001 * length:
                return moved
        return labels


class UnknownObjective(Idle):
    objective = "beauty"


class Sleeps(Idle):
    def refine(self, graph, labels, seeds, target):
        time.sleep(0.3 * (graph.n > 1000))
        return labels


class DoesNothing(Fix):
    def fix(self, graph, labels):
        return labels


def _swapped(labels):
    return np.where(labels < 2, 1 - labels, labels)


class SwapsConnected(Fix):
    def fix(self, graph, labels):
        fixed = super().fix(graph, labels)
        plain = graph.n_blocks == 1 and {0, 1} <= set(labels.tolist())
        return _swapped(fixed) if plain and (fixed == labels).all() else fixed


class NeverDone(Fix):
    """Changes what it has fixed itself: three parts in one block."""

    def fix(self, graph, labels):
        fixed = super().fix(graph, labels)
        own = graph.n_blocks == 1 and labels.max() == 2
        return _swapped(fixed) if own and (fixed == labels).all() else fixed


class AcceptsDisconnected(Fix):
    def fix(self, graph, labels):
        try:
            return super().fix(graph, labels)
        except ValueError:
            return labels


class CountsBlocks(Fix):
    """Lets block 2 come out otherwise if there are many blocks."""

    def fix(self, graph, labels):
        fixed = super().fix(graph, labels)
        here = (graph.block_ids == 2) & (graph.n_blocks > 40)
        swap = here & (fixed[here] != labels[here]).any() & (fixed > 0)
        return np.where(swap, 3 - fixed, fixed)


# --- metrics ----------------------------------------------------------------------------------------


class NoBounds(Extent):
    bounds = None


class PerCell(Extent):
    def measure(self, mesh, labels):
        return super().measure(mesh, labels)[labels]


class MeanValue(Extent):
    def measure(self, mesh, labels):
        return float(super().measure(mesh, labels).mean())


class ZeroOverZero(Extent):
    def measure(self, mesh, labels):
        with np.errstate(invalid="ignore"):
            alone = (np.bincount(labels) - 1).astype(float)
            return super().measure(mesh, labels) * (alone / alone)


class OutOfBounds(Extent):
    def measure(self, mesh, labels):
        return np.bincount(labels).astype(float)


class StumblesOnHoles(Extent):
    def measure(self, mesh, labels):
        coarse = mesh.coarsen(labels)
        values = super().measure(mesh, labels)
        if mesh.dim == 3:
            return values
        loops = coarse.boundary_loops
        for cell in range(coarse.n_cells):
            for loop in range(*loops.cell_offsets[cell : cell + 2]):
                x, y = coarse.local_points[loops.vertices[slice(*loops.loop_offsets[loop : loop + 2])]].T
                if (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() < 0:
                    values[cell] = np.nan
        return values


class AreaCalledRatio(Extent):
    bounds = (0.0, inf)

    def measure(self, mesh, labels):
        return mesh.coarsen(labels).cell_measures


class WidthOverHeight(Extent):
    bounds = (0.0, inf)

    def measure(self, mesh, labels):
        x, y = (
            [np.ptp(mesh.local_centroids[labels == k, axis]) + mesh.h for k in range(labels.max() + 1)]
            for axis in (0, 1)
        )
        return np.array(x) / y


class ValuesByName(Extent):
    bounds = (0.0, inf)

    def measure(self, mesh, labels):
        return np.arange(labels.max() + 1.0)


class AlwaysOne(Extent):
    def measure(self, mesh, labels):
        return np.ones(labels.max() + 1)


class CountsCells(Extent):
    shape_only = True
    bounds = (1.0, inf)

    def measure(self, mesh, labels):
        return np.bincount(labels).astype(float)


# --- solvers ----------------------------------------------------------------------------------------


class RefusesAll(TwoPointFlux):
    def solve(self, problem, hierarchy):
        raise OptionError("not today")


class SquaresOnly(TwoPointFlux):
    """Refuses some diffusion problems of the plane and takes others."""

    def solve(self, problem, hierarchy):
        if isinstance(problem, Diffusion) and np.ptp(hierarchy.graph.measures) > 1e-9:
            raise OptionError("cells of one size are wanted")
        return super().solve(problem, hierarchy)


class NotLinear(LinearOnly):
    """Scales what a large right-hand side gives."""

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        if (problem.b > 2.0).any():
            it = replace(it, x=1.5 * it.x)
        return it


class NoFirstResidual(TwoPointFlux):
    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        return replace(it, residuals=it.residuals[1:])


class StopsEarly(TwoPointFlux):
    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        return replace(it, x=1.01 * it.x)


class OtherSystem(TwoPointFlux):
    """Doubles the right-hand side of a linear system and solves that."""

    def solve(self, problem, hierarchy):
        linear = isinstance(problem, Linear)
        return super().solve(replace(problem, b=2 * problem.b) if linear else problem, hierarchy)


class OptimisticResidual(TwoPointFlux):
    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        x = it.x * (1 + 1e-6)
        return replace(it, x=x)


class AlwaysConverged(TwoPointFlux):
    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        return replace(it, converged=True, reason="done")


class TransposedP(TwoPointFlux):
    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        (A, P), *rest = it.operators
        return replace(it, operators=[(A, P.T), *rest])


class NumbersOnly(TwoPointFlux):
    def solve(self, problem, hierarchy):
        if isinstance(problem, Diffusion) and not isinstance(problem.kappa, float):
            problem = replace(problem, kappa=1.0)
        return super().solve(problem, hierarchy)


class ForgetsKappa(TwoPointFlux):
    def solve(self, problem, hierarchy):
        problem = replace(problem, kappa=1.0) if isinstance(problem, Diffusion) else problem
        return super().solve(problem, hierarchy)


class OneComponentOnly(TwoPointFlux):
    def solve(self, problem, hierarchy):
        if hierarchy.graph.components().max() > 0:
            raise RuntimeError("the mesh must be connected")
        return super().solve(problem, hierarchy)


class GaussSeidel(TwoPointFlux):
    def aspreconditioner(self, problem, hierarchy):
        A = self.solve(problem, hierarchy).A
        lower = sparse.csr_array(sparse.tril(A))
        return LinearOperator(A.shape, matvec=lambda r: spsolve_triangular(lower, r), dtype=float)


MUTANTS = [
    Mutant("builds", AnyOption, "name each option"),
    Mutant("builds", CannotBuild, "ZeroDivisionError"),
    Mutant("builds", Component("bisector", "anonymous", f"{__name__}:Anonymous"), "does not name"),
    Mutant("promises_can_be_kept", Extent, "leave it out", {"balanced": 0.1}),
    Mutant("answers", RaisesOnRings, "no ends"),
    Mutant("answers", RefusesAll, "refuses every problem"),
    Mutant("answers", SquaresOnly, "cells of one size"),
    Mutant("input_untouched", ScalesInPlace, "change a copy"),
    Mutant("input_untouched", AddsData, "work on a copy"),
    Mutant("side_array", ListOfSides, "np.asarray"),
    Mutant("side_array", ColumnOfSides, "shape"),
    Mutant("side_values", OneAndTwo, "subtract the smallest"),
    Mutant("side_values", FloatsAboveOne, "probabilities of side 1"),
    Mutant("side_values", NotANumber, "probabilities of side 1"),
    Mutant("two_sides", OneSide, "split at the median"),
    Mutant("label_array", ListOfLabels, "np.asarray"),
    Mutant("label_array", FixesToFloats, "integers"),
    Mutant("parts_kept", DropsALabel, "lost its last cell"),
    Mutant("parts_kept", RenumbersAcrossBlocks, "block"),
    Mutant("components_not_raised", TearsApart, "fell apart"),
    Mutant("objective_kept", Worsens, "return the labels you were given"),
    Mutant("objective_kept", UnknownObjective, "beauty"),
    Mutant("bounded_time", Sleeps, "number of sweeps"),
    Mutant("parts_connected", DoesNothing, "in pieces"),
    Mutant("connected_left_alone", SwapsConnected, "nothing was broken"),
    Mutant("fixed_once", NeverDone, "its own result"),
    Mutant("disconnected_block_refused", AcceptsDisconnected, "raise a ValueError"),
    Mutant("declares_itself", NoBounds, "expected (lowest, highest)"),
    Mutant("value_array", PerCell, "not one per cell"),
    Mutant("value_array", MeanValue, "not a mean"),
    Mutant("finite", ZeroOverZero, "no denominator"),
    Mutant("within_bounds", OutOfBounds, "declare wider bounds"),
    Mutant("holes", StumblesOnHoles, "no single outer loop"),
    Mutant("homogeneous", AreaCalledRatio, "divide by a length"),
    Mutant("rigid_motion", WidthOverHeight, "not coordinates"),
    Mutant("renaming", ValuesByName, "belong to label i"),
    Mutant("hand_values", Component("metric", "convexity", f"{__name__}:AlwaysOne"), "definition"),
    Mutant("shape_only_is_true", CountsCells, "drop shape_only"),
    Mutant("solution_record", NoFirstResidual, "the first is that of the start"),
    Mutant("solves", StopsEarly, "direct solution"),
    Mutant("own_system_kept", OtherSystem, "undo any scaling"),
    Mutant("true_residual", OptimisticResidual, "recompute it from x"),
    Mutant("failure_flagged", AlwaysConverged, "compare the true residual"),
    Mutant("operators_chain", TransposedP, "expected"),
    Mutant("field_forms_agree", NumbersOnly, "than as numbers"),
    Mutant("linear_in_the_data", ForgetsKappa, "twice the coefficient"),
    Mutant("linear_in_the_data", NotLinear, "twice the right-hand side"),
    Mutant("disconnected_solved", OneComponentOnly, "must be connected"),
    Mutant("global_random_state", GlobalNumpy, "draw from the generator"),
    Mutant("global_random_state", GlobalPython, "draw from the generator"),
    Mutant("global_random_state", SeedsNumpy, "draw from the generator"),
    Mutant("same_seed_same_result", ForgetsTheSeed, "take all random numbers from the rng"),
    Mutant("no_memory", SwapsSides, "keep nothing between calls"),
    Mutant("says_nothing", Prints, "logging"),
    Mutant("survives", CrashesOnOneCell, "one cell"),
    Mutant("survives", LeftInOnePlace, "any halving will do"),
    Mutant("a_level_is_its_blocks", LevelWideScale, "within each block"),
    Mutant("a_level_is_its_blocks", RemembersFirstBlock, "nothing from the block before"),
    Mutant("a_level_is_its_blocks", CountsBlocks, "within each block"),
    Mutant("space_served_or_refused", PlaneOnly, "only for 2-D"),
    Mutant("works_in_a_run", FailsInSmallPieces, "a piece this small"),
    Mutant("kway_said", Halves, "no method partition", {"kway": True}),
    Mutant("kway_said", Component("bisector", "quiet", f"{__name__}:OnlyPartition"), "promise it"),
    Mutant("deterministic", RandomCut, "does not promise deterministic", {"deterministic": True}),
    Mutant("connected", Halves, "drop the promise", {"connected": True}),
    Mutant("balanced", UnequalHalves, "promise a wider", {"balanced": 0.1}),
    Mutant("invariant", Halves, "principal axes", {"invariant": True}),
    Mutant("kway_labels", FromOne, "expected 0..", {"kway": True}),
    Mutant("kway_parts", TwoParts, "how many are wanted", {"kway": True}),
    Mutant("space", OneSideInSpace, "all on one side", {"3d": True}),
    Mutant("pickles", HoldsALambda, "no lambdas", {"pickles": True}),
    Mutant("symmetric", GaussSeidel, "mirror", {"symmetric": True}),
]

NEWCOMERS = [
    OneAndTwo,
    ListOfSides,
    ForgetsTheSeed,
    LevelWideScale,
    ScalesInPlace,
    FloatsAboveOne,
    SwapsSides,
    CrashesOnOneCell,
    DropsALabel,
    GlobalNumpy,
]
"""Ten bugs that newcomers make."""


class Hangs(Halves):
    def bisect(self, graph, rng):
        while True:
            time.sleep(0.01)


class HangsWhenBuilt(Halves):
    def __init__(self):
        time.sleep(1000)


class Dies(Halves):
    def bisect(self, graph, rng):
        import os

        os._exit(7)
