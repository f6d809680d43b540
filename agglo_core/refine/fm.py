"""Fiduccia–Mattheyses refinement: short interfaces at a given balance."""

from __future__ import annotations

from typing import Literal

import numpy as np

from agglo_core.arrays import Float, Int, UInt64, frozen_float, frozen_int
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.protocols import Target
from agglo_core.refine.part_sizes import block_sizes, check_size, check_tolerance, refine_blocks

_OBJECTIVES = ("interface", "cut")
_CELL = 1.000001  # size tolerance in mean cells: one cell plus a margin for rounding


class FMRefiner:
    """Move chains of boundary cells to shorten all interfaces, and keep the parts balanced.

    A chain of moves starts from each boundary cell, largest gain first, and also includes moves that do not
    pay. The prefix of the chain with the shortest interfaces is kept, the rest is undone (C. M. Fiduccia, R.
    M. Mattheyses, Proc. 19th Design Automation Conf., 1982; from single cells: P. Sanders, C. Schulz, ESA
    2011). Chains can therefore leave local minima of single moves. The refiner suits subdomains, whose
    interfaces determine the communication cost. For rounder parts use ``compactness``.

    No part is emptied or disconnected. Part sizes stay within ``tolerance`` times the block mean from the
    mean, or within one cell if that is more. A part beyond these bounds at entry moves no further away.

    Parameters
    ----------
    objective : "interface" or "cut"
        Interface length (area), or number of cut edges.
    size : "cells", "measure" or "weights", optional
        Quantity to keep balanced, see ``balance``. Default: the quantity that the run balances, else cells.
    tolerance : float
        0 or more.
    patience : int
        Number of moves without a gain that ends a chain, 1 or more.
    rounds : int
        Maximum number of rounds over all cells with a possible gain, 1 or more.

    Raises
    ------
    OptionError
        For any other value.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core import samples
    >>> from agglo_core.refine.fm import FMRefiner
    >>> from agglo_core.protocols import Target
    >>> graph = samples.squares(4).graph  # 4 x 4 cells in columns, from below
    >>> dented = np.array([0, 0, 1, 1, 0, 0, 0, 1, 0, 0, 1, 1, 0, 1, 1, 1])
    >>> FMRefiner().refine(graph, dented, np.zeros(1, np.uint64), Target(parts=2)).reshape(4, 4)
    array([[0, 0, 1, 1],
           [0, 0, 1, 1],
           [0, 0, 1, 1],
           [0, 0, 1, 1]])
    """

    def __init__(
        self,
        objective: Literal["interface", "cut"] = "interface",
        size: Literal["cells", "measure", "weights"] | None = None,
        tolerance: float = 0.03,
        patience: int = 10,
        rounds: int = 4,
    ) -> None:
        if objective not in _OBJECTIVES:
            raise OptionError(f"fm: objective must be one of {', '.join(_OBJECTIVES)}; given {objective!r}")
        for name, count in (("patience", patience), ("rounds", rounds)):
            if isinstance(count, bool) or not isinstance(count, int) or count < 1:
                raise OptionError(f"fm: {name} must be a whole number, 1 or more, not {count!r}")
        self.objective, self.size = objective, check_size("fm", size)
        self.tolerance = check_tolerance("fm", tolerance)
        self.patience, self.rounds = patience, rounds

    def refine(self, graph: Graph, labels: Int, seeds: UInt64, target: Target) -> Int:
        """Return the labels ``(n,)`` after all rounds, independent of the seeds."""
        return refine_blocks(self, graph, labels, target)

    def refine_parts(self, graph: Graph, labels: Int, block: Int, target: Target) -> Int:
        """Return the labels ``(n,)`` after all rounds, with exchanges of part p only within ``block[p]``."""
        from agglo_core.refine.prefix_searches import search_all

        lengths = np.ones(len(graph.indices)) if self.objective == "cut" else graph.interface
        if len(lengths) == 0:
            return labels
        sizes = graph.node_sizes(self.size)
        bounds = self._bounds(sizes, labels, block)
        csr = graph.indptr, graph.indices, frozen_float(lengths)
        return frozen_int(search_all(*csr, sizes, labels, block, *bounds, self.rounds, self.patience))

    def _bounds(self, sizes: Float, labels: Int, block: Int) -> tuple[Float, Float]:
        """Return the smallest and largest size ``(k,)`` allowed for each part."""
        mean, cell = block_sizes(sizes, labels, block)
        spread = np.maximum(self.tolerance * mean, _CELL * cell)
        given = np.bincount(labels, sizes, len(block))
        least, most = (mean - spread)[block], (mean + spread)[block]
        return frozen_float(np.minimum(least, given)), frozen_float(np.maximum(most, given))
