"""Correct metrics, and metrics that break one law first."""

from __future__ import annotations

from math import inf

import numpy as np
from conformance.mutants.mutant import Mutant

from agglo_core import Component


class Extent:
    """Number of cells relative to all cells."""

    better = "high"
    bounds = (0.0, 1.0)
    homogeneity = 0
    relative = True

    def measure(self, mesh, labels):
        return np.bincount(labels) / len(labels)


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


class Spread:
    """Squared number of cells, also usable as an objective."""

    better = "low"
    bounds = (1.0, inf)
    homogeneity = 0

    def measure(self, mesh, labels):
        return np.bincount(labels) ** 2.0

    def changes(self, graph, labels, cells, parts):
        sizes = np.bincount(labels).astype(float)
        return np.where(labels[cells] == parts, 0.0, 2 * (sizes[parts] - sizes[labels[cells]] + 1))


class ForgetsTheOldPart(Spread):
    def changes(self, graph, labels, cells, parts):
        return 2.0 * np.bincount(labels)[parts] + 1


class ForgetsThePower(Spread):
    def __init__(self, power: int = 2) -> None:
        self.power = power

    def measure(self, mesh, labels):
        return np.bincount(labels).astype(float) ** self.power


class Wanting(Extent):
    """Correct: area relative to the bounding box, and NaN for loose parts."""

    directional = True
    undefined = True

    def measure(self, mesh, labels):
        coarse = mesh.coarsen(labels)
        offsets, vertices = coarse.cell_vertices
        corners = coarse.local_points[vertices]
        low, high = (each.reduceat(corners, offsets[:-1]) for each in (np.minimum, np.maximum))
        component = mesh.graph.components(labels)
        pieces = np.bincount(np.unique(np.stack((component, labels)), axis=1)[1])
        filled = np.clip(coarse.cell_measures / np.prod(high - low, axis=1), 0.0, 1.0)
        return np.where(pieces > 1, np.nan, filled)


class Share(Extent):
    """Measure relative to the largest part."""

    relative = True

    def measure(self, mesh, labels):
        sizes = np.bincount(labels, mesh.cell_measures)
        return sizes / sizes.max()


class SaysYes(Extent):
    relative = "yes"


class NeverDefined(Extent):
    undefined = True

    def measure(self, mesh, labels):
        return np.full(labels.max() + 1, np.nan)


class InfiniteWhenUndefined(Wanting):
    def measure(self, mesh, labels):
        values = super().measure(mesh, labels)
        return np.where(np.isnan(values), np.inf, values)


class BoundedLength(Extent):
    """Length with a fixed upper bound."""

    bounds = (0.0, 200.0)
    homogeneity = 1

    def measure(self, mesh, labels):
        return mesh.coarsen(labels).cell_diameters


class FewNeighbours(Extent):
    bounds = (0.0, 20.0)

    def measure(self, mesh, labels):
        pairs = mesh.coarsen(labels).face_cells
        pairs = np.unique(np.sort(pairs[pairs[:, 1] >= 0], axis=1), axis=0)
        return np.bincount(pairs.ravel(), minlength=labels.max() + 1).astype(float)


class AddsATrifle(Extent):
    bounds = (0.0, inf)

    def measure(self, mesh, labels):
        coarse = mesh.coarsen(labels)
        return coarse.cell_measures / (coarse.cell_diameters**2 + 1e-6)


class NeverSquared(Extent):
    """Quantity without unit in 2-D, but with the unit of a length in 3-D."""

    bounds = (0.0, inf)

    def measure(self, mesh, labels):
        coarse = mesh.coarsen(labels)
        return coarse.cell_measures / coarse.cell_diameters**2


