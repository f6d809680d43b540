"""Arrays and matrices of real numbers, whatever is given."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float
from agglo_core.errors import OptionError

__all__ = ["real_array", "real_matrix", "require_finite", "require_symmetric"]

_ASYMMETRY = 1e-10


def real_matrix(given: Any) -> Any:
    """A matrix as float64, in CSR or, if it is given so, in BSR.

    Raises
    ------
    OptionError
        For a matrix without entries (a LinearOperator), and one that does not hold real numbers.
    """
    if not sparse.issparse(given) and (hasattr(given, "matvec") or np.ndim(given) != 2):
        raise OptionError(
            f"A must be a sparse or dense matrix with entries, given {type(given).__name__}: multigrid "
            "makes coarse matrices of them"
        )
    if not sparse.issparse(given):
        given = real_array("A", given)
    elif given.dtype.kind not in "biuf":
        raise OptionError(f"A holds {given.dtype}; expected real numbers")
    kept = given if sparse.issparse(given) and given.format in ("csr", "bsr") else sparse.csr_array(given)
    return kept.astype(np.float64, copy=False)


def real_array(name: str, given: Any) -> Float:
    """An array of float64; numbers in an array of objects may be any that Python counts as real.

    Raises
    ------
    OptionError
        For complex numbers, text, and what is no array.
    """
    try:
        values = np.asarray(given)
        if values.dtype.kind == "O" and not np.iscomplexobj(np.array(values.tolist())):
            values = values.astype(np.float64)
    except (TypeError, ValueError):
        raise OptionError(f"{name} must hold real numbers, given {given!r:.60}") from None
    if values.dtype.kind not in "biuf":
        raise OptionError(f"{name} holds {values.dtype}; expected real numbers")
    return values.astype(np.float64)


def require_finite(b: Float, A: Any) -> None:
    """Raise OptionError unless right-hand side and matrix are finite."""
    if not (np.isfinite(b).all() and np.isfinite(A.data).all()):
        raise OptionError("matrix or right-hand side hold values that are not finite")


def require_symmetric(A: Any) -> None:
    """Raise OptionError, naming an entry, unless a matrix is symmetric but for rounding."""
    gap = sparse.coo_array(A - A.T)
    if not gap.nnz:
        return
    worst = int(np.argmax(np.abs(gap.data)))
    if np.abs(gap.data[worst]) > _ASYMMETRY * np.abs(A.data).max():
        i, j = (int(each[worst]) for each in gap.coords)
        raise OptionError(
            f"A must be symmetric: the entry ({i}, {j}) is {_entry(A, i, j)}, ({j}, {i}) is {_entry(A, j, i)}"
        )


def _entry(A: Any, i: int, j: int) -> str:
    return f"{sparse.csr_array(A)[i, j]:g}"
