"""Annealed partitions of one graph: the arrays its kernels want, made once, and what is done with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_index, frozen_int
from agglo_core.graph import Graph
from agglo_core.graph.ordering import curve_order

__all__ = ["Annealing", "Ramps", "Shapes", "Weights"]

_RATIO = 0.95
"""Radius of a disc or ball over its dimension times measure over surface, so that real parts, which are
rugged, get about the ratio of their inscribed circle."""

_BENT = 0.01
"""Outlines made of corners may be so much longer or shorter than the faces, relatively."""

_ROUNDING = 1e-9

_USUAL = 14.0
"""Cells of a part that temperatures are for: the more there are, the less one of them changes."""


class Ramps(NamedTuple):
    """First and last temperature, first and last penalty of a part too wide."""

    hot: float
    cold: float
    soft: float
    stiff: float

    def for_cells(self, cells: float) -> Ramps:
        """The same for parts of so many cells: the temperatures are those for 14."""
        scale = min(1.0, _USUAL / cells)
        return self._replace(hot=scale * self.hot, cold=scale * self.cold)


class Weights(NamedTuple):
    """What evenness, the ratio of the circle and that of the circle about the centroid count in a score."""

    even: float = 1.0
    round: float = 1.0
    central: float = 0.3


@dataclass(frozen=True)
class Shapes:
    """Diameter, ratio of the circle and of that about the centroid of each part ``(k,)``."""

    widths: Float
    ratios: Float
    central: Float

    def score(self, weights: Weights) -> float:
        """Mean diameter over the largest one and mean ratios, weighted: what a partition is chosen by."""
        most = float(self.widths.max())
        even = float(self.widths.mean()) / most if most > 0.0 else 1.0
        return (
            weights.even * even
            + weights.round * float(self.ratios.mean())
            + weights.central * float(self.central.mean())
        )


class Annealing:
    """Anneals partitions of one block; labels are in the ``order`` of the cells along a curve.

    Parameters
    ----------
    graph : Graph
        Of one block.

    Attributes
    ----------
    order : (n,) int
        The cells of ``graph`` in the order used here.
    graph : Graph
        That graph in this order.
    """

    def __init__(self, graph: Graph) -> None:
        from agglo_core.kernels.anneal_edges import cell_edges
        from agglo_core.kernels.anneal_setup import cell_surroundings
        from agglo_core.kernels.anneal_state import Cells

        self.order = curve_order(graph.centroids)
        self.graph = own = graph.subgraph(self.order, frozen_int([0, graph.n]))
        used, numbers = np.unique(own.vertices, return_inverse=True)
        corners = own.vertex_offsets, frozen_index(numbers), frozen_float(own.points[used])
        around = cell_surroundings(own.indptr, own.interface, own.boundary, own.centroids, *corners)
        graph_of = own.indptr, own.indices, own.interface, own.measures, own.centroids
        self.cells = Cells(*graph_of, *corners, *around)
        self.edges: Any = None
        if own.dim == 2:
            edges, off = cell_edges(self.cells, own.boundary)
            self.edges = edges if off < _BENT else None

    @property
    def widths(self) -> Float:
        """Diameter of each cell ``(n,)``."""
        spans: Float = self.cells.spans
        return spans

    def inward(self, labels: Int) -> Int:
        """Labels of the graph that was given, in the order used here."""
        return frozen_int(labels[self.order])

    def outward(self, labels: Int) -> Int:
        """Labels in the order used here, as those of the graph that was given."""
        result = np.empty(len(labels), np.int64)
        result[self.order] = labels
        return frozen_int(result)

    def annealed(
        self, labels: Int, size: float, ramps: Ramps, moves: int, seed: int, weights: Weights
    ) -> tuple[Int, Shapes]:
        """Labels after so many draws of the fast kernel, and the shapes as it sees them."""
        from agglo_core.kernels.anneal_setup import part_state
        from agglo_core.kernels.annealing import anneal

        parts, work = part_state(self.cells, labels, int(labels.max()) + 1)
        both = weights.round + weights.central
        how = float(size), float(weights.even), float(both), 2.0 * _RATIO * self.graph.dim
        anneal(self.cells, parts, work, how, _floats(ramps), int(moves), np.uint64(seed))
        return frozen_int(parts.labels), self._seen(parts)

    def polished(
        self, labels: Int, size: float, ramps: Ramps, moves: int, seed: int, weights: Weights
    ) -> tuple[Int, Shapes]:
        """Labels after so many draws with true circles in the plane, and the shapes."""
        from agglo_core.kernels.anneal_circles import circle_state
        from agglo_core.kernels.anneal_setup import part_state
        from agglo_core.kernels.circle_annealing import anneal_circles

        if self.edges is None:
            return self.annealed(labels, size, ramps, moves, seed, weights)
        parts, work = part_state(self.cells, labels, int(labels.max()) + 1)
        circles = circle_state(self.cells, self.edges, parts)
        how = float(size), *_floats(weights)
        rest = how, _floats(ramps), int(moves), np.uint64(seed)
        anneal_circles(self.cells, self.edges, parts, circles, work, *rest)
        return frozen_int(parts.labels), self._circled(parts)

    def shapes(self, labels: Int) -> Shapes:
        """Shapes of the parts, with true circles in the plane."""
        from agglo_core.kernels.anneal_setup import part_state

        parts, _ = part_state(self.cells, labels, int(labels.max()) + 1)
        return self._seen(parts) if self.edges is None else self._circled(parts)

    def seen(self, labels: Int) -> Shapes:
        """Shapes as the fast kernel sees them."""
        from agglo_core.kernels.anneal_setup import part_state

        return self._seen(part_state(self.cells, labels, int(labels.max()) + 1)[0])

    def _circled(self, parts: Any) -> Shapes:
        from agglo_core.kernels.anneal_circles import CENTRED, RADIUS, circle_state
        from agglo_core.kernels.anneal_state import DIAMETER

        circles = circle_state(self.cells, self.edges, parts)
        widths = parts.tally[:, DIAMETER]
        radii, central = circles.rings[:, RADIUS], circles.rings[:, CENTRED]
        return Shapes(frozen_float(widths), _over(2.0 * radii, widths), _over(2.0 * central, widths))

    def _seen(self, parts: Any) -> Shapes:
        from agglo_core.kernels.anneal_state import DIAMETER, MEASURE, SURFACE

        widths, room = parts.tally[:, DIAMETER], parts.tally[:, SURFACE] * parts.tally[:, DIAMETER]
        ratios = np.minimum(_over(2.0 * _RATIO * self.graph.dim * parts.tally[:, MEASURE], room), 1.0)
        return Shapes(frozen_float(widths), ratios, ratios)


def too_wide(shapes: Shapes, labels: Int, size: float) -> Mask:
    """Which parts of several cells are wider than the size ``(k,)``."""
    wide: Mask = (shapes.widths > size * (1 + _ROUNDING)) & (np.bincount(labels) > 1)
    return wide


def _floats(values: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


def _over(values: Float, by: Float) -> Float:
    return np.divide(values, by, out=np.zeros(len(values)), where=by > 0.0)
