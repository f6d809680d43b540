"""Constraints to try things with."""

from __future__ import annotations

import numpy as np

__all__ = ["Line", "Regions", "pairs"]


def pairs(graph):
    """Both cells of each CSR entry."""
    return np.repeat(np.arange(graph.n), np.diff(graph.indptr)), graph.indices


class Regions:
    """Cells of different regions may not share a part."""

    def __init__(self, regions):
        self.regions = np.asarray(regions)

    def forbidden(self, graph):
        row, column = pairs(graph)
        return self.regions[row] != self.regions[column]


class Line:
    """Nothing is joined across the line x = ``at``; ``above`` some height only."""

    def __init__(self, at: float = 0.5, above: float = -np.inf) -> None:
        self.at, self.above = at, above

    def forbidden(self, graph):
        centroids = graph.centroids + graph.origin
        right, high = centroids[:, 0] > self.at, centroids[:, 1] > self.above
        row, column = pairs(graph)
        return (right[row] != right[column]) & high[row] & high[column]
