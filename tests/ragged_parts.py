"""Connected parts of very different sizes, with ragged outlines."""

from __future__ import annotations

import numpy as np

from agglo_core import Graph
from agglo_core.arrays import Int


def grown(graph: Graph, seed: int, parts: int) -> Int:
    """Return parts ``(n,)`` grown from random cells, one cell at a time, next to a random labelled cell."""
    rng = np.random.default_rng(seed)
    labels = np.full(graph.n, -1)
    labels[rng.choice(graph.n, parts, replace=False)] = np.arange(parts)
    while (labels < 0).any():
        i = int(rng.choice(np.flatnonzero(labels >= 0)))
        free = [j for j in graph.indices[graph.indptr[i] : graph.indptr[i + 1]] if labels[j] < 0]
        if free:
            labels[rng.choice(free)] = labels[i]
    return labels
