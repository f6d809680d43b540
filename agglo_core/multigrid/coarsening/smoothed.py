"""Smoothed agglomeration: prolongations smoothed by a damped Jacobi step, for Galerkin operators.

P. Vaněk, J. Mandel, M. Brezina, "Algebraic multigrid by smoothed aggregation for second and fourth order
elliptic problems", Computing 56 (1996), with blocks instead of scalars. An injected prolongation of
discontinuous polynomials jumps between agglomerates. With the penalty of the fine level, these jumps are far
too stiff on the coarse level. The Jacobi step removes them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.multigrid.matrices.block_matrix import block_inverses
from agglo_core.multigrid.matrices.block_product import fast_product
from agglo_core.multigrid.matrices.galerkin import block_matmat, have_kernels
from agglo_core.multigrid.smoothers.spectrum import largest_eigenvalue


def smoothed_prolongation(
    A: Any, P: Any, damping: float = 4 / 3, *, scaled: bool = False
) -> sparse.bsr_array:
    """Return the prolongation (I − (ω / λ_max) D⁻¹ A) P, with the diagonal blocks D of A.

    Parameters
    ----------
    A : (n, n) bsr
        Symmetric positive definite matrix in square blocks.
    P : (n, m) bsr
        Prolongation in blocks of equal size.
    damping : float
        Damping ω. λ_max is the :func:`~agglo_core.multigrid.largest_eigenvalue` of D⁻¹A.
    scaled : bool
        D is the identity, as after :func:`~agglo_core.multigrid.matrices.block_scaling.block_scaled`.

    Raises
    ------
    LinAlgError
        If a diagonal block, or A, is not positive definite.

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
    step = block_matmat(A, P) if have_kernels(A, P) else A @ P
    if scaled:
        largest = largest_eigenvalue(fast_product(A), lambda r: r)
    else:
        inverses = block_inverses(A, np.arange(0, A.shape[0] + 1, A.blocksize[0]))
        largest = largest_eigenvalue(A, lambda r: np.asarray(inverses @ r))
        step = inverses @ step
    smoothed = sparse.bsr_array(P - (damping / largest) * step)
    smoothed.sort_indices()
    return smoothed
