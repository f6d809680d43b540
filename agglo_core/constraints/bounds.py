"""Lower and upper bounds on part sizes."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from numbers import Real

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_int
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.mesh.marks import weights_of
from agglo_core.refine.part_sizes import block_sizes

_ROUNDING = 1e-9  # relative to a bound: sums of sizes within this tolerance meet it
_NO_LIMITS = 0.0, np.inf  # lower and upper bound of an unbounded quantity


class Bounds:
    """Bounds on cell count, measure or weight of parts.

    Parts that are too large are split, except single cells. Parts that are too small join the neighbour with
    the longest common interface, where size, count and other constraints allow.

    Parameters
    ----------
    max_cells, min_cells : int, optional
    max_measure, min_measure : float, optional
    max_weight, min_weight : float, optional
    weights : str, optional
        Name of the cell data that contain the weights. In Python also ``(n,)`` numbers.

    Raises
    ------
    OptionError
        If a bound is not positive, a lower bound exceeds the upper bound, or a bound on weights has no
        weights.
    """

    def __init__(
        self,
        max_cells: int | None = None,
        min_cells: int | None = None,
        max_measure: float | None = None,
        min_measure: float | None = None,
        max_weight: float | None = None,
        min_weight: float | None = None,
        weights: str | None = None,
    ) -> None:
        self._limits = {
            "cells": _limits("cells", min_cells, max_cells),
            "measure": _limits("measure", min_measure, max_measure),
            "weight": _limits("weight", min_weight, max_weight),
        }
        self._weights: str | Float | None = weights
        self._cells: Int | None = None
        if weights is None and self._limits["weight"] != _NO_LIMITS:
            word = "min_weight" if max_weight is None else "max_weight"
            raise OptionError(f"{word} needs weights: the name of cell data, or a number for each cell")

    def counting(self, cells: Int, weights: Float) -> Bounds:
        """Return these bounds for a coarse graph with ``cells[i]`` cells and ``weights[i]`` in node i."""
        made = copy(self)
        made._cells, made._weights = cells, weights
        return made

    def weights(self, graph: Graph) -> Float:
        """Return the cell weights ``(n,)``, or zeros if the bounds have none."""
        if self._weights is None:
            return np.broadcast_to(0.0, graph.n)
        return weights_of(self._weights, graph.data, graph.n)

    def admissible(self, graph: Graph, labels: Int) -> Mask:
        """Return a mask ``(k,)`` of the parts within the upper bounds, single cells included."""
        good = np.ones(int(labels.max(initial=-1)) + 1, bool)
        for values, (_, most) in self._bounded(graph):
            good &= np.bincount(labels, values) <= most * (1 + _ROUNDING)
        allowed: Mask = good | (np.bincount(labels) == 1)
        return allowed

    def incomplete(self, graph: Graph, labels: Int) -> Mask:
        """Return a mask ``(k,)`` of the parts below a lower bound."""
        small = np.zeros(int(labels.max(initial=-1)) + 1, bool)
        for values, (least, _) in self._bounded(graph):
            small |= np.bincount(labels, values) < least * (1 - _ROUNDING)
        return small

    def fewest(self, graph: Graph, components: Int) -> int:
        """Return the smallest part count within the upper bounds, for connected ``components (n,)``."""
        fewest = np.ones(int(components.max()) + 1)
        for values, (_, most) in self._bounded(graph):
            if most < np.inf:  # cells above the bound stay alone
                needed = np.bincount(components, np.minimum(values, most)) / most
                fewest = np.maximum(fewest, np.ceil(needed - _ROUNDING))
        return int(fewest.sum())

    def evened(self, graph: Graph, labels: Int, block: Int, through: Int, whole: Graph) -> Int:
        """Even out part sizes where bounds are violated, within each block (``block[p]`` for part p).

        Returns the labels ``(n,)``. Cell c of the ``whole`` graph, which supplies the measures, lies in node
        ``through[c]``. Violations may remain.
        """
        for values, limits in self._bounded(whole):
            sizes = frozen_float(np.bincount(through, values, graph.n))
            labels = _even_out_sizes(graph, labels, block, sizes, *limits)
        return labels

    def _bounded(self, graph: Graph) -> Iterator[tuple[Float | Int, tuple[float, float]]]:
        """Yield, for each bounded quantity, node values ``(n,)`` and the limits on their sums over parts."""
        for quantity, limits in self._limits.items():
            if limits == _NO_LIMITS:
                continue
            if quantity == "cells":
                yield np.broadcast_to(1.0, graph.n) if self._cells is None else self._cells, limits
            else:
                yield graph.measures if quantity == "measure" else self.weights(graph), limits


def _limits(quantity: str, least: float | None, most: float | None) -> tuple[float, float]:
    """Return the checked bounds of a quantity, with defaults 0 and infinity."""
    for name, value in ((f"max_{quantity}", most), (f"min_{quantity}", least)):
        number = isinstance(value, Real) and not isinstance(value, bool)
        if value is not None and not (number and 0 < value < np.inf):
            raise OptionError(f"{name} must be positive and finite, given {value!r}")
    if least is not None and most is not None and least > most:
        raise OptionError(f"min_{quantity} = {least} exceeds max_{quantity} = {most}")
    return least or 0.0, np.inf if most is None else most


def _even_out_sizes(graph: Graph, labels: Int, block: Int, sizes: Float, least: float, most: float) -> Int:
    from agglo_core.refine.balance_paths import even_out

    # 1. Parts that violate a bound, and blocks whose mean part size meets the bounds.
    of_parts = np.bincount(labels, sizes)
    broken = (of_parts < least * (1 - _ROUNDING)) | (of_parts > most * (1 + _ROUNDING))
    mean, cell = block_sizes(sizes, labels, block)
    block_mask = np.bincount(block, broken, len(mean)) > 0
    block_mask &= (mean >= least * (1 - _ROUNDING)) & (mean <= most * (1 + _ROUNDING))
    if not block_mask.any():
        return labels
    # 2. Balance these blocks within the distance from the mean to the nearer bound.
    tolerance = np.maximum(np.minimum(most - mean, mean - least), (1 - _ROUNDING) * cell)
    graph_arrays = graph.indptr, graph.indices, graph.centroids
    tolerance = frozen_float(np.where(block_mask, tolerance, np.inf))
    return frozen_int(even_out(*graph_arrays, sizes, labels, block, mean, tolerance))
