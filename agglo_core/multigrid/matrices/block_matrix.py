"""Symmetric block matrices, prepared for Gauss–Seidel sweeps in single or double precision."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from agglo_core.arrays import Float, Int, frozen, frozen_float, frozen_index, frozen_int
from agglo_core.errors import OptionError
from agglo_core.multigrid.kernels.block_sweeps import (
    block_sweeps,
    both_products,
    clear_tiny,
    invert_blocks,
    sweep_parts,
)
from agglo_core.multigrid.stack import Real
from agglo_core.problems.real_arrays import real_matrix

_NOTHING = 1e-22  # relative to the largest entry: smaller entries make slow denormal products
_ASYMMETRY = 1e-6  # maximum |A v − Aᵀ v| relative to the largest entry


@dataclass(frozen=True, eq=False)
class BlockMatrix:
    """Symmetric positive definite matrix with its inverse diagonal blocks.

    Built by :func:`block_matrix`.

    Attributes
    ----------
    matrix : (n, n) bsr_array or csr_array
        Matrix, as BSR if all parts have equally many unknowns.
    inverses : (n, n) bsr_array or csr_array
        D⁻¹ for the diagonal blocks D, in equal format.
    block_offsets : (parts + 1,) int

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.csr_array(2.0 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    >>> from agglo_core.multigrid import block_matrix
    >>> blocks = block_matrix(A, np.array([0, 2, 4, 6]))
    >>> blocks.matrix.blocksize, blocks.inverses.nnz
    ((2, 2), 12)
    """

    matrix: Any
    inverses: Any
    block_offsets: Int

    @property
    def shape(self) -> tuple[int, int]:
        """Matrix shape ``(n, n)``."""
        n = self.matrix.shape[0]
        return n, n

    @property
    def dtype(self) -> Any:
        """Precision: float32 or float64."""
        return self.matrix.dtype

    @property
    def nnz(self) -> int:
        """Number of stored entries."""
        return int(self.matrix.nnz)

    def __matmul__(self, x: Any) -> Any:
        return self.matrix @ x

    def forward_from_zero(self, b: Real, sweeps: int = 1) -> tuple[Real, Real]:
        """Return x ``(n,)`` after forward sweeps from 0, and the residual b − A x.

        For equal blocks the residual has no extra cost: each sweep passes through the matrix once.
        """
        x, r = np.zeros(len(b), self.dtype), np.array(b, self.dtype)
        if self._width:
            for _ in range(sweeps):
                self._kernels[0](*self._arrays, r, x)
            return x, r
        x = self.forward(b, x, sweeps)
        return x, r - self.matrix @ x

    def forward(self, b: Real, x: Real, sweeps: int = 1) -> Real:
        """Update x ``(n,)`` by block Gauss–Seidel sweeps from the first part to the last, and return x."""
        return self._swept(b, x, sweeps, 1)

    def backward(self, b: Real, x: Real, sweeps: int = 1) -> Real:
        """Update x ``(n,)`` by block Gauss–Seidel sweeps from the last part to the first, and return x."""
        return self._swept(b, x, sweeps, -1)

    def _swept(self, b: Real, x: Real, sweeps: int, order: int) -> Real:
        b = frozen(b, self.dtype)
        x = np.require(x, self.dtype, ["C", "W"])
        for _ in range(sweeps):
            if self._width:
                self._kernels[1](*self._arrays, b, x, order)
            else:
                sweep_parts(*self._arrays, b, x, order)
        return x

    @property
    def _width(self) -> int:
        """Block size, or 0 for variable blocks."""
        return int(self.matrix.blocksize[0]) if self.matrix.format == "bsr" else 0

    @cached_property
    def _kernels(self) -> tuple[Any, Any]:
        return block_sweeps(self._width)

    @cached_property
    def _arrays(self) -> tuple[NDArray[Any], ...]:
        """Arrays of the matrix and its inverse diagonal blocks, as kernel arguments."""
        A = self.matrix
        data, inverses = frozen(A.data, self.dtype), frozen(self.inverses.data, self.dtype).reshape(-1)
        if not self._width:
            return *_pattern(A), data, self.block_offsets, _places(self.block_offsets), inverses
        groups = np.arange(len(self.block_offsets))  # each part is a group
        starts = frozen_int(self._width**2 * groups)
        pattern = frozen_int(A.indptr), frozen_index(A.indices)
        return frozen_int(groups), frozen_index(groups[:-1]), starts, inverses, *pattern, data


def block_matrix(
    A: Any, block_offsets: Int, dtype: Any = np.float64, *, symmetric: bool = False
) -> BlockMatrix:
    """Prepare a symmetric positive definite matrix for block Gauss–Seidel.

    Parameters
    ----------
    A : (n, n) sparse
    block_offsets : (parts + 1,) int
        Part p has the unknowns ``block_offsets[p]:block_offsets[p + 1]``. Sizes may differ.
    dtype : float32 or float64
        Precision of the sweeps. Diagonal blocks are inverted in double precision.
    symmetric : bool
        Skip the checks of A, known to be symmetric and finite.

    Raises
    ------
    OptionError
        If A is not symmetric or has indices out of range, for offsets that do not fit, or another dtype.
    LinAlgError
        If a diagonal block is not positive definite. The message names its part.

    Examples
    --------
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import block_matrix
    >>> A = block_matrix(sparse.csr_array([[2.0, 1.0], [1.0, 2.0]]), [0, 1, 2])
    >>> A.forward_from_zero([2.0, 2.0])
    (array([1. , 0.5]), array([-0.5,  0. ]))
    """
    if np.dtype(dtype) not in (np.float32, np.float64):
        raise OptionError(f"dtype must be float32 or float64; given {np.dtype(dtype)}")
    A = in_blocks(A if symmetric else real_matrix(A), block_offsets)
    if not symmetric:
        _require_symmetric(A)
    offsets = frozen_int(block_offsets)
    inverses = in_precision(block_inverses(A, offsets), dtype)
    return BlockMatrix(in_precision(A, dtype), inverses, offsets)


def in_blocks(A: Any, block_offsets: Int) -> Any:
    """Return A as ``bsr_array`` if all parts have equal size, else as ``csr_array``, with duplicates summed.

    Raises
    ------
    OptionError
        If the offsets do not fit the matrix.
    """
    sizes = np.diff(block_offsets)
    n = A.shape[0]
    if (
        A.shape != (n, n)
        or not len(sizes)
        or block_offsets[0] != 0
        or block_offsets[-1] != n
        or min(sizes) < 0
    ):
        raise OptionError(
            "block_offsets must increase from 0 to the number of unknowns of a square matrix; given "
            f"{len(sizes)} parts with {block_offsets[-1] if len(sizes) else 0} unknowns for shape {A.shape}"
        )
    width = int(sizes[0])
    if width and (sizes == width).all():
        stored = sparse.bsr_array(A, blocksize=(width, width), dtype=np.float64)
    else:
        stored = sparse.csr_array(A, dtype=np.float64)
    if not stored.has_canonical_format:
        stored = stored.copy()
        stored.sum_duplicates()
    return stored


def block_inverses(A: Any, block_offsets: Int) -> Any:
    """Return D⁻¹ ``(n, n)`` for the diagonal blocks D, as ``bsr_array``, or ``csr_array`` for unequal sizes.

    Raises
    ------
    OptionError
        If the offsets do not fit the matrix.
    LinAlgError
        If a block is not positive definite. The message names its part.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.csr_array(2.0 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    >>> from agglo_core.multigrid import block_inverses
    >>> 3.0 * block_inverses(A, np.array([0, 2, 4, 6])).toarray()[:2, :2]
    array([[2., 1.],
           [1., 2.]])
    """
    A, offsets = in_blocks(A, block_offsets), frozen_int(block_offsets)
    blocks = _diagonal(A, offsets)
    bad = invert_blocks(offsets, blocks)
    if bad >= 0:
        raise np.linalg.LinAlgError(
            f"the matrix is not positive definite: the block of part {bad}, unknowns "
            f"{offsets[bad]}:{offsets[bad + 1]}, is not"
        )
    parts, sizes = len(offsets) - 1, np.diff(offsets)
    if A.format == "bsr":
        width = A.blocksize[0]
        blocks, pattern = blocks.reshape(parts, width, width), (np.arange(parts), np.arange(parts + 1))
        return sparse.bsr_array((blocks, *pattern), shape=A.shape)
    of_row = np.repeat(sizes, sizes)  # entries of each row
    starts = np.repeat(offsets[:-1], sizes)
    indptr = np.concatenate([[0], np.cumsum(of_row)])
    columns = np.arange(indptr[-1]) - np.repeat(indptr[:-1] - starts, of_row)
    return sparse.csr_array((blocks, columns, indptr), shape=A.shape)


def _diagonal(A: Any, offsets: Int) -> Float:
    """Return the diagonal blocks in a flat array, each stored by rows."""
    sizes, places = np.diff(offsets), _places(offsets)
    blocks = np.zeros(int(np.sum(sizes**2)))
    if A.format == "bsr":
        rows = np.repeat(np.arange(len(sizes)), np.diff(A.indptr))
        on = rows == A.indices
        blocks.reshape(-1, *A.blocksize)[rows[on]] = A.data[on]
        return blocks
    part = np.repeat(np.arange(len(sizes)), sizes)
    rows = np.repeat(np.arange(A.shape[0]), np.diff(A.indptr))
    on = part[rows] == part[A.indices]
    p = part[rows[on]]
    place = places[p] + (rows[on] - offsets[p]) * sizes[p] + A.indices[on] - offsets[p]
    blocks[place] = A.data[on]
    return blocks


def _places(offsets: Int) -> Int:
    """Return the index of each diagonal block's first entry in the flat array of all blocks."""
    squares = np.diff(offsets) ** 2
    return frozen_int(np.cumsum(squares) - squares)


def in_precision(A: Any, dtype: Any) -> Any:
    """Convert a sparse matrix to single or double precision.

    In single precision, entries below 1e-22 times the largest become 0.
    """
    if A.dtype == dtype:
        return A
    data = np.array(A.data, dtype, order="C")
    clear_tiny(data.reshape(-1), data.dtype.type(_NOTHING * _largest(data)))
    pattern = (A.indices, A.indptr)
    return type(A)((data, *pattern), shape=A.shape)


def _largest(data: NDArray[Any]) -> float:
    """Return the largest absolute value of an array, without a temporary copy."""
    return max(float(data.max(initial=0.0)), -float(data.min(initial=0.0)))


def _require_symmetric(A: Any) -> None:
    v = np.sqrt(2.0) * np.arange(A.shape[0]) ** 2 % 1.0 + 0.5  # cheap substitute for a random vector
    blocks = frozen_float(A.data if A.format == "bsr" else A.data[:, None, None])
    there, back = both_products(*_pattern(A), blocks, frozen_float(v))
    gap = np.abs(there - back).max(initial=0.0)
    if not gap <= _ASYMMETRY * _largest(A.data):
        raise OptionError(
            f"the matrix must be symmetric and finite: A v and Aᵀ v differ by {gap:.1e} for some v"
        )


def _pattern(A: Any) -> tuple[NDArray[Any], ...]:
    """Return row offsets and column indices in the kernels' integer type."""
    small = max(A.indptr[-1], A.shape[0]) < np.iinfo(np.int32).max
    return tuple(frozen(each, np.int32 if small else np.int64) for each in (A.indptr, A.indices))
