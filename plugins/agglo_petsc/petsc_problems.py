"""Linear problems of a matrix that PETSc has."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.authoring import Linear, OptionError, frozen_float, frozen_int
from agglo_petsc.matrices import entries, to_scipy


def linear(
    mat: Any, rhs: Any, *, block_offsets: ArrayLike | None = None, near_null: ArrayLike | None = None
) -> Linear:
    """The problem A x = b of a PETSc matrix and vector, for any of our solvers; on one process.

    Parameters
    ----------
    mat : petsc4py.PETSc.Mat
        Of type ``aij``, ``baij`` or ``sbaij``, or any that converts to ``aij``.
    rhs : petsc4py.PETSc.Vec or (n,) float
    block_offsets : (parts + 1,) int, optional
        The unknowns of part p are ``block_offsets[p]:block_offsets[p + 1]``; by default parts have the block
        size of the matrix.
    near_null : (n, k) float, optional
        By default the near-null space of the matrix (``setNearNullSpace``), if it has one.

    Raises
    ------
    OptionError
        If rows are divided among ranks, entries cannot be had, or shapes do not fit.
    """
    A = to_scipy(mat)
    n, size = A.shape[0], int(mat.getBlockSize())
    offsets = np.arange(0, n + 1, size) if block_offsets is None else np.asarray(block_offsets)
    b = np.asarray(rhs, np.float64) if isinstance(rhs, np.ndarray | list | tuple) else entries(rhs)
    if b.shape != (n,):
        raise OptionError(f"rhs must be ({n},) for that matrix, given {b.shape}")
    space = mat.getNearNullSpace()
    if near_null is None and space:
        columns = [np.ones(n)] if space.hasConstant() else []
        columns += [np.array(each.getArray(readonly=True)) for each in space.getVecs()]
        near_null = np.stack(columns, axis=1) if columns else None
    B = None if near_null is None else frozen_float(np.asarray(near_null, np.float64))
    return Linear(A, frozen_float(b), frozen_int(offsets), B)
