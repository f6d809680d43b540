"""Largest eigenvalue of a preconditioned matrix, by Lanczos steps."""

from __future__ import annotations

from typing import Any

import numpy as np

from agglo_core.multigrid.krylov.lanczos import ritz_value
from agglo_core.multigrid.stack import Solve

_STEPS = 12  # default number of Lanczos steps; more: sharper, slower set-up (benchmarks/solid_ratios.py)


def largest_eigenvalue(A: Any, precondition: Solve, steps: int = _STEPS) -> float:
    """Estimate the largest eigenvalue of M⁻¹A slightly from below, by Lanczos steps from a fixed vector.

    Parameters
    ----------
    A : (n, n) sparse
        Symmetric positive definite matrix.
    precondition : callable
        Applies M⁻¹, symmetric positive definite.
    steps : int
        Number of matrix-vector products.

    Raises
    ------
    LinAlgError
        If A or M is found not to be positive definite.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.csr_array(2.0 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    >>> from agglo_core.multigrid import largest_eigenvalue
    >>> round(largest_eigenvalue(A, lambda r: r / 2.0), 4), round(float(1 + np.cos(np.pi / 7)), 4)
    (1.901, 1.901)
    """
    r = np.random.default_rng(0).standard_normal(A.shape[0]).astype(A.dtype)
    # Coefficients of conjugate gradients, as in the Lanczos process.
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
        if falls[-1] < 1e-20:  # the Krylov space is exhausted
            break
        p = z + falls[-1] * p
    return ritz_value(lengths, falls[: len(lengths) - 1], largest=True)
