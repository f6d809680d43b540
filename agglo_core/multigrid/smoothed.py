"""Smoothed agglomeration: prolongations that a damped Jacobi step has smoothed, and Galerkin operators.

P. Vaněk, J. Mandel, M. Brezina, "Algebraic multigrid by smoothed aggregation for second and fourth order
elliptic problems", Computing 56 (1996), with blocks in place of scalars. An injected prolongation of
discontinuous polynomials jumps between agglomerates, and the penalty of the fine level makes these jumps
far too stiff for the coarse one; the step takes them out.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import eigvalsh_tridiagonal

from agglo_core.arrays import Float
from agglo_core.multigrid.stack import Solve

__all__ = ["galerkin", "inverse_diagonal", "largest_eigenvalue", "smoothed_prolongation"]

_STEPS = 12


def smoothed_prolongation(
    A: Any, P: Any, damping: float = 4 / 3, *, scaled: bool = False
) -> sparse.bsr_array:
    """Prolongation (I − (ω / λ_max) D⁻¹ A) P, D being the diagonal blocks of A.

    Parameters
    ----------
    A : (n, n) bsr
        Symmetric and positive definite, in square blocks.
    P : (n, m) bsr
        In blocks of the same size.
    damping : float
        ω; λ_max is the :func:`largest_eigenvalue` of D⁻¹A.
    scaled : bool
        Whether D is the identity, as :func:`~agglo_core.multigrid.block_scaling.block_scaled` makes it.

    Raises
    ------
    LinAlgError
        If a diagonal block is singular or A not positive definite.

    Examples
    --------
    Constants of pairs on a path become piecewise linear inside:

    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(6, 6)).tobsr((1, 1))
    >>> pairs = sparse.csr_array((np.ones(6), (np.arange(6), np.arange(6) // 2))).tobsr((1, 1))
    >>> smoothed_prolongation(A, pairs).toarray()[:, 1].round(2)
    array([0.  , 0.35, 0.65, 0.65, 0.35, 0.  ])
    """
    step = A @ P
    if scaled:
        largest = largest_eigenvalue(A, lambda r: r)
    else:
        inverses = inverse_diagonal(A)
        largest = largest_eigenvalue(A, lambda r: np.asarray(inverses @ r))
        step = inverses @ step
    smoothed = sparse.bsr_array(P - (damping / largest) * step)
    smoothed.sort_indices()
    return smoothed


def galerkin(A: Any, P: Any) -> sparse.bsr_array:
    """Coarse matrix Pᵀ A P of matrices in blocks."""
    transposed = sparse.bsr_array(P.T)
    coarse = sparse.bsr_array(transposed @ (A @ P))
    coarse.sort_indices()
    return coarse


def inverse_diagonal(A: Any) -> sparse.bsr_array:
    """D⁻¹ as a block diagonal matrix ``(n, n)``, D being the diagonal blocks of a bsr matrix.

    Raises
    ------
    LinAlgError
        If a diagonal block is missing or singular.
    """
    width = A.blocksize[0]
    count = A.shape[0] // width
    rows = np.repeat(np.arange(count), np.diff(A.indptr))
    on = rows == A.indices
    blocks: NDArray[Any] = np.zeros((count, width, width), A.dtype)
    blocks[rows[on]] = A.data[on]
    places = np.arange(count + 1, dtype=np.int32)
    return sparse.bsr_array((np.linalg.inv(blocks), places[:-1], places), shape=A.shape)


def largest_eigenvalue(A: Any, precondition: Solve, steps: int = _STEPS) -> float:
    """Largest eigenvalue of M⁻¹A, a little low: Lanczos from a fixed start, as conjugate gradients run it.

    Parameters
    ----------
    A : (n, n) sparse
        Symmetric and positive definite.
    precondition : callable
        Applies M⁻¹, symmetric and positive definite.
    steps : int
        Matrix-vector products spent.

    Raises
    ------
    LinAlgError
        If A or M turn out not to be positive definite.
    """
    r = np.random.default_rng(0).standard_normal(A.shape[0]).astype(A.dtype)
    z = precondition(r)
    p, rho = z, float(r @ z)
    lengths: list[float] = []
    falls: list[float] = []
    for _ in range(min(steps, A.shape[0])):
        Ap = A @ p
        curvature = float(p @ Ap)
        if not (rho > 0.0 and curvature > 0.0):
            if lengths and rho == 0.0:
                break
            raise np.linalg.LinAlgError("the matrix or its preconditioner is not positive definite")
        lengths.append(rho / curvature)
        r = r - lengths[-1] * Ap
        z = precondition(r)
        before, rho = rho, float(r @ z)
        falls.append(rho / before)
        if falls[-1] < 1e-20:  # all of the start is found
            break
        p = z + falls[-1] * p
    return _largest(np.array(lengths), np.array(falls[: len(lengths) - 1]))


def _largest(lengths: Float, falls: Float) -> float:
    """Largest eigenvalue of the tridiagonal matrix of some iterations."""
    inverse = 1.0 / lengths
    diagonal, beside = inverse.copy(), np.sqrt(falls) * inverse[:-1]
    diagonal[1:] += falls * inverse[:-1]
    top = len(diagonal) - 1
    return float(eigvalsh_tridiagonal(diagonal, beside, select="i", select_range=(top, top))[0])
