"""The k-way polish: compact parts with short interfaces."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Int, UInt64
from agglo_core.graph import Graph
from agglo_core.graph.moves import SHORTNESS
from agglo_core.protocols import Target
from agglo_core.refine.compactness.polish import swept
from agglo_core.refine.interface import checked_floor
from agglo_core.refine.part_sizes import refined_blocks


class CompactnessRefiner:
    """Moves boundary cells to where parts become compact and their interfaces short.

    It lowers, in each block, J · L^0.3: J is the moment of inertia of the parts, the energy of k-means, and
    L the length of the interfaces. The product has no unit, so neither scale nor number of parts matter.
    Sweeps of single-cell moves go over the boundary cells of all parts until none pays; they take the parts,
    and the cells of each, along an axis of the block, so the result does not depend on cell numbering. No
    part is emptied or disconnected, none falls below ``floor`` times its measure at entry, and if the target
    is a size, no cell goes where it would be too far from others.

    Parameters
    ----------
    floor : float in [0, 1]

    Raises
    ------
    OptionError
        If ``floor`` is anything else.

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

    # ``require_no_worse`` refuses labels with a larger value of this objective, whose exponent is SHORTNESS:
    # an option for another exponent needs another objective. Benchmarks replace SHORTNESS in this module.
    objective = "shape"

    def __init__(self, floor: float = 0.5) -> None:
        self.floor = checked_floor("compactness", floor)

    def refine(self, graph: Graph, labels: Int, seeds: UInt64, target: Target) -> Int:
        """Labels ``(n,)`` after the sweeps; seeds are not used."""
        return refined_blocks(self, graph, labels, target)

    def refine_parts(self, graph: Graph, labels: Int, block: Int, target: Target) -> Int:
        """Labels ``(n,)`` after the sweeps; part p may trade cells with parts of ``block[p]`` alone."""
        if graph.n == 0:
            return labels
        limit = np.inf if target.h_star is None else float(target.h_star)
        return swept(graph, labels, block, SHORTNESS, self.floor, limit)
