"""Products with prolongations in blocks of one column.

Each part of n unknowns depends on a few coarse unknowns, and has n entries for each of them. Such a matrix is
a ``scipy.sparse.bsr_array`` of blocks ``(n, 1)``, which scipy multiplies as if blocks were large. One array
serves both directions: no transpose is kept.
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
    """Kernels ``(restricted, prolonged)`` for blocks of a size, 0 for any size.

    ``restricted(indptr, indices, blocks, r, columns)``
        Pᵀ r ``(columns,)``; block k, ``blocks[k] (n,)``, stands in column ``indices[k]``.
    ``prolonged(indptr, indices, blocks, x, y)``
        x + P y, as a new array.
    """

    @kernel(reorder_sums=True)
    def restricted(indptr, indices, blocks, r, columns):
        n = width if width > 0 else blocks.shape[1]
        found = np.zeros(columns, r.dtype)
        for i in range(len(indptr) - 1):
            own = i * n
            for k in range(indptr[i], indptr[i + 1]):
                t = found[np.uint32(indices[k])]
                for q in range(n):
                    t += blocks[k, q] * r[own + q]
                found[np.uint32(indices[k])] = t
        return found

    @kernel(reorder_sums=True)
    def prolonged(indptr, indices, blocks, x, y):
        n = width if width > 0 else blocks.shape[1]
        found, row = np.empty_like(x), np.empty(n, x.dtype)
        for i in range(len(indptr) - 1):
            # The rows of a part are added up in ``row`` before they are written.
            own = i * n
            for q in range(n):
                row[q] = x[own + q]
            for k in range(indptr[i], indptr[i + 1]):
                t = y[np.uint32(indices[k])]
                for q in range(n):
                    row[q] += blocks[k, q] * t
            for q in range(n):
                found[own + q] = row[q]
        return found

    return restricted, prolonged
