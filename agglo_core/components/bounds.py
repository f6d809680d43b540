"""Constraints on how much a part may hold, and must."""

from __future__ import annotations

from numbers import Real

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_int
from agglo_core.components.part_sizes import block_sizes
from agglo_core.errors import OptionError
from agglo_core.graph import Graph

__all__ = ["Bounds"]

_ROUNDING = 1e-9


class Bounds:
    """Parts of at most so many cells, or so much measure, and of at least as much where it can be had.

    What is too large is split until it is not, single cells excepted; what is too small joins the neighbour
    with which it shares the longest interface, where size, count and other constraints allow.

    Parameters
    ----------
    max_cells, min_cells : int, optional
    max_measure, min_measure : float, optional

    Raises
    ------
    OptionError
        If a bound is not positive, or the least exceeds the most.
    """

    def __init__(
        self,
        max_cells: int | None = None,
        min_cells: int | None = None,
        max_measure: float | None = None,
        min_measure: float | None = None,
    ) -> None:
        self.max_cells, self.min_cells = max_cells, min_cells
        self.max_measure, self.min_measure = max_measure, min_measure
        self._cells: Int | None = None
        for name, value in self._given.items():
            number = isinstance(value, Real) and not isinstance(value, bool)
            if value is not None and not (number and 0 < value < np.inf):
                raise OptionError(f"{name} must be positive and finite, given {value!r}")
        for what in ("cells", "measure"):
            least, most = getattr(self, f"min_{what}"), getattr(self, f"max_{what}")
            if least is not None and most is not None and least > most:
                raise OptionError(f"min_{what}, {least}, is more than max_{what}, {most}")

    @property
    def _given(self) -> dict[str, float | None]:
        return {name: value for name, value in vars(self).items() if name != "_cells"}

    def counting(self, cells: Int) -> Bounds:
        """The same bounds on agglomerates: node i of a graph holds ``cells[i]`` cells."""
        made = Bounds(self.max_cells, self.min_cells, self.max_measure, self.min_measure)
        made._cells = cells
        return made

    def admissible(self, graph: Graph, labels: Int) -> Mask:
        """Which parts ``(k,)`` are not too large; single cells never are."""
        cells, measures = self._sizes(graph, labels)
        good = np.ones(len(cells), bool)
        if self.max_cells is not None:
            good &= cells <= self.max_cells
        if self.max_measure is not None:
            good &= measures <= self.max_measure * (1 + _ROUNDING)
        allowed: Mask = good | (np.bincount(labels) == 1)
        return allowed

    def incomplete(self, graph: Graph, labels: Int) -> Mask:
        """Which parts ``(k,)`` are too small."""
        cells, measures = self._sizes(graph, labels)
        small = np.zeros(len(cells), bool)
        if self.min_cells is not None:
            small |= cells < self.min_cells
        if self.min_measure is not None:
            small |= measures < self.min_measure * (1 - _ROUNDING)
        return small

    def fewest(self, graph: Graph, components: Int) -> int:
        """Least number of parts that can be had of cells that are connected as ``components (n,)`` say."""
        least = np.ones(int(components.max()) + 1)
        if self.max_cells is not None:
            cells = np.bincount(components, self._cells)
            least = np.maximum(least, np.ceil(cells / self.max_cells))
        if self.max_measure is not None:
            measures = np.minimum(graph.measures, self.max_measure)  # wider cells stay alone
            needed = np.bincount(components, measures) / self.max_measure
            least = np.maximum(least, np.ceil(needed - _ROUNDING))
        return int(least.sum())

    def evened(self, graph: Graph, labels: Int, block: Int, through: Int, whole: Graph) -> Int:
        """Labels ``(n,)`` after cells were handed on where parts of a block ``block[p]`` break a bound.

        Cell c of the ``whole`` graph, whose measures count, lies in the node ``through[c]``. What
        cannot be mended so is left.
        """
        for weights, least, most in (
            (self._cells, self.min_cells, self.max_cells),
            (whole.measures, self.min_measure, self.max_measure),
        ):
            sizes = frozen_float(np.bincount(through, weights, graph.n))
            if least is not None or most is not None:
                labels = _evened(graph, labels, block, sizes, least or 0.0, most or np.inf)
        return labels

    def _sizes(self, graph: Graph, labels: Int) -> tuple[Int, Float]:
        """Cells and measure of each part."""
        return (
            frozen_int(np.bincount(labels, self._cells)),
            frozen_float(np.bincount(labels, graph.measures)),
        )


def _evened(graph: Graph, labels: Int, block: Int, sizes: Float, least: float, most: float) -> Int:
    from agglo_core.kernels.balance_paths import even_out

    of_parts = np.bincount(labels, sizes)
    broken = (of_parts < least * (1 - _ROUNDING)) | (of_parts > most * (1 + _ROUNDING))
    mean, cell = block_sizes(sizes, labels, block)
    usable = np.bincount(block, broken, len(mean)) > 0
    usable &= (mean >= least * (1 - _ROUNDING)) & (mean <= most * (1 + _ROUNDING))
    if not usable.any():
        return labels
    room = np.maximum(np.minimum(most - mean, mean - least), (1 - _ROUNDING) * cell)
    where = graph.indptr, graph.indices, graph.centroids
    room = frozen_float(np.where(usable, room, np.inf))
    return frozen_int(even_out(*where, sizes, labels, block, mean, room))
