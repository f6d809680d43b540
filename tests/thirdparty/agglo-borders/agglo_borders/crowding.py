"""Metric ``crowding``."""

from __future__ import annotations

from math import inf

import numpy as np

from agglo_core.authoring import Float, Graph, Int, Mesh

__all__ = ["Crowding"]


class Crowding:
    """Squared number of cells of an agglomerate.

    The sum is smallest for equal numbers.
    """

    better = "low"
    bounds = (1.0, inf)
    homogeneity = 0

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the value of each agglomerate ``(k,)``."""
        return np.bincount(labels) ** 2.0

    def changes(self, graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
        """Return the changes of the sum ``(q,)``.

        The change is (m + 1)² − m² in the new part, and (m − 1)² − m² in the old part.
        """
        sizes = np.bincount(labels).astype(float)
        return np.where(labels[cells] == parts, 0.0, 2 * (sizes[parts] - sizes[labels[cells]] + 1))
