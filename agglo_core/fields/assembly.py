"""Sparse matrices of local blocks, and Dirichlet values in systems."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, Int, index_cast


def sum_blocks(shape: tuple[int, int], blocks: Iterable[tuple[Int, Int, Float]]) -> sparse.csr_array:
    """Return the matrix with the sums of local blocks.

    Parameters
    ----------
    shape : (int, int)
    blocks : iterable of (c, N), (c, M), (c, N, M)
        Rows, columns and values of ``c`` blocks each.
    """
    most = max(shape)
    parts = [
        (
            np.broadcast_to(index_cast(rows, most)[:, :, None], values.shape).ravel(),
            np.broadcast_to(index_cast(columns, most)[:, None], values.shape).ravel(),
            values.ravel(),
        )
        for rows, columns, values in blocks
    ]
    rows, columns, values = (np.concatenate(each) for each in zip(*parts, strict=True))
    return sparse.csr_array(sparse.coo_array((values, (rows, columns)), shape=shape))


def fix_unknowns(
    A: sparse.csr_array, b: Float, unknowns: Int, values: Float
) -> tuple[sparse.csr_array, Float]:
    """Return the system in which some unknowns have given values, and rows with the diagonal entry alone.

    Their columns move to the right-hand side, so that the matrix remains symmetric.
    """
    g, free = np.zeros(len(b)), np.ones(len(b), bool)
    g[unknowns], free[unknowns] = values, False
    rows = np.repeat(np.arange(len(b)), np.diff(A.indptr))
    kept = (free[rows] & free[A.indices]) | (rows == A.indices)
    fixed = sparse.csr_array((A.data * kept, A.indices, A.indptr), shape=A.shape, copy=True)
    fixed.eliminate_zeros()
    return fixed, np.where(free, b - A @ g, A.diagonal() * g)
