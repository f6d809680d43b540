"""Vectors that a matrix takes to nearly nothing, made better or found."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, frozen_float
from agglo_core.multigrid.matrices.block_matrix import block_matrix


def smoothed_near_null(
    A: Any, block_offsets: Int, near_null: ArrayLike | None = None, sweeps: int = 4
) -> Float:
    """Return near-null vectors, smoothed: what block Gauss–Seidel for A x = 0 leaves of them.

    Vectors that A takes to zero stay as they are. By default constants are smoothed: where parts are of one
    size column j starts as 1 at the j-th unknown of each part, the j-th component, and 0 elsewhere. Mean and
    slopes of polynomials, say, are not all near-null vectors, but what sweeps leave of them nearly is. Where
    sizes differ the j-th unknowns of parts are not taken to have anything in common: there is one column,
    which starts as 1 everywhere.

    Parameters
    ----------
    A : (n, n) sparse
        Symmetric and positive (semi)definite.
    block_offsets : (parts + 1,) int
        The unknowns of part p are ``block_offsets[p]:block_offsets[p + 1]``.
    near_null : (n, k) float, optional
    sweeps : int
        Symmetric ones, forward and backward.

    Returns
    -------
    (n, k) float
        By default k is the size of parts, 1 if they differ.

    Raises
    ------
    LinAlgError
        If a diagonal block is not positive definite.

    Notes
    -----
    The candidates of adaptive smoothed aggregation (Brezina and others, SIAM J. Sci. Comput. 25, 2004) start
    from random vectors; these start from better ones.

    Examples
    --------
    >>> from scipy import sparse
    >>> A = sparse.csr_array([[1.0, -1.0], [-1.0, 1.0]])
    >>> smoothed_near_null(A, np.arange(3)).tolist()
    [[1.0], [1.0]]
    """
    if near_null is None:
        sizes = np.diff(block_offsets)
        width = int(sizes[0]) if (sizes == sizes[0]).all() else 1
        near_null = np.arange(A.shape[0])[:, None] % width == np.arange(width)
    matrix, zero, found = block_matrix(A, block_offsets), np.zeros(A.shape[0]), []
    for column in np.asarray(near_null, np.float64).T:
        x = column.copy()
        for _ in range(sweeps):
            x = matrix.backward(zero, matrix.forward(zero, x))
        found.append(x)
    return frozen_float(np.stack(found, axis=1))
