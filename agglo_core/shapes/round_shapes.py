"""Roundness metrics of agglomerates in 2-D and 3-D: inertia ratio and isoperimetric quotient.

Both are 1 only for a disc or ball, and depend on the whole shape, unlike the diameter with its two points.
"""

from __future__ import annotations

from math import gamma, pi
from typing import Literal

import numpy as np

from agglo_core.arrays import Float, Int
from agglo_core.graph import Graph, functionals, moves
from agglo_core.mesh import Mesh
from agglo_core.shapes.metrics import agglomerates

Better = Literal["high", "low"]


class InertiaRatio:
    """Moment of inertia of the disc (3-D: ball) with equal measure, divided by the agglomerate's.

    In 2-D the ratio is A² / (2π ∫ |x − C|²) about the centroid C: 3/π for a square, √3 · 3 / (2π) for an
    equilateral triangle. It is exact: the integral is over the agglomerate, not a sum over cell centroids.
    """

    better: Better = "high"
    bounds = (0.0, 1.0)
    homogeneity = 0
    shape_only = True

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the ratios ``(k,)``, 1 for a disc or ball."""
        coarse = agglomerates(mesh, labels)
        d, measures = coarse.dim, coarse.cell_measures
        radii = (measures / _unit_ball(d)) ** (1.0 / d)
        of_balls = d / (d + 2.0) * measures * radii**2
        ratios: Float = functionals.ratio(of_balls, coarse.cell_inertias)
        return ratios


class IsoperimetricQuotient:
    """Isoperimetric quotient: 4π area / perimeter², or 36π volume² / surface³.

    1 for a disc or ball. The perimeter includes hole edges.
    """

    better: Better = "high"
    bounds = (0.0, 1.0)
    homogeneity = 0
    shape_only = True

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the isoperimetric quotients ``(k,)``."""
        coarse = agglomerates(mesh, labels)
        offsets, faces = coarse.cell_faces
        surfaces = np.add.reduceat(coarse.face_measures[faces], offsets[:-1])
        return _quotient(coarse.cell_measures, surfaces, coarse.dim)

    def changes(self, graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
        """Return the change ``(q,)`` in the sum of the metric for each cell move that empties no part."""
        k, d = int(labels.max()) + 1, graph.dim
        # 1. Sums of the parts, and the interface of each cell with both parts.
        shared = moves.links(graph, labels, cells, parts, graph.interface)
        size, home = graph.measures[cells], labels[cells]
        outline = shared.total + graph.boundary[cells]
        sizes = moves.part_sums(labels, graph.measures, k)
        outlines = moves.part_sums(labels, graph.boundary, k)
        outlines += functionals.part_cuts(graph, labels, edge_weights=graph.interface)
        # 2. Quotients of both parts after and before the move.
        home_quotients = _quotient(sizes[home] - size, outlines[home] - outline + 2.0 * shared.own, d)
        target_quotients = _quotient(sizes[parts] + size, outlines[parts] + outline - 2.0 * shared.there, d)
        before = _quotient(sizes, outlines, d)
        return np.where(home == parts, 0.0, home_quotients + target_quotients - before[home] - before[parts])


def _unit_ball(d: int) -> float:
    """Return the measure of the unit ball in d dimensions: π or 4π/3."""
    return float(pi ** (d / 2.0) / gamma(d / 2.0 + 1.0))


def _quotient(measures: Float, surfaces: Float, d: int) -> Float:
    """Return d^d |ball| V^(d−1) / S^d, the isoperimetric quotient in d dimensions."""
    return functionals.ratio(d**d * _unit_ball(d) * measures ** (d - 1), surfaces**d)
