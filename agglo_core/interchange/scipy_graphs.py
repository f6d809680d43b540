"""Convert sparse matrices of scipy to graphs of their unknowns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from agglo_core.arrays import plain_array
from agglo_core.errors import MeshError, OptionError
from agglo_core.graph import Graph
from agglo_core.problems.real_arrays import block_size, real_matrix


def graph_from_scipy(A: Any, points: ArrayLike | None = None) -> Graph:
    """Build the graph of a square sparse matrix, as :meth:`Graph.from_scipy` describes."""
    if not sparse.issparse(A):
        raise OptionError(
            f"Graph.from_scipy needs a sparse matrix of scipy, given {type(A).__name__}: "
            "convert an array by scipy.sparse.csr_array(A)"
        )
    entries = sparse.coo_array(real_matrix(A))
    n = entries.shape[0]
    if entries.shape != (n, n):
        raise OptionError(f"A must be a square matrix, given shape {entries.shape}")
    (rows, columns), values = entries.coords, entries.data
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        place = rows[bad[0]], columns[bad[0]]
        raise OptionError(f"A[{place[0]}, {place[1]}] is {values[bad[0]]}: it must be finite")
    # The nodes are the blocks of a BSR matrix.
    size = block_size(A)
    rows, columns, n = rows // size, columns // size, n // size
    centroids = np.zeros((n, 2)) if points is None else plain_array(points, "points")
    if points is not None and (centroids.ndim != 2 or centroids.shape not in ((n, 2), (n, 3))):
        raise MeshError(
            f"points must have shape ({n}, 2) or ({n}, 3), one point for each "
            f"{'row' if size == 1 else 'block'} of A, not {centroids.shape}"
        )
    # (|A| + |Aᵀ|) / 2 without diagonal and stored zeros, summed over blocks.
    kept = (rows != columns) & (values != 0)
    half = sparse.csr_array((0.5 * abs(values[kept]), (rows[kept], columns[kept])), shape=(n, n))
    edges = sparse.csr_array(half + half.T)
    edges.sort_indices()
    return Graph.from_arrays(edges.indptr, edges.indices, centroids, interface=edges.data)
