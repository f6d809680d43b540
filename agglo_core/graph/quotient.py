"""Compute quotient graphs: one node per agglomerate, with its geometry."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from agglo_core.arrays import Float, Index, Int, frozen_float, frozen_index, frozen_int
from agglo_core.graph.block_graph import BlockGraph


class Quotient(NamedTuple):
    """Arrays of a quotient graph, one node per agglomerate, named as in ``Graph``."""

    indptr: Int
    indices: Index
    interface: Float
    centroids: Float
    measures: Float
    boundary: Float
    weights: Float
    vertex_offsets: Int
    vertices: Index


def quotient(labels: Int, fine: BlockGraph) -> Quotient:
    """Build the quotient graph of agglomerates ``labels (n,)``: sums of measures, means of centroids.

    Neighbours and vertices are in ascending order.
    """
    from agglo_core.graph.coarse_graphs import quotient_edges, union_of_rows

    k, part = int(labels.max()) + 1, frozen_index(labels)

    def sum_parts(values: Float) -> Float:
        return frozen_float(np.bincount(labels, weights=values, minlength=k))

    rows, columns, values = quotient_edges(part, k, fine.indptr, fine.indices, fine.interface)
    edges = _sort_rows(rows, columns, values, k)
    offsets, vertices = union_of_rows(part, k, fine.vertex_offsets, fine.vertices, len(fine.points))
    corners = _sort_rows(offsets, vertices, np.zeros(len(vertices), bool), len(fine.points))
    # Without measure in some part, the centroid is the mean over its nodes.
    total = sum_parts(fine.measures)
    mass = fine.measures if (total > 0).all() else frozen_float(np.ones(len(labels)))
    middle = np.stack([sum_parts(mass * x) for x in fine.centroids.T], axis=1) / sum_parts(mass)[:, None]
    return Quotient(
        frozen_int(edges.indptr),
        frozen_index(edges.indices),
        frozen_float(edges.data),
        frozen_float(middle),
        total,
        sum_parts(fine.boundary),
        total if fine.weights is fine.measures else sum_parts(fine.weights),
        frozen_int(corners.indptr),
        frozen_index(corners.indices),
    )


def _sort_rows(
    offsets: Int, columns: Index, values: NDArray[Any], n_columns: int
) -> sparse.csr_array[Any, Any]:
    """Return a CSR with the columns of every row in ascending order."""
    rows = sparse.csr_array((values, columns, offsets), shape=(len(offsets) - 1, n_columns))
    rows.sort_indices()
    return rows
