"""Smoothing of distributed prolongations by a block Jacobi step."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import Int, OptionError, frozen_float, multigrid
from agglo_petsc.matrices import mat_from_rows, petsc, rows_of, vector
from agglo_petsc.messages import agree

_STEPS = 12
"""Number of conjugate gradient steps for the largest eigenvalue. Fewer underestimate it, so that the Jacobi
step is too long; more lengthen the set-up (benchmarks/petsc.py)."""


def own_columns(comm: Any, own: Any, widths: tuple[int, int]) -> Any:
    """Return the block diagonal matrix whose diagonal block on each rank is ``own (n_own, m_own)``."""
    counts = comm.tompi4py().allgather(own.shape[1])
    first, total = sum(counts[: comm.getRank()]), sum(counts)
    rows = sparse.csr_array((own.data, own.indices + first, own.indptr), shape=(own.shape[0], total))
    return mat_from_rows(rows, comm, own.shape[1], widths)


def jacobi_smoothed(A: Any, offsets: Int, T: Any, damping: float) -> Any:
    """Return the smoothed prolongation (I − (ω / λ_max) D⁻¹ A) T, with the block diagonal D of A."""
    PETSc = petsc()
    inverse = _inverse_blocks(A, offsets)
    AT = A.matMult(T)
    P = inverse.matMult(AT)
    P.scale(-damping / _largest_eigenvalue(A, inverse))
    P.axpy(1.0, T, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    P.setBlockSizes(*T.getBlockSizes())
    for each in (AT, inverse, T):
        each.destroy()
    return P


def _inverse_blocks(A: Any, offsets: Int) -> Any:
    """Return the inverse of the block diagonal of A as a distributed PETSc matrix."""
    comm, diagonal_block = A.getComm(), rows_of(A.getDiagonalBlock())
    wrong, inverse = "", diagonal_block
    try:
        if diagonal_block.shape[0]:
            inverse = sparse.csr_array(multigrid.block_inverses(diagonal_block, offsets))
    except np.linalg.LinAlgError as error:
        wrong = str(error)
    agree(comm, wrong)
    return own_columns(comm, inverse, (1, 1))


def _largest_eigenvalue(A: Any, inverse: Any) -> float:
    """Estimate the largest eigenvalue of D⁻¹A, slightly too low.

    Uses conjugate gradients from a start vector that depends only on row numbers.
    """
    PETSc = petsc()
    # 1. Conjugate gradients with eigenvalue estimates
    ksp = PETSc.KSP().create(A.getComm())
    ksp.setOperators(A, inverse)
    ksp.setType("cg")
    ksp.getPC().setType("mat")
    ksp.setNormType(PETSc.KSP.NormType.NONE)
    ksp.setTolerances(max_it=min(_STEPS, A.getSize()[0]))  # more steps than unknowns break down
    ksp.setComputeEigenvalues(True)
    # 2. Start vector
    rows = np.arange(*A.getOwnershipRange())
    b = vector(A, frozen_float(np.sin(1.0 + 12.9898 * rows) * (1.0 + rows % 3)))
    x = b.duplicate()
    ksp.solve(b, x)
    # 3. Largest Ritz value
    ritz_values, reason = ksp.computeEigenvalues(), ksp.getConvergedReason()
    for handle in (ksp, b, x):
        handle.destroy()
    largest = float(np.real(ritz_values).max(initial=0.0))
    indefinite = PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT
    if reason in (indefinite, PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_PC) or not 0.0 < largest < np.inf:
        raise OptionError("the matrix is not positive definite: the prolongation cannot be smoothed")
    return largest
