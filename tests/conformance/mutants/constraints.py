"""Correct constraints, and constraints that break one law first."""

from __future__ import annotations

import numpy as np
from conformance.mutants.mutant import Mutant

from agglo_core import OptionError


def _rows(graph):
    return np.repeat(np.arange(graph.n), np.diff(graph.indptr))


class Regions:
    """Forbid parts with cells of different regions."""

    def __init__(self, tag: str = "region"):
        self.tag = tag

    def forbidden(self, graph):
        if self.tag not in graph.data:
            raise OptionError(f"regions: the mesh has no cell tag {self.tag!r}")
        tags = graph.data[self.tag]
        return tags[_rows(graph)] != tags[graph.indices]


class AtMostNine:
    """Admit parts with at most nine cells."""

    def admissible(self, graph, labels):
        return np.bincount(labels) <= 9


class AtLeastTwo:
    """Admit parts with at least two cells."""

    def admissible(self, graph, labels):
        return np.bincount(labels) >= 2


class Moody(AtMostNine):
    """Admit or refuse parts by the number of earlier calls."""

    def __init__(self):
        self.requests = 0

    def admissible(self, graph, labels):
        self.requests += 1
        return super().admissible(graph, labels) & (self.requests % 2 == 1)


class Small:
    """Mark parts with a single cell as incomplete."""

    def incomplete(self, graph, labels):
        return np.bincount(labels) <= 1


class OtherTag(Regions):
    def __init__(self, tag: str = "material"):
        super().__init__(tag)


class ZerosAndOnes(Regions):
    def forbidden(self, graph):
        return super().forbidden(graph).astype(int)


class OnePerCell(Small):
    def incomplete(self, graph, labels):
        return super().incomplete(graph, labels)[labels]


class OneWay(Regions):
    def forbidden(self, graph):
        return super().forbidden(graph) & (_rows(graph) < graph.indices)


class ByNumber(Regions):
    def forbidden(self, graph):
        return (_rows(graph) + graph.indices) % 7 == 0


class ForbidsAll(Regions):
    def forbidden(self, graph):
        return np.ones(len(graph.indices), bool)


class PlaneConstraint(Regions):
    def forbidden(self, graph):
        _, _ = graph.centroids.T
        return super().forbidden(graph)


class SmallTags(Regions):
    def forbidden(self, graph):
        tag = graph.data["region"].astype(np.uint8)
        return tag[_rows(graph)] != tag[graph.indices]


class OneLayerForAll:
    """The layer of the last mesh is that of all."""

    def for_mesh(self, mesh):
        self.layer = np.zeros(mesh.n_cells, bool)
        self.layer[mesh.face_cells[mesh.face_cells[:, 1] < 0, 0]] = True
        return self

    def forbidden(self, graph):
        layer = np.resize(self.layer, graph.n)
        return layer[_rows(graph)] != layer[graph.indices]


class HoldsARule(Regions):
    def __init__(self):
        super().__init__()
        self.rule = lambda graph: graph


CORRECT = [
    (Regions, {"3d": True, "pickles": True}),
    (AtMostNine, {"3d": True, "pickles": True}),
    (Small, {"3d": True, "pickles": True}),
]

MUTANTS = [
    Mutant("answers", OtherTag, "cell tag 'region'"),
    Mutant("masks", ZerosAndOnes, "booleans"),
    Mutant("masks", OnePerCell, "booleans of shape"),
    Mutant("masks", OneWay, "stores each edge twice"),
    Mutant("numbering_ignored", ByNumber, "not cell numbers"),
    Mutant("large_tags", SmallTags, "64 bits"),
    Mutant("prepared_apart", OneLayerForAll, "return a new object"),
    Mutant("constraint_kept", ForbidsAll, "too few parts"),
    Mutant("pieces_admissible", AtLeastTwo, "cannot be split"),
    Mutant("constraint_kept", Moody, "inconsistent answers"),
    Mutant("space_served_or_refused", PlaneConstraint, "only for 2-D"),
    Mutant("pickles", HoldsARule, "no lambdas", {"pickles": True}),
]
