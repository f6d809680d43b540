"""Sparse matrices of local blocks, and Dirichlet values in systems."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, Int


def sum_blocks(shape: tuple[int, int], blocks: Iterable[tuple[Int, Int, Float]]) -> sparse.csr_array:
    """Return the matrix with the sums of local blocks.

    Parameters
    ----------
    shape : (int, int)
    blocks : iterable of (c, N), (c, M), (c, N, M)
        Rows, columns and values of ``c`` blocks each.
    """
    parts = [
        (
            np.broadcast_to(rows[:, :, None], values.shape).ravel(),
            np.broadcast_to(columns[:, None], values.shape).ravel(),
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
    g, free, diagonal = np.zeros(len(b)), np.ones(len(b)), A.diagonal()
    g[unknowns], free[unknowns] = values, 0.0
    keep = sparse.diags_array(free)
    kept = sparse.csr_array(keep @ A @ keep + sparse.diags_array(diagonal * (1.0 - free)))
    kept.eliminate_zeros()
    return kept, free * (b - A @ g) + diagonal * g
