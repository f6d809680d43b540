"""Fast products of vectors with small-block matrices, for which scipy's loops are slow."""

from __future__ import annotations

from typing import Any

import numpy as np

from agglo_core.arrays import Float, frozen_float, frozen_index
from agglo_core.multigrid.kernels.block_sweeps import UNROLLED, block_product


class BlockProduct:
    """Matrix in square blocks, prepared for many products with vectors ``(n,)``.

    Parameters
    ----------
    A : (n, n) bsr_array
        Matrix in double precision with blocks of 2 to 16 unknowns.
    """

    def __init__(self, A: Any) -> None:
        self.shape, self.dtype = A.shape, A.dtype
        self._A = A
        self._arrays = frozen_index(A.indptr), frozen_index(A.indices), frozen_float(A.data).reshape(-1)
        self._kernel = block_product(int(A.blocksize[0]))

    def __matmul__(self, x: Float) -> Float:
        if x.ndim != 1:  # scipy is fast for several vectors
            several: Float = self._A @ x
            return several
        y: Float = self._kernel(*self._arrays, frozen_float(x))
        return y


def fast_product(A: Any) -> Any:
    """Return A as :class:`BlockProduct` if it has square blocks of 2 to 16 unknowns, else A itself."""
    if getattr(A, "format", "") != "bsr" or A.dtype != np.float64:
        return A
    rows, columns = A.blocksize
    fits = rows == columns and 1 < rows <= UNROLLED and A.indptr[-1] < np.iinfo(np.int32).max
    return BlockProduct(A) if fits else A
