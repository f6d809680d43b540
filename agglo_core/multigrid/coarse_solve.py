"""Direct solvers for the coarsest level and subdomains, by inverses or sparse factorisations."""

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
from agglo_core.threads import one_blas_thread

_MOST = 5_000  # maximum unknowns of a dense inverse: 200 MB, about 20 seconds
_ROUNDING = 3e-15
"""Null-space bound: eigenvalues below this times n, for a matrix of size n with unit diagonal."""
_SHIFT = 1e-11
"""Shift of the unit diagonal for singular matrices too large for an inverse. Two refinements correct it.
Benchmark: benchmarks/constants.py."""


def direct_solver(A: Any, dtype: Any = np.float64, dense: int = 1500) -> Solve:
    """Return a function that solves A x = b for a symmetric matrix without negative eigenvalues.

    Matrices with up to ``dense`` unknowns are inverted, larger matrices use a sparse factorisation. For a
    singular matrix, as for pure Neumann problems, b must be in the range of A, and the solution is not
    unique.

    Parameters
    ----------
    A : (n, n) sparse
    dtype : numpy dtype
        Solution type. Matrices are factorised in double precision.
    dense : int

    Raises
    ------
    LinAlgError
        If the matrix is not finite or has a negative diagonal entry, or, for up to ``dense`` unknowns,
        any negative eigenvalue.

    Examples
    --------
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import direct_solver
    >>> x = direct_solver(sparse.csr_array([[1.0, -1.0], [-1.0, 1.0]]))(np.array([1.0, -1.0]))
    >>> float(round(x[0] - x[1], 12))
    1.0
    """
    if A.shape[0] <= dense:
        return dense_solve(A, dtype)
    rows = sparse.csr_array(A, dtype=np.float64)
    scale = _to_unit_diagonal(rows)
    D = sparse.diags_array(scale)
    return _ScaledFactors(sparse.csc_array(D @ rows @ D), scale, dtype)


class _ByInverse:
    """Solver that multiplies the right-hand side by a stored inverse, row by row in one thread.

    The threads of a BLAS product wait for each other on a busy machine: with 16 threads on two cores, 1,500
    unknowns took up to 13 times the CPU time (benchmarks/coarse_solve.py).
    """

    def __init__(self, inverse: Real) -> None:
        self.inverse = np.ascontiguousarray(inverse)

    def __call__(self, b: Real) -> Real:
        return np.asarray(np.vecdot(self.inverse, b) if np.ndim(b) == 1 else self.inverse @ b)


class _ByFactors:
    """Solver by stored sparse factors, which are recomputed after unpickling.

    SuperLU objects cannot be pickled.
    """

    def __init__(self, M: Any, dtype: Any) -> None:
        self.M, self.dtype = M, dtype
        self.factors = self._factorised()

    def _factorised(self) -> Any:
        factors = symmetric_lu(self.M)
        if factors is None:
            raise np.linalg.LinAlgError(f"a coarse matrix of {self.M.shape[0]} unknowns is singular")
        return factors

    def __call__(self, b: Real) -> Real:
        return np.asarray(self.factors.solve(np.asarray(b, np.float64))).astype(self.dtype)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"factors": None}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        self.__dict__.update(state)
        self.factors = self._factorised()


class _ScaledFactors(_ByFactors):
    """Solver by sparse factors of the matrix scaled to unit diagonal, and shifted by 1e-11 if singular."""

    def __init__(self, M: Any, scale: Float, dtype: Any) -> None:
        self.scale, self.regular = scale, True
        super().__init__(M, dtype)

    def _factorised(self) -> Any:
        M = self.M
        factors = symmetric_lu(M)
        self.regular = factors is not None and np.abs(factors.U.diagonal()).min() > _ROUNDING * M.shape[0]
        if not self.regular:
            factors = symmetric_lu(sparse.csc_array(M + _SHIFT * sparse.eye_array(M.shape[0])))
        if factors is None:
            raise np.linalg.LinAlgError(f"the matrix to be factorised ({M.shape[0]} rows) is singular")
        return factors

    def __call__(self, b: Real) -> Real:
        r = self.scale * np.asarray(b, np.float64)
        x = self.factors.solve(r)
        for _ in range(0 if self.regular else 2):  # polynomials in the matrix, hence still symmetric
            x = x + self.factors.solve(r - self.M @ x)
        return np.asarray(self.scale * x, self.dtype)


def dense_solve(A: Any, dtype: Any = np.float64) -> Solve:
    """Return a function that multiplies by the inverse, from a dense Cholesky factorisation.

    Suitable for up to about 1,500 unknowns.

    The matrix is first scaled to unit diagonal. For a matrix semidefinite to rounding, with an inverse of
    trace above 1 / (n · 3e-15), the pseudo-inverse of the scaled matrix is used: eigenvalues below n · 3e-15
    times the largest count as 0, and components of the right-hand side along their eigenvectors are removed.

    Raises
    ------
    OptionError
        For more than 5,000 unknowns.
    LinAlgError
        If the matrix has a negative eigenvalue, or entries that are not finite.
    """
    n = A.shape[0]
    if n > _MOST:
        raise OptionError(
            f"dense: {n} unknowns are too many for a dense inverse (at most {_MOST}); use coarse=lu"
        )
    rows = sparse.csr_array(A, dtype=np.float64)
    scale = _to_unit_diagonal(rows)
    unit = scale[:, None] * rows.toarray() * scale
    with one_blas_thread():
        inverse = _inverse(0.5 * (unit + unit.T))
    return _ByInverse((scale[:, None] * inverse * scale).astype(dtype))


