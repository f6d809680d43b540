"""Solvers of the coarsest level, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from scipy import sparse
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.sparse.linalg import splu

from agglo_core.arrays import Float
from agglo_core.errors import OptionError
from agglo_core.multigrid.stack import Real, Solve

__all__ = ["COARSE_SOLVERS", "coarse_solver", "dense_solve", "lu_solve"]

_MOST = 5_000  # unknowns, for a dense inverse: 200 MB and some 20 seconds


def dense_solve(A: Any, dtype: Any = np.float64) -> Solve:
    """Solve by the inverse, from a dense Cholesky factorisation: for up to about 1,500 unknowns.

    The matrix is first scaled to a unit diagonal. If it is semidefinite to rounding, that is if a pivot is
    less than n · 1e-15, the pseudo-inverse of the scaled matrix takes the place of the inverse: eigenvalues
    below n · 1e-15 times the largest count as 0, and a right-hand side loses its part in their eigenvectors.

    Raises
    ------
    OptionError
        For more than 5,000 unknowns.
    LinAlgError
        If the matrix has a negative eigenvalue, or entries that are not finite.
    """
    n = A.shape[0]
    if n > _MOST:
        raise OptionError(f"dense: {n} unknowns are too many for a dense inverse, {_MOST} at most; take lu")
    dense = sparse.csr_array(A).toarray().astype(np.float64)
    diagonal = dense.diagonal()
    if not (np.isfinite(dense).all() and (diagonal >= 0.0).all()):
        raise np.linalg.LinAlgError("the coarsest matrix is not finite, or has negative diagonal entries")
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    inverse = (scale[:, None] * _inverse(scale[:, None] * dense * scale) * scale).astype(dtype)
    return lambda b: np.asarray(inverse @ b)


def _inverse(A: Float) -> Float:
    """Inverse, or pseudo-inverse, of a matrix with a unit diagonal."""
    least = len(A) * 1e-15
    factor, failed = dpotrf(A, lower=1)
    if not failed and factor.diagonal().min(initial=1.0) ** 2 > least:
        half, _ = dpotri(factor, lower=1)
        return np.asarray(np.tril(half) + np.tril(half, -1).T)
    values, vectors = np.linalg.eigh(A)
    if values[0] < -least * max(values[-1], 1.0):
        raise np.linalg.LinAlgError(
            f"the coarsest matrix is not positive semidefinite: scaled to a unit diagonal it has the "
            f"eigenvalue {values[0]:.1e}"
        )
    kept = values > least * values[-1]
    return np.asarray((vectors[:, kept] / values[kept]) @ vectors[:, kept].T)


def lu_solve(A: Any, dtype: Any = np.float64) -> Solve:
    """Solve by a sparse LU factorisation in double precision (SuperLU); right-hand sides may be in single.

    Raises
    ------
    LinAlgError
        If the matrix is singular.
    """
    symmetric = {"SymmetricMode": True}
    try:
        factors = splu(
            sparse.csc_array(A, dtype=np.float64),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options=symmetric,
        )
    except RuntimeError as error:
        raise np.linalg.LinAlgError(f"the coarsest matrix of {A.shape[0]} unknowns is singular") from error

    def solve(b: Real) -> Real:
        return np.asarray(factors.solve(np.asarray(b, np.float64))).astype(dtype)

    return solve


COARSE_SOLVERS: Final[Mapping[str, Callable[[Any, Any], Solve]]] = {"dense": dense_solve, "lu": lu_solve}
"""Solvers of the coarsest level by name: functions of matrix and dtype."""


def coarse_solver(given: str | Callable[[Any], Solve], A: Any, dtype: Any = np.float64) -> Solve:
    """A solver of the coarsest level, in the precision of the stack.

    Parameters
    ----------
    given : "dense", "lu" or callable
        A callable makes a solver of right-hand sides in double precision from the matrix.
    A : (n, n) sparse
        Symmetric positive definite.
    dtype : float32 or float64

    Raises
    ------
    OptionError
        For another name, or a callable that returns no function.
    LinAlgError
        If the matrix cannot be factorised.
    """
    if isinstance(given, str) and given in COARSE_SOLVERS:
        return COARSE_SOLVERS[given](A, dtype)
    if not callable(given):
        known = ", ".join(COARSE_SOLVERS)
        raise OptionError(f"coarse must be one of {known}, or a function of the matrix; given {given!r:.60}")
    solve = given(A)
    if not callable(solve):
        raise OptionError(f"coarse: the function returned {solve!r:.60}, expected a function of b")
    return lambda b: np.asarray(solve(np.asarray(b, np.float64))).astype(dtype)
