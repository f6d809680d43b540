"""Conversion of arrays and sparse matrices to real numbers and canonical storage."""

from __future__ import annotations

from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from agglo_core.arrays import Float, plain_array
from agglo_core.errors import OptionError
from agglo_core.problems.residuals.row_scales import row_sizes

_ASYMMETRY = 1e-10  # maximum |a_ij − a_ji| relative to (a_ii a_jj)^½
_COMPRESSED = {"csr": sparse.csr_array, "csc": sparse.csc_array, "bsr": sparse.bsr_array}
_PARTS = ("data", "indices", "indptr")


def real_matrix(given: Any) -> Any:
    """Return a real matrix in float64, in the canonical form of :func:`canonical_matrix`.

    Raises
    ------
    OptionError
        For a matrix without entries (a LinearOperator), values that are not real, or indices that do not
        form a sparse matrix.
    """
    if sparse.issparse(given):
        if given.dtype.kind not in "biuf":
            raise OptionError(f"A holds {given.dtype}; expected real numbers")
        return canonical_matrix(given)
    values = None if hasattr(given, "matvec") else real_array("A", given)
    if values is None or values.ndim != 2:
        raise OptionError(
            f"A must be a sparse or dense matrix, given {type(given).__name__}: multigrid computes coarse "
            "matrices from its entries"
        )
    return canonical_matrix(sparse.csr_array(values))


def canonical_matrix(A: Any) -> Any:
    """Return a sparse matrix in canonical form (CSR or BSR), with protected read-only arrays.

    The format is CSR, or BSR if given as BSR: sorted rows and columns, no duplicates, float64 or complex128.
    Read-only arrays are shared, not copied.

    Raises
    ------
    OptionError
        If indices exceed the shape. scipy does not check indices, and would access foreign memory.
    """
    if A.ndim != 2 or A.dtype.kind not in "biufc":
        raise OptionError(f"A must be a matrix of numbers, given shape {A.shape} of {A.dtype}")
    if A.format not in _COMPRESSED:
        A = _coordinates(A).tocsr()
        for name in _PARTS:  # own arrays need no copy
            _freeze(getattr(A, name))
    input_arrays = [getattr(A, name) for name in _PARTS]
    rows = _COMPRESSED[A.format](_sound_parts(A), shape=A.shape)
    if A.format == "csc":
        rows = rows.tocsr()
    if not rows.has_canonical_format:
        rows = _canonical(rows)
    for name, old in zip(_PARTS, input_arrays, strict=True):
        values = getattr(rows, name)
        setattr(rows, name, protect_array(values) if np.may_share_memory(values, old) else _freeze(values))
    return rows


