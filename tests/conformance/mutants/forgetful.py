"""Components that fail after other calls, during other calls, or by changing the surrounding program."""

from __future__ import annotations

import os
import sys
import warnings
from copy import copy
from functools import lru_cache
from threading import Lock

import numpy as np
from conformance.mutants.bisectors import Halves, LevelHalves, OnlyPartition, halves
from conformance.mutants.labellers import Fix, Idle
from conformance.mutants.metrics import Extent
from conformance.mutants.mutant import Mutant

# --- surroundings -----------------------------------------------------------------------------------


class SilencesNumpy(Halves):
    def bisect(self, graph, rng):
        np.seterr(all="ignore")
        return halves(graph)


class SilencesNumpyWhenBuilt(Halves):
    def __init__(self):
        np.seterr(invalid="ignore", divide="ignore")


class FiltersWarnings(Idle):
    def refine(self, graph, labels, seeds, target):
        warnings.simplefilter("ignore", ResourceWarning)
        return labels


class SetsTheEnvironment(Halves):
    def bisect(self, graph, rng):
        os.environ["OMP_NUM_THREADS"] = "17"  # not set by any pytest worker
        return halves(graph)


class LeavesAFile(Fix):
    def fix(self, graph, labels):
        np.save("labels.npy", labels)
        return super().fix(graph, labels)


class GoesElsewhere(Halves):
    def bisect(self, graph, rng):
        os.chdir("/")
        return halves(graph)


class RecursesDeeper(Extent):
    def measure(self, mesh, labels):
        sys.setrecursionlimit(12_345)
        return super().measure(mesh, labels)


class WritesToStdout(Halves):
    def bisect(self, graph, rng):
        os.write(1, b"from compiled code\n")
        return halves(graph)


# --- history ----------------------------------------------------------------------------------------


class CachesByCount(Halves):
    def __init__(self):
        self.sides = {}

    def bisect(self, graph, rng):
        return self.sides.setdefault(graph.n, halves(graph))


class CachesByTopology(LevelHalves):
    """Cache results for the class by all data except the geometry."""

    known = {}  # noqa: RUF012 - the bug

    def bisect_level(self, level, seeds):
        key = level.indptr.tobytes(), level.indices.tobytes()
        return self.known.setdefault(key, halves(level))


class MeasuresOnce(Extent):
    def __init__(self):
        self.values = {}

    def measure(self, mesh, labels):
        key = mesh.n_cells, int(labels.max())
        uneven = np.round(np.ptp(mesh.cell_measures) / mesh.cell_measures.max(), 4)
        return self.values.setdefault(key, super().measure(mesh, labels) * uneven)


class ReusesItsArray(Halves):
    def __init__(self):
        self.sides = np.empty(0, int)

    def bisect(self, graph, rng):
        if len(self.sides) != graph.n:
            self.sides = np.empty(graph.n, int)
        self.sides[:] = halves(graph)
        return self.sides


