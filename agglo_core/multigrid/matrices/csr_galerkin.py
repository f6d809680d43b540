"""Coarse matrices of scalar levels."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.arrays import frozen
from agglo_core.multigrid.kernels.galerkin_product import galerkin_product

_SAMPLE = 64
"""Columns of a product that are counted to estimate its entries."""


def csr_galerkin(A: Any, P: Any) -> Any:
    """Pᵀ A P as ``csr_array`` with sorted columns, its arrays read-only.

    Parameters
    ----------
    A : (n, n) csr
        Symmetric, in double precision, its arrays read-only.
    P : (n, m) csr
        In double precision.
    """
    m = P.shape[1]
    indptr, indices, data = galerkin_product(A.indptr, A.indices, A.data, P.indptr, P.indices, P.data, m)
    found = sparse.csr_array((data, indices, indptr), shape=(m, m))
    found.data, found.indices, found.indptr = (frozen(a, a.dtype) for a in (data, indices, indptr))
    found.has_canonical_format = True
    return found


def product_entries(A: Any, P: Any) -> float:
    """Estimate the number of entries of Pᵀ A P from evenly spaced columns of it.

    Parameters
    ----------
    A : (n, n) csr
    P : (n, m) csr
    """
    m = P.shape[1]
    columns = np.unique(np.linspace(0, m - 1, _SAMPLE).astype(np.int64))
    return float((P.T @ (A @ P[:, columns])).nnz * m / len(columns))
