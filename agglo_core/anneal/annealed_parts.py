"""Annealed partitions of one graph: the arrays its kernels want, made once, and what is done with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from agglo_core.anneal.rounds import Ramps, rooms_of, take_turns
from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_index, frozen_int
from agglo_core.graph import Graph
from agglo_core.graph.ordering import curve_order
from agglo_core.progress import TimeLimit

_RATIO = 0.95
"""Radius of a disc or ball over its dimension times measure over surface, so that real parts, which are
rugged, get about the ratio of their inscribed circle."""

_BENT = 0.01
"""Outlines made of corners may be so much longer or shorter than the faces, relatively."""

ROUNDING = 1e-9
"""Relative excess of a width over the largest one allowed that rounding explains."""


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


class OrderedBlock:
    """A graph of one block with its cells along a curve, so that neighbours are near in memory.

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
        self.order = curve_order(graph.centroids)
        self.graph = graph.subgraph(self.order, frozen_int([0, graph.n]))

    def inward(self, labels: Int) -> Int:
        """Labels of the graph that was given, in the order used here."""
        return frozen_int(labels[self.order])

    def outward(self, labels: Int) -> Int:
        """Labels in the order used here, as those of the graph that was given."""
        result = np.empty(len(labels), np.int64)
        result[self.order] = labels
        return frozen_int(result)


class Annealing(OrderedBlock):
    """Anneals partitions of one block for round parts; labels are in its order."""

    def __init__(self, graph: Graph) -> None:
        from agglo_core.anneal.edges import cell_edges

        super().__init__(graph)
        self.cells = corner_cells(self.graph)
        self.edges: Any = None
        if self.graph.dim == 2:
            edges, off = cell_edges(self.cells, self.graph.boundary)
            self.edges = edges if off < _BENT else None

    @property
    def widths(self) -> Float:
        """Diameter of each cell ``(n,)``."""
        spans: Float = self.cells.spans
        return spans

    def annealed(
        self,
        labels: Int,
        size: float,
        ramps: Ramps,
        draws: float,
        seed: int,
        weights: Weights,
        limit: TimeLimit | None = None,
        of_part: Int | None = None,
    ) -> tuple[Int, Shapes]:
        """Labels after so many draws for each cell of the fast kernel, and the shapes as it sees them.

        Parts trade cells only within the share of each, ``of_part``, if that is given.
        """
        from agglo_core.anneal.moment_annealing import anneal

        parts, work = self._state(labels)
        both = weights.round + weights.central
        how = float(size), float(weights.even), float(both), 2.0 * _RATIO * self.graph.dim

        def make(room: Any, shares: Any, start: int, stop: int, rounds: Float, own: Any, stamp: int) -> None:
            anneal(self.cells, parts, room, shares, start, stop, how, rounds, own, stamp)

        rest = ramps.rounds(draws), seed, limit or TimeLimit(), of_part
        take_turns(make, self.graph, parts, rooms_of(work), *rest)
        return frozen_int(parts.labels), self._seen(parts)

    def polished(
        self,
        labels: Int,
        size: float,
        ramps: Ramps,
        draws: float,
        seed: int,
        weights: Weights,
        limit: TimeLimit | None = None,
    ) -> tuple[Int, Shapes]:
        """Labels after so many draws for each cell with true circles in the plane, and the shapes."""
        from agglo_core.anneal.circle_annealing import anneal_circles
        from agglo_core.anneal.circles import circle_state

        if self.edges is None:
            return self.annealed(labels, size, ramps, draws, seed, weights, limit)
        parts, work = self._state(labels)
        circles = circle_state(self.cells, self.edges, parts)
        how = float(size), *_floats(weights)

        def make(room: Any, shares: Any, start: int, stop: int, rounds: Float, own: Any, stamp: int) -> None:
            seen = circles if room is work else circles._replace(room=circles.room.copy())
            rest = room, shares, start, stop, how, rounds, own, stamp
            anneal_circles(self.cells, self.edges, parts, seen, *rest)

        rest = ramps.rounds(draws), seed, limit or TimeLimit()
        take_turns(make, self.graph, parts, rooms_of(work), *rest)
        return frozen_int(parts.labels), self._circled(parts)

    def shapes(self, labels: Int) -> Shapes:
        """Shapes of the parts, with true circles in the plane."""
        parts, _ = self._state(labels)
        return self._seen(parts) if self.edges is None else self._circled(parts)

    def seen(self, labels: Int) -> Shapes:
        """Shapes as the fast kernel sees them."""
        return self._seen(self._state(labels)[0])

    def _state(self, labels: Int) -> Any:
        """Sums, widths and lists of the parts, and the workspace of the kernels."""
        from agglo_core.anneal.widths import part_state

        return part_state(self.cells, labels, int(labels.max()) + 1)

    def _circled(self, parts: Any) -> Shapes:
        from agglo_core.anneal.circles import CENTRED, RADIUS, circle_state
        from agglo_core.anneal.state import DIAMETER

        circles = circle_state(self.cells, self.edges, parts)
        widths = parts.tally[:, DIAMETER]
        radii, central = circles.rings[:, RADIUS], circles.rings[:, CENTRED]
        return Shapes(frozen_float(widths), _over(2.0 * radii, widths), _over(2.0 * central, widths))

    def _seen(self, parts: Any) -> Shapes:
        from agglo_core.anneal.state import DIAMETER, MEASURE, SURFACE

        widths, room = parts.tally[:, DIAMETER], parts.tally[:, SURFACE] * parts.tally[:, DIAMETER]
        ratios = np.minimum(_over(2.0 * _RATIO * self.graph.dim * parts.tally[:, MEASURE], room), 1.0)
        return Shapes(frozen_float(widths), ratios, ratios)


def corner_cells(graph: Graph) -> Any:
    """Cells of a graph with their corners, as kernels take them that look at widths."""
    from agglo_core.anneal.state import Cells
    from agglo_core.anneal.widths import cell_surroundings

    used, numbers = np.unique(graph.vertices, return_inverse=True)
    corners = graph.vertex_offsets, frozen_index(numbers), frozen_float(graph.points[used])
    around = cell_surroundings(graph.indptr, graph.interface, graph.boundary, graph.centroids, *corners)
    of_graph = graph.indptr, graph.indices, graph.interface, graph.measures, graph.centroids
    return Cells(*of_graph, *corners, *around)


def too_wide(shapes: Shapes, labels: Int, size: float) -> Mask:
    """Which parts of several cells are wider than the size ``(k,)``."""
    wide: Mask = (shapes.widths > size * (1 + ROUNDING)) & (np.bincount(labels) > 1)
    return wide


def _floats(values: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


def _over(values: Float, by: Float) -> Float:
    return np.divide(values, by, out=np.zeros(len(values)), where=by > 0.0)