class FarFromZero(Extent):
    """Area by the shoelace formula in global coordinates, which lose digits far from 0."""

    bounds = (0.0, inf)

    def measure(self, mesh, labels):
        if mesh.dim == 3:
            return super().measure(mesh, labels)
        coarse = mesh.coarsen(labels)
        loops = coarse.boundary_loops
        x, y = mesh.points[loops.vertices].T
        after = np.append(np.arange(1, len(x)), 0)
        after[loops.loop_offsets[1:] - 1] = loops.loop_offsets[:-1]
        areas = np.add.reduceat(x * y[after] - x[after] * y, loops.loop_offsets[loops.cell_offsets[:-1]]) / 2
        return np.abs(areas) / coarse.cell_diameters**2


class OutsideIsTheLastCell(Extent):
    """Index labels by both cells of each face, although -1 marks the boundary."""

    bounds = (0.0, inf)

    def measure(self, mesh, labels):
        one, other = labels[mesh.face_cells].T
        return np.bincount(one[one != other], minlength=labels.max() + 1) / np.bincount(labels)


class FirstCellOfEach(Extent):
    bounds = (0.0, inf)

    def measure(self, mesh, labels):
        first = np.unique(labels, return_index=True)[1]
        away = np.linalg.norm(mesh.local_centroids - mesh.local_centroids[first[labels]], axis=1)
        return np.bincount(labels, away) / np.bincount(labels) / mesh.coarsen(labels).cell_diameters


class KnowsTheMesh(Share):
    """Cache sums by the name of the mesh."""

    def __init__(self):
        self.known = {}

    def measure(self, mesh, labels):
        key = mesh.name, len(labels), int(labels.max())
        if key not in self.known:
            self.known[key] = mesh.coarsen(labels).cell_measures / mesh.cell_measures.sum()
        return self.known[key]


class SharesUnsaid(Share):
    relative = False


class WorseIsBetter(Extent):
    better = "low"

    def measure(self, mesh, labels):
        coarse = mesh.coarsen(labels)
        return np.clip(coarse.cell_measures / coarse.cell_diameters**mesh.dim, 0.0, 1.0)


class WeighsCells(Spread):
    """Squared measures, although the weights of the graph differ from its measures."""

    bounds = (0.0, inf)
    homogeneity = 4

    def measure(self, mesh, labels):
        return np.bincount(labels, mesh.cell_measures) ** 2

    def changes(self, graph, labels, cells, parts):
        sizes, gone = np.bincount(labels, graph.weights), graph.weights[cells]
        told = 2 * gone * (sizes[parts] - sizes[labels[cells]] + gone)
        return np.where(labels[cells] == parts, 0.0, told)


class Perimeter(Extent):
    """Perimeter without the domain boundary."""

    better = "low"
    bounds = (0.0, inf)
    homogeneity = 1

    def measure(self, mesh, labels):
        coarse = mesh.coarsen(labels)
        inner = coarse.face_cells[:, 1] >= 0
        pairs, lengths = coarse.face_cells[inner], coarse.face_measures[inner]
        return np.bincount(pairs.ravel(), np.repeat(lengths, 2), coarse.n_cells).astype(float)


class LogOfShare(Share):
    """Logarithm of a share, which is 0 up to rounding if all parts are equal."""

    bounds = (-inf, 0.0)

    def measure(self, mesh, labels):
        return np.log(super().measure(mesh, labels))


class OnTheBoundary(Extent):
    """Share of the perimeter on the domain boundary."""

    better = "low"

    def measure(self, mesh, labels):
        coarse = mesh.coarsen(labels)
        offsets, faces = coarse.cell_faces
        outside = np.where(coarse.face_cells[:, 1] < 0, coarse.face_measures, 0.0)
        sums = [np.add.reduceat(each[faces], offsets[:-1]) for each in (outside, coarse.face_measures)]
        return sums[0] / sums[1]


class Elongation(Extent):
    """Root of the ratio of second vertex moments, which is 1 for round parts and for loose cells."""

    bounds = (1.0, inf)

    def measure(self, mesh, labels):
        coarse = mesh.coarsen(labels)
        offsets, vertices = coarse.cell_vertices
        each = np.split(coarse.local_points[vertices], offsets[1:-1])
        moments = [np.linalg.eigvalsh(np.cov(points.T)) for points in each]
        return np.array([np.sqrt(max(s[-1] / max(s[0], 1e-12 * s[-1]), 1.0)) for s in moments])


