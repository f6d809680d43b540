"""Products with prolongations stored in blocks of one column.

Each part of n unknowns depends on a few coarse unknowns, with n entries each. The matrix is a
``scipy.sparse.bsr_array`` with blocks ``(n, 1)``, for which scipy's loops for large blocks are slow. A
single array serves both directions, without stored transpose.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from agglo_core.compiled.compiling import kernel

Product = Callable[..., Any]


@cache
def column_products(width: int) -> tuple[Product, Product]:
    """Return the compiled products Pᵀ r and x + P y for a block size (0 for any).

    ``restricted(indptr, indices, blocks, r, columns)``
        Pᵀ r ``(columns,)``. Block k, ``blocks[k] (n,)``, is in column ``indices[k]``.
    ``prolonged(indptr, indices, blocks, x, y)``
        x + P y, as a new array.
    """

    @kernel(reorder_sums=True)
    def restricted(indptr, indices, blocks, r, columns):
        n = width if width > 0 else blocks.shape[1]
        result = np.zeros(columns, r.dtype)
        # Add the product of each block with its part of r to its column.
        for i in range(len(indptr) - 1):
            start = i * n
            for k in range(indptr[i], indptr[i + 1]):
                t = result[np.uint32(indices[k])]
                for q in range(n):
                    t += blocks[k, q] * r[start + q]
                result[np.uint32(indices[k])] = t
        return result

    @kernel(reorder_sums=True)
    def prolonged(indptr, indices, blocks, x, y):
        n = width if width > 0 else blocks.shape[1]
        result, row = np.empty_like(x), np.empty(n, x.dtype)
        for i in range(len(indptr) - 1):
            # Sum the rows of a part in ``row`` before writing.
            start = i * n
            for q in range(n):
                row[q] = x[start + q]
            for k in range(indptr[i], indptr[i + 1]):
                t = y[np.uint32(indices[k])]
                for q in range(n):
                    row[q] += blocks[k, q] * t
            for q in range(n):
                result[start + q] = row[q]
        return result

    return restricted, prolonged
