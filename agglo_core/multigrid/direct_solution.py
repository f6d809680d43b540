"""Direct solution on the coarsest level and on subdomains, for singular matrices too."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from agglo_core.arrays import Float
from agglo_core.errors import OptionError
from agglo_core.multigrid.stack import Real, Solve

__all__ = ["direct_solver"]

_ROUNDING = 3e-15
"""Eigenvalues of a matrix of unit diagonal below this, times its size, are those of its null space."""
_SHIFT = 1e-11
"""Added to the unit diagonal of a singular matrix that is too large for an inverse."""


def direct_solver(A: Any, dtype: Any = np.float64, dense: int = 1500) -> Solve:
    """Return a function that solves A x = b for a symmetric matrix without negative eigenvalues.

    Up to ``dense`` unknowns by an inverse, larger matrices by a sparse factorisation. For a singular matrix,
    such as that of a problem with Neumann boundary alone, b must be in its range; the solution is then one of
    many.

    Parameters
    ----------
    A : (n, n) sparse
    dtype : numpy dtype
        Of the solutions; the inverse is computed in double precision.
    dense : int

    Raises
    ------
    OptionError
        If the matrix is not finite or has a negative diagonal entry.

    Examples
    --------
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import direct_solver
    >>> x = direct_solver(sparse.csr_array([[1.0, -1.0], [-1.0, 1.0]]))(np.array([1.0, -1.0]))
    >>> float(round(x[0] - x[1], 12))
    1.0
    """
    rows = sparse.csr_array(A)
    diagonal = np.asarray(rows.diagonal(), dtype=np.float64)
    if not np.isfinite(rows.data).all():
        raise OptionError(
            f"the matrix to be factorised ({rows.shape[0]} rows) has entries that are not finite"
        )
    if (diagonal < 0.0).any():
        row = int(np.argmin(diagonal))
        raise OptionError(f"the matrix to be factorised has {diagonal[row]:g} on its diagonal, in row {row}")
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    if rows.shape[0] <= dense:
        inverse = np.asarray(
            scale[:, None] * _inverse(rows.toarray() * np.outer(scale, scale)) * scale, dtype
        )
        return lambda b: inverse @ b
    return _sparse_solver(rows, scale, dtype)


def _inverse(M: Float) -> Float:
    """The inverse of M, of unit diagonal; its pseudo-inverse where it is singular."""
    n = len(M)
    M = 0.5 * (M + M.T)
    least = _ROUNDING * n
    try:
        factor = linalg.cho_factor(M, lower=True)
    except linalg.LinAlgError:
        factor = None
    if factor is not None and (np.diagonal(factor[0]) ** 2).min(initial=1.0) > least:
        inverse = np.asarray(linalg.cho_solve(factor, np.eye(n)))
        return np.asarray(0.5 * (inverse + inverse.T))
    values, vectors = linalg.eigh(M)
    large = values > least
    return np.asarray((vectors[:, large] / values[large]) @ vectors[:, large].T)


def _sparse_solver(A: Any, scale: Float, dtype: Any) -> Solve:
    """A factorisation of A; if it is singular, of A shifted by a little, with refinement."""
    D = sparse.diags_array(scale)
    M = sparse.csc_array(D @ A @ D)
    factors = _factors(M)
    regular = factors is not None and np.abs(factors.U.diagonal()).min() > _ROUNDING * M.shape[0]
    if not regular:
        factors = _factors(sparse.csc_array(M + _SHIFT * sparse.eye_array(M.shape[0])))

    def solve(b: Real) -> Real:
        r = scale * np.asarray(b, np.float64)
        x = factors.solve(r)
        for _ in range(0 if regular else 2):  # polynomials in the matrix: symmetric still
            x = x + factors.solve(r - M @ x)
        return np.asarray(scale * x, dtype)

    return solve


def _factors(M: Any) -> Any:
    """A sparse LU factorisation that keeps the diagonal as pivots, None if a pivot is zero."""
    try:
        return splu(M, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError as error:  # SuperLU's word for a zero pivot
        if "singular" not in str(error):
            raise
        return None