class InOnePiece(Extent):
    """Boolean value: True if the part is connected."""

    def measure(self, mesh, labels):
        component = mesh.graph.components(labels)
        return np.bincount(labels[np.unique(component, return_index=True)[1]]) == 1


class AwayFromTheMiddle(Extent):
    """Distance from the mesh centroid, which depends on position instead of shape."""

    better = "low"
    bounds = (0.0, inf)
    homogeneity = 1

    def measure(self, mesh, labels):
        x = mesh.local_centroids - np.average(mesh.local_centroids, axis=0, weights=mesh.cell_measures)
        moments = [np.bincount(labels, mesh.cell_measures * each) for each in x.T]
        return np.linalg.norm(moments, axis=0) / np.bincount(labels, mesh.cell_measures)


class CountsComplex(Extent):
    def measure(self, mesh, labels):
        return super().measure(mesh, labels) + 0j


CORRECT = [
    (InOnePiece, {"deterministic": True, "3d": True, "pickles": True}),
    (AwayFromTheMiddle, {"deterministic": True, "3d": True, "pickles": True}),
    (Spread, {"deterministic": True, "3d": True, "pickles": True}),
    (Extent, {"deterministic": True, "3d": True, "pickles": True}),
    (Wanting, {"deterministic": True, "pickles": True}),
    (Share, {"deterministic": True, "3d": True, "pickles": True}),
    (LogOfShare, {"deterministic": True, "3d": True, "pickles": True}),
    (OnTheBoundary, {"deterministic": True, "3d": True, "pickles": True}),
]

MUTANTS = [
    Mutant("changes_add_up", ForgetsTheOldPart, "minus the sum before"),
    Mutant("promises_can_be_kept", Extent, "remove it", {"balanced": 0.1}),
    Mutant("declares_itself", NoBounds, "expected (lowest, highest)"),
    Mutant("answers", PerCell, "not one per cell"),
    Mutant("answers", MeanValue, "not a mean"),
    Mutant("within_bounds", ZeroOverZero, "zero denominator"),
    Mutant("within_bounds", OutOfBounds, "declare wider bounds"),
    Mutant("within_bounds", StumblesOnHoles, "several loops"),
    Mutant("homogeneous", AreaCalledRatio, "divide by a length"),
    Mutant("rigid_motion", WidthOverHeight, "not coordinates"),
    Mutant("renaming", ValuesByName, "belong to label i"),
    Mutant("hand_values", Component("metric", "solidity", f"{__name__}:AlwaysOne"), "definition"),
    Mutant("changes_add_up", ForgetsThePower, "with power="),
    Mutant("changes_add_up", WeighsCells, "minus the sum before"),
    Mutant("declares_itself", SaysYes, "expected True or False"),
    Mutant("within_bounds", InfiniteWhenUndefined, "set undefined = True"),
    Mutant("better_is_better", NeverDefined, "expected finite values"),
    Mutant("within_bounds", BoundedLength, "declare wider bounds"),
    Mutant("within_bounds", FewNeighbours, "declare wider bounds"),
    Mutant("homogeneous", AddsATrifle, "small constants"),
    Mutant("homogeneous", NeverSquared, "declare the true power", {"3d": True}),
    Mutant("rigid_motion", FarFromZero, "local_points keeps precision"),
    Mutant("renaming", OutsideIsTheLastCell, "renumbered"),
    Mutant("renaming", FirstCellOfEach, "renumbered"),
    Mutant("nothing_carried_over", KnowsTheMesh, "key a cache"),
    Mutant("far_parts_do_not_matter", SharesUnsaid, "relative = True"),
    Mutant("better_is_better", WorseIsBetter, "the other direction"),
    Mutant("better_is_better", Elongation, "the other direction"),
    Mutant("answers", CountsComplex, "booleans or floats"),
    Mutant("hand_values", Perimeter, "definition"),
    Mutant("shape_only_is_true", CountsCells, "drop shape_only"),
]
