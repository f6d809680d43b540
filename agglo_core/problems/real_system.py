"""Linear systems as methods for real symmetric matrices take them."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, frozen_float
from agglo_core.errors import OptionError
from agglo_core.problems.linear import Linear

__all__ = ["symmetric_system"]

_ASYMMETRY = 1e-10


def symmetric_system(problem: Linear) -> tuple[sparse.csr_array, Float]:
    """Matrix ``(n, n)`` and right-hand side ``(n,)`` of a linear problem as real numbers.

    Raises
    ------
    OptionError
        For a matrix without entries (a LinearOperator), one that is not square or not symmetric; several
        right-hand sides, or a sparse one; complex numbers, values that are not numbers or not finite; shapes
        that do not fit.
    """
    b, A = _vector(problem.b), _matrix(problem.A)
    unknowns = int(problem.block_offsets[-1])
    if A.shape != (unknowns, unknowns) or b.shape != (unknowns,):
        raise OptionError(
            f"A has the shape {A.shape} and b {b.shape}; block_offsets are for {unknowns} unknowns"
        )
    if not (np.isfinite(b).all() and np.isfinite(A.data).all()):
        raise OptionError("matrix or right-hand side hold values that are not finite")
    _require_symmetric(A)
    return A, b


def _vector(given: Any) -> Float:
    if sparse.issparse(given):
        raise OptionError(f"b must be an array (n,), given a sparse one {given.shape}: b.toarray().ravel()")
    b = _real("b", given)
    if b.ndim == 2:
        raise OptionError(
            f"b must be one right-hand side (n,), given the shape {b.shape}: solve for one column at a time"
        )
    return frozen_float(b)


def _matrix(given: Any) -> sparse.csr_array:
    if not sparse.issparse(given) and (hasattr(given, "matvec") or np.ndim(given) != 2):
        raise OptionError(
            f"A must be a sparse or dense matrix with entries, given {type(given).__name__}: multigrid "
            "makes coarse matrices of them"
        )
    if not sparse.issparse(given):
        given = _real("A", given)
    elif given.dtype.kind not in "biuf":
        raise OptionError(f"A holds {given.dtype}; expected real numbers")
    return sparse.csr_array(given).astype(np.float64)


def _real(name: str, given: Any) -> Float:
    """An array of numbers; those in an array of objects may be any that Python counts as real."""
    try:
        values = np.asarray(given)
        if values.dtype.kind == "O" and not np.iscomplexobj(np.array(values.tolist())):
            values = values.astype(np.float64)
    except (TypeError, ValueError):
        raise OptionError(f"{name} must hold real numbers, given {given!r:.60}") from None
    if values.dtype.kind not in "biuf":
        raise OptionError(f"{name} holds {values.dtype}; expected real numbers")
    return values.astype(np.float64)


def _require_symmetric(A: sparse.csr_array) -> None:
    gap = sparse.coo_array(A - A.T)
    if not gap.nnz:
        return
    worst = int(np.argmax(np.abs(gap.data)))
    if np.abs(gap.data[worst]) > _ASYMMETRY * np.abs(A.data).max():
        i, j = (int(each[worst]) for each in gap.coords)
        raise OptionError(
            f"A must be symmetric: the entry ({i}, {j}) is {A[i, j]:g}, ({j}, {i}) is {A[j, i]:g}"
        )
