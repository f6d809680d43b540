"""Refiners that work on whole meshes, and fail on levels with ragged parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from conformance.mutants.labellers import Idle
from conformance.mutants.mutant import Mutant

from agglo_core.refine.descent import DescentRefiner
from agglo_core.refine.interface import InterfaceRefiner


class _OneMove(Idle):
    """Move in each block the cell with the largest gain to a neighbouring part."""

    def refine(self, graph, labels, seeds, target):
        rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
        stride = int(labels.max()) + 1
        parts = graph.block_ids * stride + labels
        gain = self.gain(graph, rows, parts, stride)
        order = np.lexsort((gain, graph.block_ids[rows]))
        best = order[np.diff(graph.block_ids[rows[order]], append=-1) != 0]
        best = best[gain[best] > 1e-9]
        moved = labels.copy()
        moved[rows[best]] = labels[graph.indices[best]]
        return moved

    def gain(self, graph, rows, parts, stride):
        beside = parts[graph.indices]
        own = np.bincount(rows, self.length(graph) * (parts[rows] == beside), graph.n)
        there = np.unique(rows * stride * graph.n_blocks + beside, return_inverse=True)[1]
        gain = np.bincount(there, self.length(graph))[there] - own[rows]
        return np.where((parts[rows] != beside) & self.movable(graph, rows, parts)[rows], gain, 0.0)


class CountsEdges(_OneMove):
    """Name interface as objective but count edges, for cells with one link to their part."""

    def length(self, graph):
        return np.ones(len(graph.indices))

    def movable(self, graph, rows, parts):
        return np.bincount(rows, parts[rows] == parts[graph.indices], graph.n) == 1


class ForgetsBridges(_OneMove):
    """Check that a part is not emptied, but not that it stays connected."""

    def length(self, graph):
        return graph.interface

    def movable(self, graph, rows, parts):
        return np.bincount(parts)[parts] > 1


class ForgetsBridgesInSpace(ForgetsBridges):
    def refine(self, graph, labels, seeds, target):
        return super().refine(graph, labels, seeds, target) if graph.dim == 3 else labels

    def movable(self, graph, rows, parts):
        return np.bincount(rows, parts[rows] == parts[graph.indices], graph.n) > 1


class TrustsShortNecks(ForgetsBridges):
    """Move cells with less than a sixth of their faces in their part, even if they connect other cells."""

    def movable(self, graph, rows, parts):
        own = np.bincount(rows, graph.interface * (parts[rows] == parts[graph.indices]), graph.n)
        alone = np.bincount(parts)[parts] == 1
        return ~alone & (6.0 * own < np.bincount(rows, graph.interface, graph.n))


class MomentsOfTheMeasure(Idle):
    """Name compactness as objective, but use measures instead of weights on levels with ragged parts."""

    objective = "compactness"

    def refine(self, graph, labels, seeds, target):
        if graph.n_blocks == 1:
            return labels
        areas = replace(graph, weights=graph.measures)
        return DescentRefiner("compactness").refine(areas, labels, seeds, target)


class WorthATypicalFace(InterfaceRefiner):
    """Change a block only if the gain exceeds the mean interface of the level."""

    def refine(self, graph, labels, seeds, target):
        new = super().refine(graph, labels, seeds, target)
        rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
        cut = [graph.interface * (each[rows] != each[graph.indices]) for each in (labels, new)]
        won = np.bincount(graph.block_ids[rows], cut[0] - cut[1], graph.n_blocks)
        typical = graph.interface.sum() / max(len(rows), 1)
        return np.where((won > typical)[graph.block_ids], new, labels)


MUTANTS = [
    Mutant("objective_kept", CountsEdges, "interface went from"),
    Mutant("components_not_raised", ForgetsBridges, "neighbours in its part"),
    Mutant("components_not_raised", TrustsShortNecks, "neighbours in its part"),
    Mutant("objective_kept", MomentsOfTheMeasure, "compactness went from"),
    Mutant("a_level_is_its_blocks", WorthATypicalFace, "within each block"),
    Mutant("components_not_raised", ForgetsBridgesInSpace, "neighbours in its part", {"3d": True}),
]
CORRECT: list[tuple[object, dict[str, bool]]] = []
