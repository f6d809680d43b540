"""Recursive coordinate and inertial bisection, the baselines for other bisectors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from agglo_core.arrays import Float, Int, UInt64
from agglo_core.graph import Graph
from agglo_core.graph.blocks import TIE, block_extents, split_at_median
from agglo_core.split.piece_growth import PieceGrowth


class CoordinateBisection:
    """Halve each block across the longest side of the bounding box of its centroids.

    Source: Berger and Bokhari, "A partitioning strategy for nonuniform problems on multiprocessors".
    """

    needs_points = True

    def bisect_level(self, level: Graph, seeds: UInt64) -> Int:
        """Return the side per cell ``(n,)``, independent of ``seeds``."""
        return self.bisect_shares(level, seeds, None)

    def bisect_shares(self, level: Graph, seeds: UInt64, shares: Float | None) -> Int:
        """Return the side per cell ``(n,)``, where side 0 has the mass fraction ``shares (B,)``."""
        extents = block_extents(level, level.centroids)
        longest = np.argmax(extents >= (1 - TIE) * extents.max(axis=1, keepdims=True), axis=1)
        axes = (longest[:, None] + np.arange(level.dim)) % level.dim
        coordinates = np.take_along_axis(level.centroids, axes[level.block_ids], axis=1)
        return split_at_median(level, coordinates[:, 0], coordinates[:, 1:], shares)

    def grow(self, graph: Graph, pieces: Int, refiners: Sequence[Any], fixer: Any) -> PieceGrowth | None:
        """Return an object for all splits in one call, or None if refiners or fixer are unsupported."""
        from agglo_core.split.piece_medians import split_across_boxes

        if refiners:  # cells with equal gain would move in another order than in the recursion by depth
            return None
        return PieceGrowth.for_components(graph, pieces, split_across_boxes, refiners, fixer, tiny=0)


class InertialBisection:
    """Halve each block across its principal axis of inertia.

    Axes of nearly isotropic blocks (squares, cubes) come from the fourth moments.

    Source: Simon, "Partitioning of unstructured problems for parallel processing".

    Examples
    --------
    >>> from agglo_core.authoring import InertialBisection
    >>> strip = agglo.samples.strip(4).graph
    >>> InertialBisection().bisect_level(strip, np.zeros(1, np.uint64))
    array([0, 0, 1, 1])
    """

    needs_points = True

    def bisect_level(self, level: Graph, seeds: UInt64) -> Int:
        """Return the side per cell ``(n,)``, independent of ``seeds``."""
        from agglo_core.split.ordered_frames import frames_of_blocks

        coordinates = frames_of_blocks(level.offsets, level.centroids, level.weights)[1]
        return split_at_median(level, coordinates[:, 0], coordinates[:, 1:])

    def grow(self, graph: Graph, pieces: Int, refiners: Sequence[Any], fixer: Any) -> PieceGrowth | None:
        """Return an object for all splits in one call, or None if refiners or fixer are unsupported.

        As in the recursion by depth, every split is tested and repaired, including splits of small pieces.
        """
        from agglo_core.split.piece_medians import split_across_axes

        return PieceGrowth.for_components(graph, pieces, split_across_axes, refiners, fixer, tiny=0)
