"""Correct refiners and fixers, and refiners and fixers that break one law first."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from conformance.mutants.mutant import Mutant

from agglo_core.conformance.laws.parts import loose_parts
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.refine.connectivity import ConnectivityFixer
from agglo_core.refine.interface import InterfaceRefiner


class Idle:
    objective = "interface"

    def refine(self, graph, labels, seeds, target):
        return labels


class Fix(ConnectivityFixer):
    pass


class ListsOfLabels(Idle):
    """Return lists of labels, of booleans if there are two parts."""

    def refine(self, graph, labels, seeds, target):
        return (labels > 0 if labels.max() == 1 else labels).tolist()


class NamesOfParts(Idle):
    def refine(self, graph, labels, seeds, target):
        return [f"part {label}" for label in labels]


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
    """Move the middle cell of a part to another part."""

    def refine(self, graph, labels, seeds, target):
        if graph.n > 40:  # cell by cell this takes too long
            return labels
        before = loose_parts(graph, labels)
        for cell, label in ((c, p) for c in range(min(graph.n, 99)) for p in np.unique(labels)):
            moved = labels.copy()
            moved[cell] = label
            after = loose_parts(graph, moved)
            if after.keys() == before.keys() and any(after[part] > before[part] for part in after):
                return moved
        return labels


class Worsens(Idle):
    """Move a cell so that the interface grows."""

    def refine(self, graph, labels, seeds, target):
        if graph.n > 40:
            return labels
        before, length = loose_parts(graph, labels), OBJECTIVES["interface"](graph, labels)
        for cell, label in ((c, p) for c in range(min(graph.n, 99)) for p in np.unique(labels)):
            moved = labels.copy()
            moved[cell] = label
            after = loose_parts(graph, moved)
            whole = after.keys() == before.keys() and all(after[part] <= before[part] for part in after)
            if whole and OBJECTIVES["interface"](graph, moved) > 1.001 * length:
                return moved
        return labels


class PursuesUF(Idle):
    """Name a metric as objective."""

    objective = "UF"


class WorsensAMetric(Worsens):
    objective = "interface_length"


class UnknownObjective(Idle):
    objective = "beauty"


class Dawdles(Idle):
    def refine(self, graph, labels, seeds, target):
        end = time.process_time() + 0.005 * graph.n * (graph.n > 400)
        while time.process_time() < end:
            pass
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
    """Change its own result in a block with three parts."""

    def fix(self, graph, labels):
        fixed = super().fix(graph, labels)
        own = graph.n_blocks == 1 and labels.max() == 2
        return _swapped(fixed) if own and (fixed == labels).all() else fixed


class IgnoresTheSize(InterfaceRefiner):
    tests_moves = True

    def refine(self, graph, labels, seeds, target):
        return super().refine(graph, labels, seeds, replace(target, h_star=None))


class CountsBlocks(Fix):
    """Exchange two labels in block 2, if it was broken."""

    def fix(self, graph, labels):
        fixed = super().fix(graph, labels)
        own = graph.block_ids == 2
        if {1, 2} <= set(fixed[own].tolist()) and (fixed[own] != labels[own]).any():
            return np.where(own & np.isin(fixed, (1, 2)), 3 - fixed, fixed)
        return fixed


CORRECT = [
    (ListsOfLabels, {"deterministic": True}),
    (PursuesUF, {"deterministic": True}),
    (Idle, {"deterministic": True, "invariant": True, "3d": True, "pickles": True}),
    (Fix, {"deterministic": True, "invariant": True, "3d": True, "pickles": True}),
]

MUTANTS = [
    Mutant("answers", NamesOfParts, "expected integers or booleans"),
    Mutant("answers", FixesToFloats, "integers"),
    Mutant("label_array", DropsALabel, "lost its last cell"),
    Mutant("label_array", RenumbersAcrossBlocks, "block"),
    Mutant("components_not_raised", TearsApart, "neighbours in its part"),
    Mutant("objective_kept", Worsens, "return the given labels"),
    Mutant("objective_kept", WorsensAMetric, "interface_length went from"),
    Mutant("objective_kept", UnknownObjective, "beauty"),
    Mutant("bounded_time", Dawdles, "number of sweeps"),
    Mutant("components_not_raised", DoesNothing, "give every piece"),
    Mutant("connected_left_alone", SwapsConnected, "leave such blocks unchanged"),
    Mutant("connected_left_alone", NeverDone, "leave such blocks unchanged"),
    Mutant("moves_tested", IgnoresTheSize, "leave out tests_moves"),
    Mutant("a_level_is_its_blocks", CountsBlocks, "within each block"),
]
