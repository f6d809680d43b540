"""Checks of user matrices, and conversion to the storage format of the kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from agglo_core.arrays import Float, Int, exact_cast, frozen, frozen_float, frozen_int, plain_array
from agglo_core.errors import OptionError
from agglo_core.problems.real_arrays import offsets_of_blocks, real_matrix


def canonical(A: Any) -> Any:
    """Return a CSR matrix in double precision, with sorted columns and read-only arrays."""
    rows = sparse.csr_array(A, dtype=np.float64)
    if not rows.has_canonical_format:
        rows = rows.copy()  # the arrays of A are shared
        rows.sum_duplicates()
    if rows.indices.dtype != np.int32 and rows.nnz < 2**31:
        rows.indices, rows.indptr = rows.indices.astype(np.int32), rows.indptr.astype(np.int32)
    parts = (frozen(rows.data, rows.data.dtype), *(frozen(a, a.dtype) for a in (rows.indices, rows.indptr)))
    rows.data, rows.indices, rows.indptr = parts
    return rows


def check_system(
    A: Any, block_offsets: ArrayLike | int | None, near_null: ArrayLike | None
) -> tuple[Any, Int, Float]:
    """Return matrix, block offsets and near-null vectors after a check, or raise OptionError."""
    # Matrix: finite, with positive diagonal.
    if not sparse.issparse(A) or A.shape[0] != A.shape[1] or np.iscomplexobj(A):
        raise OptionError(
            f"expected a real square sparse matrix; given {type(A).__name__} {getattr(A, 'shape', '')} "
            f"of {getattr(A, 'dtype', 'unknown type')}"
        )
    matrix, n = canonical(real_matrix(A)), A.shape[0]
    if not np.isfinite(matrix.data).all():
        raise OptionError("the matrix has entries that are not finite")
    diagonal = matrix.diagonal()
    if not (diagonal > 0.0).all():
        row = int(np.argmin(diagonal))
        raise OptionError(f"the diagonal of the matrix must be positive; row {row} has {diagonal[row]:g}")
    # Block offsets: increasing from 0 to n.
    array = plain_array(offsets_of_blocks(block_offsets, A), "block_offsets", OptionError)
    offsets = frozen_int(exact_cast(array, np.int64, "block_offsets", OptionError))
    if offsets.ndim != 1 or offsets[0] != 0 or offsets[-1] != n or (np.diff(offsets) < 1).any():
        raise OptionError(f"block_offsets must increase from 0 to {n}, the number of rows of the matrix")
    # Near-null vectors: by default a constant per component.
    if near_null is None:
        component = np.arange(n) - np.repeat(offsets[:-1], np.diff(offsets))
        near_null = component[:, None] == np.arange(np.diff(offsets).max(initial=1))
    array = plain_array(near_null, "near_null", OptionError)
    B = exact_cast(array, np.float64, "near_null", OptionError)
    B = B[:, None] if B.ndim == 1 else B
    if B.ndim != 2 or len(B) != n or not B.shape[1] or not np.isfinite(B).all():
        raise OptionError(f"near_null must be finite, of shape ({n}, k); given shape {np.shape(near_null)}")
    return matrix, offsets, frozen_float(B)
