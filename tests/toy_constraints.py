"""Constraints for tests."""

from __future__ import annotations

import numpy as np

__all__ = ["Line", "Regions", "pairs"]


def pairs(graph):
    """Return both cells of each CSR entry."""
    return np.repeat(np.arange(graph.n), np.diff(graph.indptr)), graph.indices


class Regions:
    """Forbid parts with cells of different regions."""

    def __init__(self, regions):
        self.regions = np.asarray(regions)

    def forbidden(self, graph):
        row, column = pairs(graph)
        return self.regions[row] != self.regions[column]


class Line:
    """Forbid edges across the line x = ``at``, optionally only ``above`` some height."""

    def __init__(self, at: float = 0.5, above: float = -np.inf) -> None:
        self.at, self.above = at, above

    def forbidden(self, graph):
        centroids = graph.centroids + graph.origin
        right, high = centroids[:, 0] > self.at, centroids[:, 1] > self.above
        row, column = pairs(graph)
        return (right[row] != right[column]) & high[row] & high[column]
