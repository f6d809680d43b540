"""Radius of gyration of agglomerates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agglo_core import Mesh

__all__ = ["Gyration"]


class Gyration:
    """Radius of gyration of the cell centroids, weighted by measure, relative to the diameter.

    The value is 0 for a single cell, and at most sqrt(3/8) by Jung's theorem.
    """

    better = "low"
    bounds = (0.0, 0.62)
    homogeneity = 0

    def measure(self, mesh: Mesh, labels: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the value of each agglomerate ``(k,)``."""
        coarse = mesh.coarsen(labels)
        away = mesh.local_centroids - coarse.local_centroids[labels]
        squares = np.bincount(labels, mesh.cell_measures * (away**2).sum(axis=1))
        return np.sqrt(squares / coarse.cell_measures) / coarse.cell_diameters
