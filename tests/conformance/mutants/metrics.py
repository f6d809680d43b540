"""Metrics: correct ones, and those that break one law first."""

from __future__ import annotations

from math import inf

import numpy as np
from conformance.mutants.mutant import Mutant

from agglo_core import Component


class Extent:
    """Number of cells over the number of all cells."""

    better = "high"
    bounds = (0.0, 1.0)
    homogeneity = 0

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
    """Sum of the squared number of cells, as an objective too."""

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


CORRECT = [
    (Spread, {"deterministic": True, "3d": True, "pickles": True}),
    (Extent, {"deterministic": True, "3d": True, "pickles": True}),
]

MUTANTS = [
    Mutant("changes_add_up", ForgetsTheOldPart, "less the sum before"),
    Mutant("promises_can_be_kept", Extent, "leave it out", {"balanced": 0.1}),
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
]