def _to_unit_diagonal(A: Any) -> Float:
    """Return factors ``(n,)`` for rows and columns that scale a matrix diagonal to 1."""
    n, diagonal = A.shape[0], A.diagonal()
    if not np.isfinite(A.data).all():
        raise np.linalg.LinAlgError(f"the matrix to be factorised ({n} rows) has entries that are not finite")
    if (diagonal < 0.0).any():
        row = int(np.argmin(diagonal))
        raise np.linalg.LinAlgError(
            f"the matrix to be factorised has a negative diagonal entry: {diagonal[row]:g} in row {row}"
        )
    return np.asarray(1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)))


def _inverse(A: Float) -> Float:
    """Return the inverse of a matrix with unit diagonal, or the pseudo-inverse if it is nearly singular."""
    least = len(A) * _ROUNDING
    factor, info = dpotrf(A, lower=1)
    if not info:
        half, info = dpotri(factor, lower=1)
        if not info and half.trace() * least < 1.0:  # pivots alone do not reveal small eigenvalues
            return np.asarray(np.tril(half) + np.tril(half, -1).T)
    values, vectors = np.linalg.eigh(A)
    if values[0] < -least * max(values[-1], 1.0):
        raise np.linalg.LinAlgError(
            f"the matrix to be factorised is not positive semidefinite: scaled to a unit diagonal it has the "
            f"eigenvalue {values[0]:.1e}"
        )
    nonzero = values > least * values[-1]
    return np.asarray((vectors[:, nonzero] / values[nonzero]) @ vectors[:, nonzero].T)


def lu_solve(A: Any, dtype: Any = np.float64) -> Solve:
    """Return a function that solves A x = b by sparse LU factors in double precision (SuperLU).

    Right-hand sides may be in single precision.

    Raises
    ------
    LinAlgError
        If the matrix is singular.
    """
    return _ByFactors(sparse.csc_array(A, dtype=np.float64), dtype)


def symmetric_lu(M: Any, pivots: float = 0.0) -> Any:
    """Return the SuperLU factors of a symmetric ``(n, n)`` csc matrix, or None for a zero pivot.

    ``solve`` of the factors accepts ``(n,)`` or ``(n, k)``. Pivots are diagonal entries unless below
    ``pivots`` times the largest entry in the column.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.csr_array(2.0 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    >>> from agglo_core.multigrid import symmetric_lu
    >>> x = symmetric_lu(A.tocsc()).solve(np.ones(6))
    >>> bool(np.allclose(A @ x, 1.0))
    True
    """
    try:
        return splu(M, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=pivots, options={"SymmetricMode": True})
    except RuntimeError as error:  # raised by SuperLU for a zero pivot
        if "singular" not in str(error):
            raise
        return None


class Elimination:
    """Direct solver by an inverse for up to 1,500 unknowns, else by factorisation: :func:`direct_solver`."""

    def solver_for(self, A: Any) -> Solve:
        """Return a function that solves A x = b.

        Exceptions are those of :func:`direct_solver`.
        """
        return direct_solver(A)


class Dense:
    """Direct solver by a dense inverse: :func:`dense_solve`."""

    def solver_for(self, A: Any) -> Solve:
        """Return a function that solves A x = b.

        Exceptions are those of :func:`dense_solve`.
        """
        return dense_solve(A)


class SparseLU:
    """Direct solver by a sparse LU factorisation of SuperLU: :func:`lu_solve`."""

    def solver_for(self, A: Any) -> Solve:
        """Return a function that solves A x = b.

        Exceptions are those of :func:`lu_solve`.
        """
        return lu_solve(A)


COARSE_SOLVERS: Final[Mapping[str, Callable[[Any, Any], Solve]]] = {
    "dense": dense_solve,
    "elimination": direct_solver,
    "lu": lu_solve,
}
"""Coarsest-level solvers by name, as functions of matrix and dtype."""


def coarse_solver(given: str | Callable[[Any], Solve], A: Any, dtype: Any = np.float64) -> Solve:
    """Return a solver for the coarsest level, for vectors of the precision ``dtype``.

    Parameters
    ----------
    given : "dense", "elimination", "lu" or callable
        A function that returns a solver in double precision for a matrix, or a name.
    A : (n, n) sparse
        Symmetric positive definite matrix.
    dtype : float32 or float64

    Raises
    ------
    OptionError
        For another name, or a function that does not return a function.
    LinAlgError
        If the matrix cannot be factorised.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.csr_array(2.0 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    >>> from agglo_core.multigrid import coarse_solver
    >>> solve = coarse_solver("dense", A)
    >>> bool(np.allclose(A @ solve(np.ones(6)), 1.0))
    True
    """
    if isinstance(given, str) and given in COARSE_SOLVERS:
        return COARSE_SOLVERS[given](A, dtype)
    if not callable(given):
        known = ", ".join(COARSE_SOLVERS)
        raise OptionError(f"coarse must be one of {known}, or a function of the matrix; given {given!r:.60}")
    solve = given(A)
    if not callable(solve):
        raise OptionError(f"coarse: the function returned {solve!r:.60}, expected a function of b")
    return _InDouble(solve, dtype)


class _InDouble:
    """Solver in double precision, called with vectors of another precision."""

    def __init__(self, solve: Solve, dtype: Any) -> None:
        self.solve, self.dtype = solve, dtype

    def __call__(self, b: Real) -> Real:
        return np.asarray(self.solve(np.asarray(b, np.float64))).astype(self.dtype)
