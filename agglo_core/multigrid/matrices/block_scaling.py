"""Scaling of block matrices to identity diagonal blocks.

Local bases on flat or cut cells are nearly dependent, and coefficients differ between cells by any factor:
in single precision, the blocks of such a matrix lose all digits. In bases that are orthonormal in the energy
of their own cell, no digits are lost, and multigrid may run in single precision on any mesh.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from agglo_core.arrays import frozen_float, frozen_index, frozen_int
from agglo_core.multigrid.kernels.unit_blocks import scale_blocks


class Scaled(NamedTuple):
    """Matrix scaled to identity diagonal blocks, with the transformation T.

    Attributes
    ----------
    A : (n, n) bsr
        T A Tᵀ. The solution of A x = b is x = Tᵀ y with (T A Tᵀ) y = T b.
    T : (n, n) bsr
        Block diagonal and lower triangular, like its inverse L.
    LT : (n, n) bsr
        Lᵀ, which maps x to y.
    """

    A: sparse.bsr_array
    T: sparse.bsr_array
    LT: sparse.bsr_array


def block_scaled(A: Any) -> Scaled:
    """Transform the unknowns of each block so that its diagonal block becomes the identity.

    Parameters
    ----------
    A : (n, n) bsr
        Symmetric positive definite matrix in square blocks.

    Raises
    ------
    LinAlgError
        If a diagonal block is missing or not positive definite.

    Examples
    --------
    >>> from scipy import sparse
    >>> block_scaled(sparse.csr_array([[4.0, 2.0], [2.0, 16.0]]).tobsr((1, 1))).A.toarray().tolist()
    [[1.0, 0.25], [0.25, 1.0]]
    """
    pattern, width = (frozen_int(A.indptr), frozen_index(A.indices)), int(A.blocksize[0])
    failed, T, LT, blocks = scale_blocks(width)(*pattern, frozen_float(A.data))
    if failed >= 0:
        raise np.linalg.LinAlgError(f"the diagonal block of part {failed} is not positive definite")
    scaled = sparse.bsr_array((blocks, A.indices, A.indptr), shape=A.shape)
    return Scaled(scaled, _diagonal(T), _diagonal(LT))


def _diagonal(blocks: NDArray[Any]) -> sparse.bsr_array:
    count, width, _ = blocks.shape
    places = np.arange(count + 1, dtype=np.int32)
    return sparse.bsr_array((blocks, places[:-1], places), shape=(count * width, count * width))
