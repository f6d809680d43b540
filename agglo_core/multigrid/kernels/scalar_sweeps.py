"""Gauss–Seidel sweeps over the rows of a symmetric CSR matrix, forward from zero and backward.

Indices are unsigned, because signed indices cost a test for negative values.
"""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import kernel


@kernel
def first_sweep(indptr, indices, data, inverse, b):
    """Return x = (D + L)⁻¹ b, a forward sweep from zero, and the residual b − A x.

    ``inverse`` is the reciprocal diagonal. Row i is used as column i: as soon as x_i is known, the residuals
    of the neighbours are updated, so that each entry of A is read once.
    """
    n = len(indptr) - 1
    x = np.empty_like(b)
    r = b.copy()
    for i in range(n):
        t = r[i] * inverse[i]
        x[i] = t
        for k in range(np.uint64(indptr[i]), np.uint64(indptr[i + 1])):
            r[np.uint64(indices[k])] -= data[k] * t
        r[i] = 0  # zero except for rounding
    return x, r


@kernel(reorder_sums=True)
def backward_sweep(indptr, indices, data, inverse, b, x):
    """Update x by one backward Gauss–Seidel sweep for A x = b.

    ``inverse`` is the reciprocal diagonal.
    """
    for i in range(len(indptr) - 2, -1, -1):
        # x_i += (b_i − Σ_j a_ij x_j) / a_ii.
        s = b[i]
        for k in range(np.uint64(indptr[i]), np.uint64(indptr[i + 1])):
            s -= data[k] * x[np.uint64(indices[k])]
        x[i] += s * inverse[i]
