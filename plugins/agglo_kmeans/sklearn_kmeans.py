"""The paper's k-means bisection by scikit-learn: k-means++ seeding, restarts, Lloyd iterations."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from agglo_core.authoring import Float, Graph, Int, OptionError
from agglo_core.graph.blocks import block_shares

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

_LEAST_WEIGHT = 1e-6  # relative to the mean: clusters with weight zero would be empty


class SklearnKMeans:
    """Bisect by 2-means on the centroids, with node weights (by default measures).

    Parameters
    ----------
    n_init : int
        Restarts; the lowest energy is kept. A single start often misses the best split.

    Raises
    ------
    OptionError
        If ``n_init`` is not a positive integer.
    """

    needs_points = True

    def __init__(self, n_init: int = 10) -> None:
        if isinstance(n_init, bool) or not isinstance(n_init, int) or n_init < 1:
            raise OptionError(f"kmeans_sklearn: n_init must be a positive integer, not {n_init!r}")
        self.n_init = n_init

    def bisect(self, graph: Graph, rng: np.random.Generator) -> Int:
        """Bisect the graph, and return each node's side ``(n,)``, 0 or 1.

        Both sides occur if there are at least two nodes.
        """
        from sklearn.cluster import KMeans

        points = _unit(graph.centroids)
        if len(np.unique(points, axis=0)) < 2:  # all nodes coincide
            return np.arange(graph.n) * 2 // max(graph.n, 1)
        relative = graph.n * block_shares(graph.weights, graph.block_ids)
        model = KMeans(2, n_init=self.n_init, random_state=int(rng.integers(2**31)))
        # On pieces this small threads cost more than they save, and on a busy machine they spin
        with _threads().limit(limits=1, user_api="openmp"):
            model.fit(points, sample_weight=np.maximum(relative, _LEAST_WEIGHT))
        return np.asarray(model.labels_, dtype=np.int64)


@cache
def _threads() -> ThreadpoolController:
    """Return this process's thread pools, cached because finding them takes milliseconds."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def _unit(centroids: Float) -> Float:
    """Move and scale centroids to the unit box, because scikit-learn's tolerances are not scale-free.

    Centroids that differ only by rounding become equal, so that scikit-learn counts distinct points.
    """
    low = centroids.min(axis=0)
    extent = float((centroids - low).max())
    return np.round((centroids - low) / extent, 12) if extent > 0 else np.zeros_like(centroids)
