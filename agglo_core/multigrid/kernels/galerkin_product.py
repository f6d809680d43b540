"""Galerkin product PᵀAP of CSR matrices."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@kernel
def galerkin_product(indptr, indices, data, graph, to, weight, columns):
    """Return PᵀAP as CSR with sorted columns.

    A ``(n, n)`` is symmetric, given as CSR ``indptr, indices, data``. P ``(n, columns)`` is
    ``graph, to, weight``.
    """
    start, rows, weights = _transpose_csr(graph, to, weight, columns)
    half, half_to, half_values = _product(indptr, indices, data, graph, to, weight, columns)
    out, out_to, values = _product(start, rows, weights, half, half_to, half_values, columns)
    return _transpose_csr(out, out_to, values, columns)  # the matrix itself, with sorted columns


@helper(allocates=True)
def _transpose_csr(indptr, indices, data, columns):
    """Return the transpose as CSR with sorted columns.

    Counting sort by column: rows are taken in order, so they ascend. Arrays may be longer than used.
    """
    n = len(indptr) - 1
    # Count the entries per column.
    start = np.zeros(columns + 1, np.int32)
    for k in range(indptr[n]):
        start[indices[k] + 1] += 1
    for i in range(columns):
        start[i + 1] += start[i]
    fill = start[:-1].copy()
    # Distribute the entries in row order.
    to = np.empty(start[columns], np.int32)
    values = np.empty(start[columns])
    for i in range(n):
        for k in range(indptr[i], indptr[i + 1]):
            m = fill[indices[k]]
            to[m] = i
            values[m] = data[k]
            fill[indices[k]] += 1
    return start, to, values


@helper(allocates=True)
def _product(indptr, indices, data, graph, to, weight, columns):
    """Multiply two CSR matrices row by row (Gustavson's algorithm).

    Columns in a row come in any order, and the arrays are longer than needed. The row is summed in
    ``total``, and ``row_of[j]`` is the last row with column j.
    """
    n = len(indptr) - 1
    product_offsets = np.zeros(n + 1, np.int32)
    size = 2 * len(indices) + columns
    product_columns, values = np.empty(size + 1, np.int32), np.empty(size)
    row_of, total = np.full(columns, -1, np.int32), np.zeros(columns)
    m = 0
    for i in range(n):
        first = m
        # 1. Reserve space for the row. The number of columns is a free bound. Only if this does not fit,
        # count the entries of the rows to be combined. Doubling keeps copies rare.
        if m + columns > size:
            most = 0
            for k in range(indptr[i], indptr[i + 1]):
                most += graph[indices[k] + 1] - graph[indices[k]]
            if m + most > size:
                size = 2 * size + most
                longer_columns, longer_values = np.empty(size + 1, np.int32), np.empty(size)
                for k in range(m):
                    longer_columns[k], longer_values[k] = product_columns[k], values[k]
                product_columns, values = longer_columns, longer_values
        # 2. Combine the rows of the second matrix with the entries in the row of the first. A column is
        # written behind the row, and counted if it is new: without a branch, which would be unpredictable.
        for k in range(np.uint32(indptr[i]), np.uint32(indptr[i + 1])):
            a, h = data[k], np.uint32(indices[k])
            for q in range(np.uint32(graph[h]), np.uint32(graph[h + np.uint32(1)])):
                j = np.uint32(to[q])
                product_columns[m] = j
                m += row_of[j] != i
                row_of[j] = i
                total[j] += a * weight[q]
        # 3. Move the sums to the row.
        for k in range(first, m):
            j = np.uint32(product_columns[k])
            values[k], total[j] = total[j], 0.0
        product_offsets[i + 1] = m
    return product_offsets, product_columns, values
