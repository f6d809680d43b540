"""Coarse matrices of scalar levels."""

from __future__ import annotations

from typing import Any

from scipy import sparse

from agglo_core.arrays import frozen
from agglo_core.kernels.galerkin_product import galerkin_product

__all__ = ["csr_galerkin"]


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
