"""Quotient of a graph: one node per agglomerate, with the geometry of the agglomerates."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, Index, Int, frozen_float, frozen_index, frozen_int

__all__ = ["Quotient", "quotient"]


class Quotient(NamedTuple):
    """Arrays of a quotient graph of k nodes, and ``gather (k, n)``, the ones that add up over nodes."""

    gather: sparse.csr_array[Any, Any]
    indptr: Int
    indices: Index
    interface: Float
    measures: Float
    centroids: Float
    vertex_offsets: Int
    vertices: Index


def quotient(
    labels: Int,
    adjacency: sparse.csr_array[Any, Any],
    measures: Float,
    centroids: Float,
    vertex_offsets: Int,
    vertices: Index,
    n_points: int,
) -> Quotient:
    """Interfaces and measures of agglomerates ``labels (n,)`` add up, centroids are averaged by measure."""
    n, k = len(labels), int(labels.max()) + 1
    gather = sparse.csr_array((np.ones(n), (labels, np.arange(n))), shape=(k, n))
    product = sparse.coo_array(gather @ adjacency @ gather.T)
    outer = product.row != product.col
    matrix = sparse.csr_array((product.data[outer], (product.row[outer], product.col[outer])), shape=(k, k))
    mass = measures if ((total := gather @ measures) > 0).all() else np.ones(n)
    corners = np.unique(np.repeat(labels, np.diff(vertex_offsets)) * n_points + vertices)
    counts = np.bincount(corners // n_points, minlength=k)
    return Quotient(
        gather,
        frozen_int(matrix.indptr),
        frozen_index(matrix.indices),
        frozen_float(matrix.data),
        frozen_float(total),
        frozen_float((gather @ (centroids * mass[:, None])) / (gather @ mass)[:, None]),
        frozen_int(np.concatenate(([0], np.cumsum(counts)))),
        frozen_index(corners % n_points),
    )
