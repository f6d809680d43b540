"""The order in which loops visit the cells of a mesh in 3-D whose numbers are scattered.

What a loop takes of a cell is then near what it took of the last: twice as fast, and no number changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from agglo_core.authoring import Float, Int, Mesh, curve_order, frozen_int

FEW: Final = {2: 10_000, 3: 3_000}
"""Cells that are near enough to the processor in any order, by dimension."""
SCATTERED: Final = 4.0
"""Mean difference of the numbers of neighbours over √n, in 3-D n^⅔: .5 row by row or along a curve."""


@dataclass(frozen=True, eq=False)
class Walk:
    """Cells in the order in which they are visited.

    Attributes
    ----------
    cells : (n_cells,) int
    turns : (n_cells + 1,) int
        When each cell has its turn; the last entry is −1, for what is outside.
    """

    cells: Int
    turns: Int

    def rows(self, offsets: Int, items: Int) -> tuple[Int, Int]:
        """The lists ``items[offsets[c]:offsets[c + 1]]`` in the order of the walk."""
        counts = np.diff(offsets)[self.cells]
        ends = np.concatenate(([0], np.cumsum(counts)))
        places = np.repeat(offsets[self.cells] - ends[:-1], counts) + np.arange(ends[-1])
        return frozen_int(ends), frozen_int(items[places])

    def back(self, values: Float) -> Float:
        """Values ``(n_cells, …)`` in the order of the walk, by numbers of cells."""
        found = np.empty_like(values)
        found[self.cells] = values
        return found


def walk_through(mesh: Mesh) -> Walk | None:
    """A walk along a curve; None where cells are few, or their numbers not scattered."""
    n = mesh.n_cells
    pairs = mesh.face_cells[mesh.face_cells[:, 1] >= 0]
    if n < FEW[mesh.dim] or not len(pairs):
        return None
    if np.abs(pairs[:, 0] - pairs[:, 1]).mean() <= SCATTERED * n ** (1 - 1 / mesh.dim):
        return None
    cells = curve_order(mesh.local_centroids)
    turns = np.full(n + 1, -1)
    turns[cells] = np.arange(n)
    return Walk(cells, frozen_int(turns))
