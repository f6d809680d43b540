"""K-way polish: make parts compact and their interfaces short."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Int, UInt64
from agglo_core.graph import Graph
from agglo_core.graph.moves import SHORTNESS
from agglo_core.protocols import Target
from agglo_core.refine.compactness.polish import sweep_blocks
from agglo_core.refine.interface import check_floor
from agglo_core.refine.part_sizes import refine_blocks


class CompactnessRefiner:
    """Move boundary cells so that parts become compact and their interfaces short.

    The refiner lowers J · L^0.3 in each block. J is the parts' moment of inertia, the k-means energy, and L
    the interface length. A product needs no weight with a unit, so neither the scale nor the part count
    matters. Sweeps of single-cell moves visit the boundary cells of all parts until no move pays. They visit
    parts, and the cells in each part, along an axis of the block, so the result does not depend on cell
    numbering. No part is emptied or disconnected, and no part falls below ``floor`` times its measure at
    entry, or changes by the measure of more than 12 mean cells. With a size target, no move makes a part
    wider than the target.

    Parameters
    ----------
    floor : float in [0, 1]

    Raises
    ------
    OptionError
        If ``floor`` is not a number in [0, 1].

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core import samples
    >>> from agglo_core.refine.compactness.refiner import CompactnessRefiner
    >>> from agglo_core.protocols import Target
    >>> graph = samples.squares(4).graph  # 4 x 4 cells in columns, from below
    >>> dented = np.array([0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 1])
    >>> CompactnessRefiner().refine(graph, dented, np.zeros(1, np.uint64), Target(parts=2)).reshape(4, 4)
    array([[0, 0, 1, 1],
           [0, 0, 1, 1],
           [0, 0, 1, 1],
           [0, 0, 1, 1]])
    """

    # ``require_no_worse`` rejects labels with a larger value of this objective, whose exponent is SHORTNESS.
    # An option for another exponent would need another objective. Benchmarks replace SHORTNESS in this
    # module.
    objective = "shape"
    # No move disconnects, empties or widens a part, so the levels need no such test afterwards.
    tests_moves = True

    def __init__(self, floor: float = 0.5) -> None:
        self.floor = check_floor("compactness", floor)

    def refine(self, graph: Graph, labels: Int, seeds: UInt64, target: Target) -> Int:
        """Return the labels ``(n,)`` after the sweeps, independent of the seeds."""
        return refine_blocks(self, graph, labels, target)

    def refine_parts(self, graph: Graph, labels: Int, block: Int, target: Target) -> Int:
        """Return the labels ``(n,)`` after the sweeps, with exchanges of part p only within ``block[p]``."""
        if graph.n == 0:
            return labels
        limit = np.inf if target.h_star is None else float(target.h_star)
        return sweep_blocks(graph, labels, block, SHORTNESS, self.floor, limit)
