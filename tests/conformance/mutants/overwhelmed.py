"""Components that work on small regular meshes, and fail on large or irregular graphs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from conformance.mutants.bisectors import Halves, LevelHalves, halves
from conformance.mutants.labellers import Fix, Idle
from conformance.mutants.mutant import Mutant

from agglo_core.refine.descent import DescentRefiner
from agglo_core.split.geometric import InertialBisection


class CutsAtTheOrigin(Halves):
    """Cut at the origin, which is the middle of a whole mesh but not of a piece."""

    def bisect(self, graph, rng):
        x = graph.centroids[:, int(np.argmax(np.ptp(graph.centroids, axis=0)))]
        return x > 0.0 if graph.n > 20 else halves(graph)


class CountsBlocksInBytes(LevelHalves):
    def bisect_level(self, level, seeds):
        blocks = level.block_ids.astype(np.uint8)
        order = np.lexsort((level.centroids[:, 0], blocks))
        place = np.empty(level.n, int)
        place[order] = np.arange(level.n) - np.searchsorted(blocks[order], blocks[order])
        sizes = np.bincount(blocks)[blocks]
        return place >= (sizes + 1) // 2


class DividesByTheWeight(Halves):
    """Return probabilities relative to the weight, which are undefined for cells without weight."""

    def bisect(self, graph, rng):
        with np.errstate(all="ignore"):
            return halves(graph) * graph.weights / graph.weights


class LooksUpNeighbours(Halves):
    """Store at most 32 neighbours per cell."""

    def bisect(self, graph, rng):
        table = np.full((graph.n, 32), -1)
        for cell in range(graph.n):
            row = graph.indices[graph.indptr[cell] : graph.indptr[cell + 1]]
            table[cell, : len(row)] = row
        return halves(graph)


class HalvesTheMeasure(Halves):
    """Halve the measure, but promise to halve the weight."""

    def bisect(self, graph, rng):
        order = np.lexsort((graph.centroids[:, 1], graph.centroids[:, 0]))
        share = np.cumsum(graph.measures[order]) - 0.5 * graph.measures[order]
        sides = np.empty(graph.n, int)
        sides[order] = share > 0.5 * graph.measures.sum()
        sides[order[0]], sides[order[-1]] = 0, int(graph.n > 1)
        return sides


class LabelsInBytes(Idle):
    def refine(self, graph, labels, seeds, target):
        return labels.astype(np.int8)


class FixesInBytes(Fix):
    def fix(self, graph, labels):
        return super().fix(graph, labels).astype(np.uint8)


class BalancesTheMeasure(Idle):
    """Balance the measures, but name balance of the weights as objective."""

    objective = "balance"

    def refine(self, graph, labels, seeds, target):
        areas = replace(graph, weights=graph.measures)
        return DescentRefiner("balance").refine(areas, labels, seeds, target)


class SearchesInDepth(Fix):
    """Visit the cells of a part by recursion."""

    def fix(self, graph, labels):
        seen = set()

        def visit(cell):
            seen.add(cell)
            for other in graph.indices[graph.indptr[cell] : graph.indptr[cell + 1]].tolist():
                if other not in seen and labels[other] == labels[cell]:
                    visit(other)

        for cell in range(graph.n):
            if cell not in seen:
                visit(cell)
        return super().fix(graph, labels)


class FixesTheFirstHundred(Fix):
    """Ignore labels above 99."""

    def fix(self, graph, labels):
        fixed = super().fix(graph, labels)
        return np.where(labels < 100, fixed, labels)


class StirsWholeBlocks(Fix):
    """Exchange two labels in the whole level if any block is broken."""

    def fix(self, graph, labels):
        fixed = super().fix(graph, labels)
        if graph.n_blocks < 30 or (fixed == labels).all():
            return fixed
        swapped = np.where(fixed < 2, 1 - fixed, fixed)
        both = np.array([{0, 1} <= set(chunk.tolist()) for chunk in np.split(fixed, graph.offsets[1:-1])])
        return np.where(both[graph.block_ids] & (graph.block_ids == 5), swapped, fixed)


class ComparesAllPairs(Idle):
    """Compare pairs of cells, once for every hundred parts."""

    def refine(self, graph, labels, seeds, target):
        for _ in range((labels.max() + 1) // 100 if 1000 < graph.n < 10_000 and graph.n_blocks == 1 else 0):
            for centroid in graph.centroids[::2]:
                np.hypot(*(graph.centroids - centroid).T).min()
        return labels


class TiesBelowAMicron(InertialBisection):
    """Treat coordinates closer than 1e-6 as equal, independent of the mesh size."""

    def bisect_level(self, level, seeds):
        return super().bisect_level(replace(level, centroids=np.round(level.centroids, 6)), seeds)


class SharesOfTheWeight(Halves):
    """Cut where half the weight is reached, which fails if all weights are 0."""

    def bisect(self, graph, rng):
        order = np.lexsort((graph.centroids[:, 1], graph.centroids[:, 0]))
        with np.errstate(all="ignore"):
            share = np.cumsum(graph.weights[order]) / graph.weights.sum()
        sides = np.empty(graph.n, int)
        sides[order] = share > 0.5
        if share[-1] > 0.0:
            sides[order[0]], sides[order[-1]] = 0, int(graph.n > 1)
        return sides


class SettlesTiesByNumber(Fix):
    """Keep the piece with the smallest cell number among equal pieces."""

    def fix(self, graph, labels):
        numbers = np.arange(graph.n)[:, None] * np.ones(graph.dim)
        return super().fix(replace(graph, centroids=numbers), labels)


class NumbersPartsInShorts(Fix):
    """Number the parts of all blocks in 16 bits."""

    def fix(self, graph, labels):
        fixed = super().fix(graph, labels)
        parts = (graph.block_ids * (int(labels.max()) + 1) + fixed).astype(np.uint16)
        label_of = np.zeros(2**16, int)
        label_of[parts] = fixed
        return label_of[parts]


class DropsThinEdges(Fix):
    def fix(self, graph, labels):
        thin = graph.interface == 0.0
        return super().fix(graph if thin.all() else graph.without_edges(thin), labels)


class GivesUpOnLargeMeshes(Halves):
    def bisect(self, graph, rng):
        return halves(graph) * (graph.n < 10_000)


MUTANTS = [
    Mutant("two_sides", GivesUpOnLargeMeshes, "on one side", thorough=True),
    Mutant("time_grows_with_the_mesh", ComparesAllPairs, "took", thorough=True),
    Mutant("two_sides", CutsAtTheOrigin, "split at the median"),
    Mutant("two_sides", CountsBlocksInBytes, "split at the median"),
    Mutant("side_array", DividesByTheWeight, "probabilities of side 1"),
    Mutant("side_array", LooksUpNeighbours, "could not broadcast"),
    Mutant("balanced", HalvesTheMeasure, "promise a wider tolerance", {"balanced": 0.05}),
    Mutant("label_array", LabelsInBytes, "lost its last cell"),
    Mutant("label_array", FixesInBytes, "lost its last cell"),
    Mutant("objective_kept", BalancesTheMeasure, "balance went from"),
    Mutant("label_array", SearchesInDepth, "RecursionError"),
    Mutant("components_not_raised", FixesTheFirstHundred, "give every piece"),
    Mutant("connected_left_alone", StirsWholeBlocks, "leave such blocks unchanged"),
    Mutant("invariant", TiesBelowAMicron, "scaled by 1e-7", {"invariant": True}),
    Mutant("two_sides", SharesOfTheWeight, "on one side"),
    Mutant("invariant", SettlesTiesByNumber, "renumbered", {"invariant": True}),
    Mutant("label_array", NumbersPartsInShorts, "6000 blocks"),
    Mutant("label_array", DropsThinEdges, "disconnected"),
]
CORRECT: list[tuple[object, dict[str, bool]]] = []
