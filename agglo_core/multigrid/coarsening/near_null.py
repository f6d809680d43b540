"""Near-null vectors of a matrix, computed or improved by Gauss–Seidel sweeps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, frozen_float
from agglo_core.multigrid.matrices.block_matrix import block_matrix


def smoothed_near_null(
    A: Any, block_offsets: Int, near_null: ArrayLike | None = None, sweeps: int = 4
) -> Float:
    """Return smoothed near-null vectors: the result of block Gauss–Seidel sweeps for A x = 0.

    Vectors in the null space of A stay unchanged. By default, constants are smoothed. For parts of equal
    size, column j starts as 1 at the j-th unknown (component) of each part, and 0 elsewhere. For example,
    mean and slopes of polynomials are not all near-null vectors, but after the sweeps nearly so. For parts of
    unequal size, the j-th unknowns of parts are not related, and the single column starts as 1 everywhere.

    Parameters
    ----------
    A : (n, n) sparse
        Symmetric positive (semi)definite matrix.
    block_offsets : (parts + 1,) int
        Part p has the unknowns ``block_offsets[p]:block_offsets[p + 1]``.
    near_null : (n, k) float, optional
    sweeps : int
        Number of symmetric sweeps, forward and backward.

    Returns
    -------
    (n, k) float
        By default, k is the part size, or 1 for unequal parts.

    Raises
    ------
    LinAlgError
        If a diagonal block is not positive definite.

    Notes
    -----
    Adaptive smoothed aggregation (Brezina and others, SIAM J. Sci. Comput. 25, 2004) starts from random
    vectors. The vectors here are better starts.

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
    matrix, zero, columns = block_matrix(A, block_offsets), np.zeros(A.shape[0]), []
    for column in np.asarray(near_null, np.float64).T:
        x = column.copy()
        for _ in range(sweeps):
            x = matrix.backward(zero, matrix.forward(zero, x))
        columns.append(x)
    return frozen_float(np.stack(columns, axis=1))
