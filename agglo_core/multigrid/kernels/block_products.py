"""Products of sparse matrices with small square blocks, by vector instructions."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from agglo_core.compiled.compiling import kernel
from agglo_core.multigrid.kernels.block_vectors import add_product


@cache
def block_products(width: int) -> Any:
    """Return the compiled product of two sparse matrices with dense blocks of 2 to 16 unknowns.

    The blocks are stored in flat arrays.

    ``product(indptr, indices, places, left, transposed, graph, to, right, columns)``
        Row i of the first matrix has the blocks ``left[places[k]]`` in columns ``indices[k]``, for k from
        ``indptr[i]`` on, transposed if ``transposed`` is 1. Row j of the second matrix has the blocks
        ``right[q]`` in columns ``to[q]``, for q from ``graph[j]`` on. The product has ``columns`` block
        columns. Returns its offsets, columns (in any order) and blocks.
    """

    @kernel(reorder_sums=True)
    def product(indptr, indices, places, left, transposed, graph, to, right, columns):
        n, square = len(indptr) - 1, width * width
        step, stride = (1, width) if transposed else (width, 1)
        # 1. Count the blocks per row, to allocate arrays of final length. ``last[j]`` is the last row with a
        #    block in column j.
        offsets, last = np.zeros(n + 1, np.int32), np.full(columns, -1, np.int64)
        for i in range(n):
            count = 0
            for k in range(indptr[i], indptr[i + 1]):
                for q in range(graph[indices[k]], graph[indices[k] + 1]):
                    if last[to[q]] < i:
                        last[to[q]] = i
                        count += 1
            offsets[i + 1] = offsets[i] + count
        # 2. Sum the products of blocks. Now ``last[j]`` is the position of the last block in column j. Row a
        #    of a product combines the rows of the right block with the coefficients in row a of the left.
        block_columns, values = np.empty(offsets[n], np.int32), np.zeros(offsets[n] * square)
        for c in range(columns):
            last[c] = -1
        m = 0
        for i in range(n):
            for k in range(indptr[i], indptr[i + 1]):
                at = places[k] * square
                for q in range(graph[indices[k]], graph[indices[k] + 1]):
                    j = to[q]
                    if last[j] < offsets[i]:
                        last[j], block_columns[m] = m, j
                        m += 1
                    into = last[j] * square
                    for a in range(width):
                        factors = at + a * step
                        add_product(width, left, factors, stride, right, q * square, values, into + a * width)
        return offsets, block_columns, values

    return product


@kernel
def block_columns(indptr, indices, columns):
    """Transpose a block sparsity pattern by a counting sort, with ascending rows in each column.

    Returns offsets by column, rows, and each block's position in row order.
    """
    starts = np.zeros(columns + 1, np.int32)
    # Count the blocks per column.
    for j in indices:
        starts[j + 1] += 1
    for j in range(columns):
        starts[j + 1] += starts[j]
    free = starts[:columns].copy()
    # Distribute the blocks in row order.
    rows, places = np.empty(len(indices), np.int32), np.empty(len(indices), np.int32)
    for i in range(len(indptr) - 1):
        for k in range(indptr[i], indptr[i + 1]):
            rows[free[indices[k]]], places[free[indices[k]]] = i, k
            free[indices[k]] += 1
    return starts, rows, places
