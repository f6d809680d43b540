"""Objectives of partitions (lower is better) for refiners, comparisons, and tests of components.

>>> from agglo_core import samples
>>> from agglo_core.graph.objectives import OBJECTIVES
>>> OBJECTIVES["cut"].value(samples.squares(2).graph, [0, 0, 1, 1])
2.0
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.graph import moves
from agglo_core.graph.dual import Graph
from agglo_core.graph.functionals import part_cuts, part_volumes, ratio
from agglo_core.graph.loads import Kind
from agglo_core.graph.solver_shape import solver_shapes

_ROUNDING = 1e-9  # relative growth below this value does not count as worse


@dataclass(frozen=True)
class Objective:
    """Scalar objective of a partition, to be minimised.

    Attributes
    ----------
    name : str
    summary : str
        One-line description.
    of_parts : callable
        Function of a graph and labels 0..k−1 that returns the value per part ``(k,)``.
    combined : "sum" or "max"
        Reduction of the part values to a scalar.
    changes : callable, optional
        Incremental form, see :class:`~agglo_core.protocols.IncrementalMetric`.
    difference : callable, optional
        Growth between two labellings, and the size of the summed terms; for objectives with a faster way
        than two evaluations.
    """

    name: str
    summary: str
    of_parts: Callable[[Graph, Int], Float]
    combined: Literal["sum", "max"] = "sum"
    changes: Callable[[Graph, Int, Int, Int], Float] | None = None
    difference: Callable[[Graph, Int, Int], tuple[float, float]] | None = None

    def worse_by(self, graph: Graph, before: Int, after: Int) -> float:
        """Return the objective's increase from ``before (n,)`` to ``after (n,)``, or 0 within rounding.

        Labels may number the parts of each block from 0.
        """
        if self.difference is not None:
            growth, size = self.difference(graph, before, after)
        elif np.array_equal(before, after):
            return 0.0
        else:
            size = self.value(graph, before)
            growth = self.value(graph, after) - size
        return growth if growth > _ROUNDING * abs(size) else 0.0

    def value(self, graph: Graph, labels: ArrayLike) -> float:
        """Return the objective value for a partition ``labels (n,)``.

        Labels may number the parts of each block from 0.
        """
        values = self.of_parts(graph, numbered_parts(graph, labels))
        return float(values.sum() if self.combined == "sum" else values.max())

    __call__ = value


def numbered_parts(graph: Graph, labels: ArrayLike) -> Int:
    """Number the parts of all blocks consecutively: labels ``(n,)`` without gaps, increasing with the block.

    Examples
    --------
    >>> from agglo_core import samples
    >>> from agglo_core.graph.objectives import numbered_parts
    >>> numbered_parts(samples.squares(2).graph, [7, 7, 3, 3])
    array([1, 1, 0, 0])
    """
    local = frozen_int(labels)
    stride = int(local.max(initial=0)) + 1
    through = graph.block_ids * stride + local
    if graph.n_blocks * stride > 4 * graph.n:
        return frozen_int(np.unique(through, return_inverse=True)[1])
    present = np.bincount(through, minlength=graph.n_blocks * stride) > 0  # no sort of the cells
    return frozen_int((np.cumsum(present) - 1)[through])


def _interface(graph: Graph, labels: Int) -> Float:
    return 0.5 * part_cuts(graph, labels, edge_weights=graph.interface)


def _cut(graph: Graph, labels: Int) -> Float:
    return 0.5 * part_cuts(graph, labels)


def _inertia(graph: Graph, labels: Int) -> Float:
    _, means = moves.mass_centres(graph, labels)
    return moves.part_sums(labels, graph.weights * ((graph.centroids - means[labels]) ** 2).sum(axis=1))


def _squared_sizes(kind: Kind | None) -> Callable[[Graph, Int], Float]:
    def of_parts(graph: Graph, labels: Int) -> Float:
        squared: Float = moves.part_sums(labels, graph.node_sizes(kind)) ** 2
        return squared

    return of_parts


def _diameters(graph: Graph, labels: Int) -> Float:
    return graph.part_diameters(labels)


def _roundness(graph: Graph, labels: Int) -> Float:
    """Return a shape defect per part ``(k,)``: deviation from a round shape plus relative narrowness.

    Both terms are between 0 and 1. Widths are relative to the widest part of the block. The roundness of a
    part is 2 r / diameter, with r = 0.95 · dimension · measure / surface: 0.95 for a disc, and about the
    ratio of the inscribed circle for real parts.
    """
    widths = graph.part_diameters(labels)
    block, most = np.zeros(len(widths), np.int64), np.zeros(graph.n_blocks)
    block[labels] = graph.block_ids
    np.maximum.at(most, block, widths)
    outside = moves.part_sums(labels, graph.boundary) + part_cuts(graph, labels, edge_weights=graph.interface)
    discs = ratio(1.9 * graph.dim * moves.part_sums(labels, graph.measures), outside * widths)
    narrow = np.where(most[block] > 0.0, 1.0 - ratio(widths, most[block]), 0.0)
    values: Float = (1.0 - np.minimum(discs, 1.0)) + narrow
    return values


def _normalised_cuts(graph: Graph, labels: Int) -> Float:
    return ratio(part_cuts(graph, labels), part_volumes(graph, labels))


_TABLE = (
    Objective(
        "interface",
        "measure of the faces between parts",
        _interface,
        changes=moves.interface_changes,
        difference=lambda graph, before, after: moves.edge_difference(graph, before, after, graph.interface),
    ),
    Objective(
        "cut",
        "number of dual edges between parts",
        _cut,
        changes=moves.cut_changes,
        difference=moves.edge_difference,
    ),
    Objective(
        "compactness",
        "moment of inertia of the parts about their centroids",
        _inertia,
        changes=moves.inertia_changes,
    ),
    Objective(
        "shape",
        f"compactness times the interface of the block to the power {moves.SHORTNESS}",
        moves.shapes,
        changes=moves.shape_changes,
    ),
    Objective(
        "solver",
        "compactness plus a fifth of the interface, each relative to that of hexagons",
        solver_shapes,
    ),
    Objective(
        "balance",
        "sum of the squared weights of the parts",
        _squared_sizes("weights"),
        changes=moves.squared_weight_changes,
    ),
    Objective("measure_balance", "sum of the squared measures of the parts", _squared_sizes("measure")),
    Objective("cell_balance", "sum of the squared numbers of cells of the parts", _squared_sizes("cells")),
    Objective(
        "run_balance",
        "sum of the squared sizes of the parts, in the quantity that the run balances",
        _squared_sizes(None),
    ),
    Objective("diameter", "largest diameter of a part", _diameters, "max"),
    Objective("roundness", "deviation of the parts from round shapes of equal width", _roundness),
    Objective(
        "normalised_cut",
        "sum over the parts of cut edges divided by volume",
        _normalised_cuts,
        changes=moves.normalised_cut_changes,
    ),
)
OBJECTIVES: Final[Mapping[str, Objective]] = MappingProxyType({each.name: each for each in _TABLE})
"""All objectives by name."""
