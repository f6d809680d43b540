"""Loop order over the cells of a 3-D mesh whose neighbouring cells have distant indices.

Successive cells are then adjacent in memory: loops are twice as fast, and no number changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from agglo_core.authoring import Int, Mesh, frozen_int
from agglo_core.graph.ordering import curve_order

FEW: Final = {2: 10_000, 3: 3_000}
"""Number of cells, by dimension, up to which any order is fast enough (benchmarks/solve.py;
benchmarks/assembly.py, row scattered)."""
SCATTERED: Final = 4.0
"""Limit for the mean number difference of neighbours over √n, in 3-D n^⅔: about 0.5 for rows or curves.

A larger value leaves more meshes in their own order, a smaller one renumbers meshes that gain little
(benchmarks/solve.py; benchmarks/assembly.py, row scattered).
"""


@dataclass(frozen=True, eq=False)
class Walk:
    """Order in which loops visit the cells of a mesh.

    Attributes
    ----------
    cells : (n_cells,) int
    turns : (n_cells + 1,) int
        Each cell's position in the order; the last entry is −1, for the outside.
    """

    cells: Int
    turns: Int

    def rows(self, offsets: Int, items: Int) -> tuple[Int, Int]:
        """Reorder the lists ``items[offsets[c]:offsets[c + 1]]`` of the cells c to walk order."""
        counts = np.diff(offsets)[self.cells]
        ends = np.concatenate(([0], np.cumsum(counts)))
        places = np.repeat(offsets[self.cells] - ends[:-1], counts) + np.arange(ends[-1])
        return frozen_int(ends), frozen_int(items[places])

    def back(self, values: Any) -> Any:
        """Reorder values ``(n_cells, …)`` from walk order to cell index order."""
        found = np.empty_like(values)
        found[self.cells] = values
        return found


def walk_through(mesh: Mesh) -> Walk | None:
    """Return a walk along a space-filling curve, or None if the mesh is small or already well ordered."""
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
