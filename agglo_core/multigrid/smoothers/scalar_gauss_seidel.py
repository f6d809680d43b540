"""Symmetric Gauss–Seidel over single unknowns."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.arrays import frozen
from agglo_core.errors import OptionError
from agglo_core.multigrid.kernels.scalar_sweeps import backward_sweep, first_sweep
from agglo_core.multigrid.stack import Real


class ScalarGaussSeidel:
    """Gauss–Seidel smoother: a forward sweep before the coarse correction, a backward sweep after.

    Parameters
    ----------
    A : (n, n) sparse
        Symmetric matrix with positive diagonal.
    dtype : numpy dtype
        Precision of the sweeps: float32 or float64.

    Attributes
    ----------
    matrix : (n, n) csr_array
        A in this precision, sharing its arrays with the sweeps.

    Raises
    ------
    OptionError
        If a diagonal entry is not positive.

    Examples
    --------
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import ScalarGaussSeidel
    >>> x, r = ScalarGaussSeidel(sparse.csr_array([[2.0, -1.0], [-1.0, 2.0]])).before(np.array([2.0, 0.0]))
    >>> x, r
    (array([1. , 0.5]), array([0.5, 0. ]))
    """

    def __init__(self, A: Any, dtype: Any = np.float64) -> None:
        rows = sparse.csr_array(A)
        if not rows.has_canonical_format:
            rows = rows.copy()
            rows.sum_duplicates()
        diagonal = np.asarray(rows.diagonal(), dtype=np.float64)
        bad = np.flatnonzero(~(diagonal > 0.0))
        if len(bad):
            raise OptionError(
                f"Gauss-Seidel needs a positive diagonal; row {bad[0]} of the matrix has "
                f"{diagonal[bad[0]]:g} ({len(bad)} such rows)"
            )
        self._dtype = np.dtype(dtype)
        indptr, indices = frozen(rows.indptr, rows.indices.dtype), frozen(rows.indices, rows.indices.dtype)
        self._A = (indptr, indices, frozen(rows.data, dtype))
        self.matrix = sparse.csr_array((self._A[2], indices, indptr), shape=rows.shape)
        self._inverse = frozen(1.0 / diagonal, dtype)

    def before(self, b: Real) -> tuple[Real, Real]:
        """Return x ``(n,)`` after a forward sweep from 0, and the residual b − A x."""
        x, r = first_sweep(*self._A, self._inverse, frozen(b, self._dtype))
        return x, r

    def after(self, b: Real, x: Real) -> Real:
        """Return x after a backward sweep. The given array is modified."""
        x = np.ascontiguousarray(x, dtype=self._dtype)
        backward_sweep(*self._A, self._inverse, frozen(b, self._dtype), x)
        return x
