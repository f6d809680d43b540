"""The paper's k-means bisection, through scikit-learn: k-means++ seeding, restarts, Lloyd iterations."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int
from agglo_core.errors import OptionError
from agglo_core.graph import Graph

__all__ = ["SklearnKMeans"]


class SklearnKMeans:
    """2-means of the centroids weighted by the weights of the nodes (by default measures).

    Parameters
    ----------
    n_init : int
        Restarts; the one of lowest energy is kept. One restart often misses the best split.

    Raises
    ------
    OptionError
        If ``n_init`` is not a positive integer.
    """

    def __init__(self, n_init: int = 10) -> None:
        if isinstance(n_init, bool) or not isinstance(n_init, int) or n_init < 1:
            raise OptionError(f"kmeans_sklearn: n_init must be a positive integer, not {n_init!r}")
        self.n_init = n_init

    def bisect(self, graph: Graph, rng: np.random.Generator) -> Int:
        """Return the side of each node ``(n,)``; both sides occur if there are two nodes."""
        from sklearn.cluster import KMeans

        points = _unit(graph.centroids)
        if len(np.unique(points, axis=0)) < 2:  # nothing to tell the nodes apart
            return np.arange(graph.n) * 2 // max(graph.n, 1)
        weights = graph.weights if graph.weights.any() else np.ones(graph.n)
        model = KMeans(2, n_init=self.n_init, random_state=int(rng.integers(2**31)))
        model.fit(points, sample_weight=weights / weights.mean())
        sides = np.asarray(model.labels_, dtype=np.int64)
        if sides.min() == sides.max():  # weights of zero leave a cluster empty
            sides = (np.arange(graph.n) == np.argmax(_distances(points, weights))).astype(np.int64)
        return sides


def _unit(centroids: Float) -> Float:
    """Centroids moved and scaled into the unit box: scikit-learn's tolerances are not scale-free.

    Those that differ by rounding alone become equal, so that there are as many points as it counts.
    """
    low = centroids.min(axis=0)
    extent = float((centroids - low).max())
    return np.round((centroids - low) / extent, 12) if extent > 0 else np.zeros_like(centroids)


def _distances(points: Float, weights: Float) -> Float:
    """Distance of each point from the centre of mass."""
    return np.asarray(np.linalg.norm(points - np.average(points, axis=0, weights=weights), axis=1))