def protect_array(values: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only array, copied unless its memory is already read-only."""
    base: Any = values
    while isinstance(base, np.ndarray) and not base.flags.writeable and base.base is not None:
        base = base.base
    owned = isinstance(base, np.ndarray) and not base.flags.writeable
    return values if owned else _freeze(values.copy())


def _freeze(values: NDArray[Any]) -> NDArray[Any]:
    """Make an array and its base arrays read-only, without a copy."""
    base: Any = values
    while isinstance(base, np.ndarray):
        base.flags.writeable = False
        base = base.base
    return values


def _sound_parts(A: Any) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return data, indices and indptr of a compressed matrix after a check, without unused entries."""
    # Check dimensions and index types.
    data, indices, indptr = (np.asarray(getattr(A, name)) for name in _PARTS)
    blocks = A.format == "bsr"
    size = data.shape[1:] if blocks else (1, 1)
    ok = data.ndim == (3 if blocks else 1) and 0 not in size
    ok = ok and indices.ndim == indptr.ndim == 1 and {indices.dtype.kind, indptr.dtype.kind} <= {*"iu"}
    ok = ok and A.shape[0] % size[0] == A.shape[1] % size[1] == 0
    major, minor = (A.shape[0] // size[0], A.shape[1] // size[1]) if ok else A.shape
    major, minor = (minor, major) if A.format == "csc" else (major, minor)
    if not ok or len(indptr) != major + 1:
        shapes = ", ".join(
            f"{name} {v.shape} of {v.dtype}" for name, v in zip(_PARTS, (data, indices, indptr), strict=True)
        )
        raise OptionError(f"A is not a valid {A.format} matrix of shape {A.shape}: it has {shapes}")
    # Check offsets and indices.
    stored = min(len(indices), len(data))
    if indptr[0] != 0 or not (indptr[1:] >= indptr[:-1]).all() or indptr[-1] > stored:
        raise OptionError(
            f"A is not a valid {A.format} matrix: indptr must increase from 0 to at most its {stored} entries"
        )
    n = int(indptr[-1])
    indices = indices[:n]
    if n and not (indices.min() >= 0 and indices.max() < minor):
        wrong = indices.min() if indices.min() < 0 else indices.max()
        raise OptionError(
            f"A is not a valid {A.format} matrix: it has the index {wrong}, expected 0..{minor - 1}"
        )
    return data[:n].astype(_precision(data.dtype), copy=False), indices, indptr


def _coordinates(A: Any) -> Any:
    """Convert a matrix in another format to ``coo_array``, with checked indices."""
    try:
        data, i, j = _triples(A)
        if not {i.dtype.kind, j.dtype.kind} <= {*"iu"}:
            raise TypeError(f"indices of {i.dtype} and {j.dtype}")
        return sparse.coo_array((data.astype(_precision(A.dtype), copy=False), (i, j)), shape=A.shape)
    except (ValueError, TypeError, IndexError, OverflowError) as error:
        raise OptionError(f"A is not a valid {A.format} matrix of shape {A.shape}: {error}") from error


def _triples(A: Any) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return values, row indices and column indices of matrix entries.

    scipy's own conversions do not check offsets and lists.
    """
    if A.format == "dia":
        offsets, data = np.asarray(A.offsets), np.asarray(A.data)
        inside = (offsets > -A.shape[0]) & (offsets < A.shape[1])
        offsets, data = offsets[inside].astype(np.int64), data[inside]
        column = np.broadcast_to(np.arange(data.shape[1]), data.shape)
        row = column - offsets[:, None]
        stored = (row >= 0) & (row < A.shape[0]) & (column < A.shape[1]) & (data != 0)
        return data[stored], row[stored], column[stored]
    if A.format == "lil":
        row = np.repeat(np.arange(len(A.rows)), [len(each) for each in A.rows])
        data, column = (np.array([*chain.from_iterable(lists)]) for lists in (A.data, A.rows))
        return data, row, column.astype(np.int64, casting="same_kind") if len(column) else row
    A = A.tocoo()
    return np.asarray(A.data), A.row, A.col


def _canonical(A: Any) -> Any:
    """Return a copy in CSR or BSR with sorted indices and without duplicates."""
    A = A.copy()
    if A.format == "csr":
        A.sum_duplicates()
        return A
    A.sort_indices()
    A = sparse.bsr_array((A.data, A.indices, A.indptr), shape=A.shape)
    if A.has_canonical_format:
        return A
    rows = A.tocsr()  # scipy sums blocks in a Python loop over block rows
    rows.sum_duplicates()
    return rows.tobsr(A.blocksize)


def _precision(dtype: Any) -> Any:
    return np.complex128 if dtype.kind == "c" else np.float64


def real_array(name: str, given: Any) -> Float:
    """Return a float64 array. Object arrays may contain any real numbers.

    Raises
    ------
    OptionError
        For complex numbers, text, masked values, or objects that are not arrays.
    """
    values = plain_array(given, name, OptionError)
    try:
        if values.dtype.kind == "O" and not np.iscomplexobj(np.array(values.tolist())):
            values = values.astype(np.float64)
    except (TypeError, ValueError):
        raise OptionError(f"{name} must hold real numbers, given {given!r:.60}") from None
    if values.dtype.kind not in "biuf":
        raise OptionError(f"{name} holds {values.dtype}; expected real numbers")
    return values.astype(np.float64)


def offsets_of_blocks(block_offsets: Any, A: Any) -> Any:
    """Return block offsets, computed from a block size or from the blocks of a matrix.

    Parameters
    ----------
    block_offsets : int, (blocks + 1,) int or None
        A whole number is the number of unknowns in every block. None stands for the square blocks of a BSR
        matrix, or single unknowns for any other matrix. Arrays are returned unchecked.
    A : (n, n) sparse or array

    Raises
    ------
    OptionError
        If the rows of A cannot be divided into blocks of this size.
    """
    size, n = block_offsets, A.shape[0]
    if block_offsets is None:
        size = block_size(A)
    if isinstance(size, bool | np.bool_) or not isinstance(size, int | np.integer):
        return block_offsets
    if size < 1 or n % size:
        raise OptionError(
            f"block_offsets = {size} is a block size, but {n} unknowns cannot be divided into such blocks"
        )
    return np.arange(n // size + 1) * int(size)


def block_size(A: Any) -> int:
    """Return the size of the square blocks of a BSR matrix, or 1 for any other matrix."""
    rows, columns = A.blocksize if getattr(A, "format", "") == "bsr" else (1, 1)
    return int(rows) if rows == columns else 1


def require_finite(b: Float, A: Any) -> None:
    """Raise OptionError unless right-hand side and matrix are finite."""
    if not (np.isfinite(b).all() and np.isfinite(A.data).all()):
        raise OptionError("the matrix or the right-hand side contains values that are not finite")


def require_symmetric(A: Any) -> None:
    """Raise OptionError that names an entry, unless a matrix is symmetric up to rounding.

    Entries a_ij and a_ji may differ by 1e-10 (a_ii a_jj)^½, independent of other rows.
    """
    gap = sparse.coo_array(A - A.T)
    if not gap.nnz:
        return
    roots = np.sqrt(row_sizes(A))
    i, j = gap.coords
    relative = np.abs(gap.data) / roots[i] / roots[j]
    worst = int(np.argmax(relative))
    if relative[worst] > _ASYMMETRY:
        i, j = int(i[worst]), int(j[worst])
        rows = sparse.csr_array(A)
        one, other = _distinct_texts(float(rows[i, j]), float(rows[j, i]))
        raise OptionError(
            f"A must be symmetric: the entry ({i}, {j}) is {one}, ({j}, {i}) is {other}; "
            "give Linear(A, b, symmetric=False) to solver='polydg_mg' or 'direct'"
        )


def _distinct_texts(a: float, b: float) -> tuple[str, str]:
    """Format two different numbers with enough digits to distinguish them."""
    short = f"{a:g}", f"{b:g}"
    return short if short[0] != short[1] else (repr(a), repr(b))
