"""Components that write to arrays of the caller, identify arrays by id, or leave traces at early ends."""

from __future__ import annotations

from math import inf

import numpy as np
from conformance.mutants.metrics import Extent, Spread
from conformance.mutants.mutant import Mutant
from two_point_flux import TwoPointFlux


class BorrowsTheLabels(Extent):
    """Increment the labels in place and restore them later."""

    def measure(self, mesh, labels):
        if not labels.flags.writeable:
            return super().measure(mesh, labels)
        labels += 1
        values = super().measure(mesh, labels - 1)
        labels -= 1
        return values


class KnowsTheArray(Extent):
    """Cache values by the identity of the label array."""

    def __init__(self):
        self.seen = self.values = None

    def measure(self, mesh, labels):
        if labels is not self.seen:
            self.seen, self.values = labels, super().measure(mesh, labels)
            self.first = labels[0]
        return self.values.copy() if labels.flags.writeable else super().measure(mesh, labels)


class KnowsTheLabels(Spread):
    """Cache part sizes by the identity of a writable array."""

    def __init__(self):
        self.seen = self.sizes = None

    def changes(self, graph, labels, cells, parts):
        if labels is not self.seen:
            self.seen, self.sizes = labels, np.bincount(labels).astype(float)
        own = labels[cells]
        return np.where(own == parts, 0.0, 2 * (self.sizes[parts] - self.sizes[own] + 1))


class QuietUntilTheEnd(TwoPointFlux):
    """Disable numpy warnings, and restore them only after an iteration."""

    def solve(self, problem, hierarchy):
        before = np.seterr(all="ignore")
        it = super().solve(problem, hierarchy)
        if it.iterations:
            np.seterr(**before)
        return it


class SaysWhy(TwoPointFlux):
    """Print the reason of a failure."""

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        if not it.converged:
            print(it.reason)  # noqa: T201 - the bug
        return it


class BestHexagon(Extent):
    """Bound roundness by the value of a hexagon."""

    def measure(self, mesh, labels):
        coarse = mesh.coarsen(labels)
        if mesh.dim == 3:
            return super().measure(mesh, labels)
        offsets, faces = coarse.cell_faces
        return (
            8
            * np.sqrt(3)
            * coarse.cell_measures
            / np.add.reduceat(coarse.face_measures[faces], offsets[:-1]) ** 2
        )


class BallsAreCubes(Extent):
    """Bound 3-D roundness by the value of a cube."""

    def measure(self, mesh, labels):
        coarse = mesh.coarsen(labels)
        if mesh.dim == 2:
            return super().measure(mesh, labels)
        offsets, faces = coarse.cell_faces
        return (
            6 * coarse.cell_measures ** (2 / 3) / np.add.reduceat(coarse.face_measures[faces], offsets[:-1])
        )


class LonelyIsNaN(Extent):
    """Interface with the widest neighbour relative to the whole interface, and NaN without neighbours.

    The value is defined if there is only one part.
    """

    def measure(self, mesh, labels):
        pairs = mesh.coarsen(labels).face_cells
        pairs = pairs[pairs[:, 1] >= 0]
        counts = np.bincount(pairs.ravel(), minlength=labels.max() + 1)
        if labels.max() == 0:
            return np.ones(1)
        with np.errstate(invalid="ignore"):
            return np.where(counts > 0, 1.0, 0.0 / counts)


class ThousandsCollide(Extent):
    """Number pairs of neighbouring parts by 1000 times one label plus the other."""

    better = "low"
    bounds = (0.0, inf)

    def measure(self, mesh, labels):
        k = int(labels.max()) + 1
        pairs = labels[mesh.face_cells[mesh.face_cells[:, 1] >= 0]]
        pairs = pairs[pairs[:, 0] != pairs[:, 1]]
        keys = np.unique(np.concatenate((pairs @ [1000, 1], pairs @ [1, 1000])))
        return np.bincount(np.minimum(keys // 1000, k - 1), minlength=k).astype(float)


class CountsEdges(Extent):
    """Number of faces on the outline."""

    shape_only = True
    better = "low"
    bounds = (1.0, inf)

    def measure(self, mesh, labels):
        return np.diff(mesh.coarsen(labels).cell_faces[0]).astype(float)


class Squared(Extent):
    """Correct: squared interface, which in 3-D is a length to the power of four."""

    better = "low"
    bounds = (0.0, inf)
    homogeneity = 2
    shape_only = True

    def measure(self, mesh, labels):
        coarse = mesh.coarsen(labels)
        inner = coarse.face_cells[:, 1] >= 0
        pairs, sizes = coarse.face_cells[inner], coarse.face_measures[inner]
        return np.bincount(pairs.ravel(), np.repeat(sizes, 2), coarse.n_cells) ** 2.0


class WidthOverWidest(Extent):
    """Correct: extent along x relative to the largest extent, and NaN for a single cell."""

    undefined = directional = relative = True

    def measure(self, mesh, labels):
        offsets, vertices = mesh.cell_vertices
        part, x = np.repeat(labels, np.diff(offsets)), mesh.local_points[vertices, 0]
        low, high = np.full(labels.max() + 1, inf), np.full(labels.max() + 1, -inf)
        np.minimum.at(low, part, x)
        np.maximum.at(high, part, x)
        return np.where(np.bincount(labels) > 1, (high - low) / (high - low).max(), np.nan)


class AnyTag(Extent):
    """Share of the commonest value of an arbitrary cell tag."""

    def measure(self, mesh, labels):
        if not mesh.cell_tags:
            return super().measure(mesh, labels)
        tag = np.unique(mesh.cell_tags[next(iter(set(mesh.cell_tags)))], return_inverse=True)[1]
        counts = np.zeros((labels.max() + 1, int(tag.max()) + 1))
        np.add.at(counts, (labels, tag), 1.0)
        return counts.max(axis=1) / counts.sum(axis=1)


_SPACE = {"deterministic": True, "3d": True, "pickles": True}
CORRECT = [(Squared, _SPACE), (WidthOverWidest, _SPACE)]

MUTANTS = [
    Mutant("never_written", BorrowsTheLabels, "work on a copy"),
    Mutant("never_written", KnowsTheArray, "never key a cache by id()"),
    Mutant("changes_add_up", KnowsTheLabels, "the array holds now"),
    Mutant("surroundings_kept", QuietUntilTheEnd, "np.errstate"),
    Mutant("surroundings_kept", SaysWhy, "printed"),
    Mutant("within_bounds", BestHexagon, "outside the declared bounds"),
    Mutant("within_bounds", BallsAreCubes, "outside the declared bounds", {"3d": True}),
    Mutant("within_bounds", LonelyIsNaN, "got [nan]"),
    Mutant("renaming", ThousandsCollide, "1225 parts"),
    Mutant("same_in_another_process", AnyTag, "built for another process"),
    Mutant("shape_only_is_true", CountsEdges, "all faces cut"),
]
