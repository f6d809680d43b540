"""Simulated annealing on one graph: arrays built once for compiled functions, and operations on them."""

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
"""Dimensionless: radius of a disc or ball over its dimension times measure over surface. Reduced from 1, so
that typical parts, which are rugged, get about the ratio of their inscribed circle (benchmarks/roundness.py).
"""

_BENT = 0.01
"""Largest relative difference between the total outline length from corners and from face measures.

Beyond it, interfaces are bent, as between pieces of many cells, and the true circles of parts are not used
(benchmarks/roundness.py, brain).
"""

ROUNDING = 1e-9
"""Relative to the largest admissible width: wider parts within this tolerance are admissible (rounding)."""


class Weights(NamedTuple):
    """Weights of the partition score: even diameters, inscribed circles, circles about the centroids."""

    even: float = 1.0
    round: float = 1.0
    central: float = 0.3


@dataclass(frozen=True)
class Shapes:
    """Diameter per part ``(k,)``, and diameters of its inscribed and centred circle relative to it."""

    widths: Float
    ratios: Float
    central: Float

    def score(self, weights: Weights) -> float:
        """Return the score: a weighted sum of mean over largest diameter and of the mean circle ratios."""
        most = float(self.widths.max())
        even = float(self.widths.mean()) / most if most > 0.0 else 1.0
        return (
            weights.even * even
            + weights.round * float(self.ratios.mean())
            + weights.central * float(self.central.mean())
        )


class OrderedBlock:
    """A one-block graph with its cells ordered along a curve, so that neighbours are close in memory.

    Parameters
    ----------
    graph : Graph
        A graph with one block.

    Attributes
    ----------
    order : (n,) int
        The cells of ``graph`` in curve order.
    graph : Graph
        The graph in this order.
    """

    def __init__(self, graph: Graph) -> None:
        self.order = curve_order(graph.centroids)
        self.graph = graph.subgraph(self.order, frozen_int([0, graph.n]))

    def inward(self, labels: Int) -> Int:
        """Convert labels from the original order to the curve order."""
        return frozen_int(labels[self.order])

    def outward(self, labels: Int) -> Int:
        """Convert labels from the curve order to the original order."""
        result = np.empty(len(labels), np.int64)
        result[self.order] = labels
        return frozen_int(result)


class Annealing(OrderedBlock):
    """Simulated annealing for round parts on one block, with labels in curve order."""

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
        """Diameter per cell ``(n,)``."""
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
        """Anneal with ``draws`` draws per cell and estimated circles, and return labels and shapes.

        If ``of_part`` is given, parts only trade cells within their share.
        """
        from agglo_core.anneal.moment_annealing import anneal

        parts, work = self._state(labels)
        roundness = weights.round + weights.central
        params = float(size), float(weights.even), float(roundness), 2.0 * _RATIO * self.graph.dim

        def make(
            workspace: Any, shares: Any, start: int, stop: int, rounds: Float, round_seed: Any, stamp: int
        ) -> None:
            anneal(self.cells, parts, workspace, shares, start, stop, params, rounds, round_seed, stamp)

        arguments = ramps.rounds(draws), seed, limit or TimeLimit(), of_part
        take_turns(make, self.graph, parts, rooms_of(work), *arguments)
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
        """Anneal with ``draws`` draws per cell and true circles in 2-D, and return labels and shapes."""
        from agglo_core.anneal.circle_annealing import anneal_circles
        from agglo_core.anneal.circles import circle_state

        if self.edges is None:
            return self.annealed(labels, size, ramps, draws, seed, weights, limit)
        # 1. State with circles.
        parts, work = self._state(labels)
        circles = circle_state(self.cells, self.edges, parts)
        params = float(size), *_floats(weights)

        # 2. Annealing rounds; each thread has its own circle workspace.
        def make(
            workspace: Any, shares: Any, start: int, stop: int, rounds: Float, round_seed: Any, stamp: int
        ) -> None:
            thread_circles = circles if workspace is work else circles._replace(room=circles.room.copy())
            arguments = workspace, shares, start, stop, params, rounds, round_seed, stamp
            anneal_circles(self.cells, self.edges, parts, thread_circles, *arguments)

        arguments = ramps.rounds(draws), seed, limit or TimeLimit()
        take_turns(make, self.graph, parts, rooms_of(work), *arguments)
        return frozen_int(parts.labels), self._circled(parts)

    def shapes(self, labels: Int) -> Shapes:
        """Return the part shapes, with true inscribed circles in 2-D."""
        parts, _ = self._state(labels)
        return self._seen(parts) if self.edges is None else self._circled(parts)

    def seen(self, labels: Int) -> Shapes:
        """Return the part shapes, with estimated inscribed circles as in ``annealed``."""
        return self._seen(self._state(labels)[0])

    def _state(self, labels: Int) -> Any:
        """Set up the part arrays (sums, widths, cell lists), and the workspace."""
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
    """Return the cells of a graph with their vertices, for functions that compute part diameters."""
    from agglo_core.anneal.state import Cells
    from agglo_core.anneal.widths import cell_surroundings

    used, numbers = np.unique(graph.vertices, return_inverse=True)
    corners = graph.vertex_offsets, frozen_index(numbers), frozen_float(graph.points[used])
    around = cell_surroundings(graph.indptr, graph.interface, graph.boundary, graph.centroids, *corners)
    of_graph = graph.indptr, graph.indices, graph.interface, graph.measures, graph.centroids
    return Cells(*of_graph, *corners, *around)


def too_wide(shapes: Shapes, labels: Int, size: float) -> Mask:
    """Return a mask ``(k,)`` of the parts that are wider than ``size`` and have several cells."""
    wide: Mask = (shapes.widths > size * (1 + ROUNDING)) & (np.bincount(labels) > 1)
    return wide


def _floats(values: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


def _over(values: Float, by: Float) -> Float:
    return np.divide(values, by, out=np.zeros(len(values)), where=by > 0.0)