class KeepsTheGraph(Halves):
    """Pass the graph to other methods through self."""

    def bisect(self, graph, rng):
        self.graph = graph
        order = self._order()
        sides = np.zeros(self.graph.n, int)
        sides[order[(self.graph.n + 1) // 2 :]] = 1
        return sides

    def _order(self):
        return np.lexsort((self.graph.centroids[:, 1], self.graph.centroids[:, 0]))


class KeepsWhatItDid(Halves):
    def __init__(self):
        self.history = []

    def bisect(self, graph, rng):
        sides = halves(graph)
        self.history.append(sides.copy())
        return sides


class KeepsGraphs(Halves):
    """Keep a correct cache that grows without bound."""

    def __init__(self):
        self.known = {}

    def bisect(self, graph, rng):
        self.known[id(graph)] = graph, halves(graph)
        return halves(graph)


class LeavesFilesOpen(Idle):
    opened = []  # noqa: RUF012 - the bug

    def refine(self, graph, labels, seeds, target):
        self.opened.append(os.open(os.devnull, os.O_RDONLY))
        return labels


# --- targets ----------------------------------------------------------------------------------------


class ForEachTarget(Halves):
    """Correct: splits across y if large numbers of parts are requested."""

    across = 0

    def for_target(self, target):
        told = copy(self)
        told.across = int((target.parts or 0) > 100)
        return told

    def bisect(self, graph, rng):
        order = np.lexsort((graph.centroids[:, 1 - self.across], graph.centroids[:, self.across]))
        sides = np.zeros(graph.n, int)
        sides[order[(graph.n + 1) // 2 :]] = 1
        return sides


class ChangesItself(ForEachTarget):
    def for_target(self, target):
        self.across = int((target.parts or 0) > 100)
        return self


class OneForEachCount(ForEachTarget):
    """Cache results by number of parts, which is None for every size."""

    def __init__(self, across=0):
        super().__init__()
        self.across, self.made = across, {}

    def for_target(self, target):
        across = int((target.h_star or 0.0) > 100.0)
        return self.made.setdefault(target.parts, type(self)(across))


class ForgetsToReturn(ForEachTarget):
    def for_target(self, target):
        self.target = target


class OneSidedWhenTold(ForEachTarget):
    def for_target(self, target):
        return OnlyLargeSides() if target.h_star else self


class OnlyLargeSides(Halves):
    def bisect(self, graph, rng):
        return graph.centroids[:, 0] > 100.0


class CountsAlone(Idle):
    """Require a number of parts, without support for sizes."""

    def refine(self, graph, labels, seeds, target):
        _ = 1.0 / target.parts
        return labels


class SizesAlone(Idle):
    def refine(self, graph, labels, seeds, target):
        _ = 1.0 / target.h_star
        return labels


# --- direct partitions ------------------------------------------------------------------------------


class Both(Halves, OnlyPartition):
    """Correct: bisections and direct partitions."""


class PartitionsByChance(Both):
    def partition(self, graph, target, seed):
        return np.random.permutation(super().partition(graph, target, seed))  # noqa: NPY002


class PartitionsAnyhow(Both):
    def partition(self, graph, target, seed):
        return np.random.default_rng().permutation(super().partition(graph, target, seed))


class PartitionsInPlace(Both):
    def partition(self, graph, target, seed):
        graph.centroids[:] -= graph.centroids.mean(axis=0)
        return super().partition(graph, target, seed)


class PartitionsLoudly(Both):
    def partition(self, graph, target, seed):
        print("parts:", target.parts)  # noqa: T201
        return super().partition(graph, target, seed)


class PartitionsInTurns(Both):
    turn = 0

    def partition(self, graph, target, seed):
        self.turn += 1
        return (super().partition(graph, target, seed) + self.turn) % target.parts


class PartitionsThePlane(Both):
    def partition(self, graph, target, seed):
        _, _ = graph.centroids.T
        return super().partition(graph, target, seed)


class PartitionsIntoBytes(Both):
    def partition(self, graph, target, seed):
        return super().partition(graph, target, seed).astype(np.int8)


# --- correct ----------------------------------------------------------------------------------------


class Locked(Halves):
    """Correct: keeps the graph in self, but under a lock."""

    def __init__(self):
        self.lock = Lock()

    def bisect(self, graph, rng):
        with self.lock:
            self.graph = graph
            return halves(self.graph)


class CachesByContent(Halves):
    """Correct: caches the last few answers by the full input."""

    def __init__(self):
        self.known = {}

    def bisect(self, graph, rng):
        key = graph.centroids.tobytes()
        if key not in self.known:
            if len(self.known) > 2:
                self.known.clear()
            self.known[key] = halves(graph)
        return self.known[key].copy()


class AnswersTheSame(Idle):
    """Correct: returns cached, read-only arrays of small integers, with another type than the input."""

    @staticmethod
    @lru_cache(maxsize=2)
    def _copied(text):
        return np.frombuffer(text, np.int64).astype(np.int32)

    def refine(self, graph, labels, seeds, target):
        return self._copied(np.ascontiguousarray(labels, np.int64).tobytes())


CORRECT = [
    (ForEachTarget, {"deterministic": True, "3d": True}),
    (Both, {"kway": True, "deterministic": True, "3d": True}),
    (Locked, {"deterministic": True, "3d": True}),
    (CachesByContent, {"deterministic": True}),
    (AnswersTheSame, {"deterministic": True}),
]

MUTANTS = [
    Mutant("surroundings_kept", SilencesNumpy, "np.seterr"),
    Mutant("surroundings_kept", SilencesNumpyWhenBuilt, "building it changed"),
    Mutant("surroundings_kept", FiltersWarnings, "the warning filters"),
    Mutant("surroundings_kept", SetsTheEnvironment, "environment variables"),
    Mutant("surroundings_kept", LeavesAFile, "labels.npy"),
    Mutant("surroundings_kept", GoesElsewhere, "the current folder"),
    Mutant("surroundings_kept", RecursesDeeper, "recursion"),
    Mutant("surroundings_kept", WritesToStdout, "from compiled code"),
    Mutant("nothing_carried_over", CachesByCount, "same size"),
    Mutant("nothing_carried_over", CachesByTopology, "same size"),
    Mutant("nothing_carried_over", MeasuresOnce, "same size"),
    Mutant("nothing_carried_over", ReusesItsArray, "a new one"),
    Mutant("in_two_threads", KeepsTheGraph, "between methods"),
    Mutant("lets_go", KeepsWhatItDid, "bytes behind"),
    Mutant("lets_go", KeepsGraphs, "still in memory"),
    Mutant("lets_go", LeavesFilesOpen, "files open"),
    Mutant("told_the_target", ChangesItself, "another target"),
    Mutant("told_the_target", OneForEachCount, "whole target"),
    Mutant("told_the_target", ForgetsToReturn, "expected an object"),
    Mutant("told_the_target", OneSidedWhenTold, "on one side"),
    Mutant("answers", CountsAlone, "TypeError"),
    Mutant("answers", SizesAlone, "TypeError"),
    Mutant("surroundings_kept", PartitionsByChance, "draw from"),
    Mutant("same_seed_same_result", PartitionsAnyhow, "same seed"),
    Mutant("answers", PartitionsInPlace, "change a copy"),
    Mutant("surroundings_kept", PartitionsLoudly, "logging"),
    Mutant("same_seed_same_result", PartitionsInTurns, "keep nothing between calls"),
    Mutant("space_served_or_refused", PartitionsThePlane, "only for 2-D"),
    Mutant("kway_labels", PartitionsIntoBytes, "expected 0..", {"kway": True}),
]
