"""The metric ``crowding``."""

from __future__ import annotations

from math import inf

import numpy as np

from agglo_core.authoring import Float, Graph, Int, Mesh

__all__ = ["Crowding"]


class Crowding:
    """Number of cells of an agglomerate, squared: the sum is least where all have equally many."""

    better = "low"
    bounds = (1.0, inf)
    homogeneity = 0

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Value of each agglomerate ``(k,)``."""
        return np.bincount(labels) ** 2.0

    def changes(self, graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
        """Change of the sum ``(q,)``: (m + 1)² − m² where a cell goes, (m − 1)² − m² where it was."""
        sizes = np.bincount(labels).astype(float)
        return np.where(labels[cells] == parts, 0.0, 2 * (sizes[parts] - sizes[labels[cells]] + 1))
