"""Products of matrices in small square blocks, which scipy multiplies as if blocks were large."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.arrays import frozen_float, frozen_index
from agglo_core.multigrid.kernels.block_products import block_columns, block_products
from agglo_core.multigrid.kernels.block_sweeps import UNROLLED


def have_kernels(*matrices: Any) -> bool:
    """Whether there are kernels for the products: all in square blocks of one size from 2 to 16, double."""
    if any(each.format != "bsr" or each.dtype != np.float64 for each in matrices):
        return False
    sizes = {size for each in matrices for size in each.blocksize}
    few = all(each.indptr[-1] < np.iinfo(np.int32).max for each in matrices)
    return few and len(sizes) == 1 and 1 < sizes.pop() <= UNROLLED


def block_matmat(A: Any, P: Any) -> sparse.bsr_array:
    """A P; columns come in any order."""
    places = frozen_index(np.arange(len(A.indices)))
    return _product(frozen_index(A.indptr), frozen_index(A.indices), places, A, 0, P)


def block_galerkin(A: Any, P: Any) -> sparse.bsr_array:
    """Pᵀ A P, columns sorted."""
    columns = P.shape[1] // P.blocksize[1]
    pattern = block_columns(frozen_index(P.indptr), frozen_index(P.indices), columns)
    starts, rows, places = (frozen_index(each) for each in pattern)
    found = _product(starts, rows, places, P, 1, block_matmat(A, P))
    found.sort_indices()
    return found


def _product(indptr: Any, rows: Any, places: Any, left: Any, transposed: int, P: Any) -> sparse.bsr_array:
    """The product of the blocks of a matrix, at their ``places``, with another matrix."""
    width, columns = int(P.blocksize[0]), P.shape[1] // int(P.blocksize[0])
    first, second = (frozen_float(each.data).reshape(-1) for each in (left, P))
    pattern = frozen_index(P.indptr), frozen_index(P.indices)
    found = block_products(width)(indptr, rows, places, first, transposed, *pattern, second, columns)
    shape = ((len(indptr) - 1) * width, P.shape[1])
    return sparse.bsr_array((found[2].reshape(-1, width, width), found[1], found[0]), shape=shape)
