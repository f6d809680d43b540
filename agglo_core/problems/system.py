"""Linear system, assembled by a discretisation or given by the user."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, Int, frozen_float, frozen_int, index_cast, plain_array
from agglo_core.errors import OptionError
from agglo_core.mesh import Mesh
from agglo_core.problems.real_arrays import (
    block_size,
    offsets_of_blocks,
    real_array,
    real_matrix,
    require_finite,
    require_symmetric,
)
from agglo_core.problems.residuals.row_scales import row_sizes

_SUSPECT = 1e-11
"""Minimum difference |x·Ay − y·Ax|, with A scaled to unit diagonal, that triggers a comparison of entries."""


@dataclass(frozen=True, eq=False)
class System:
    """Linear system A x = b, and data on its unknowns for multigrid.

    Attributes
    ----------
    A : (n, n) sparse, float64
        Any sparse or dense matrix. Stored as CSR, or BSR if given as BSR: sorted columns, no duplicates,
        read-only arrays.
    b : (n,) or (n, k) float
        One or several right-hand sides.
    block_offsets : (blocks + 1,) int or int
        Block c has the unknowns ``block_offsets[c]:block_offsets[c + 1]``, at least one. A whole number is
        the size of all blocks. Default: the blocks of a BSR matrix, else single unknowns. With a mesh,
        blocks are its cells.
    mesh : Mesh, optional
    near_null : (n, m) float, optional
        Near-null vectors of A, such as constants and rigid motions.
    symmetric : bool
        False if A need not be symmetric.

    Raises
    ------
    OptionError
        For a matrix without entries (a LinearOperator), not square, or if ``symmetric`` not symmetric up to
        rounding, indices out of range, complex, non-numeric or infinite values, or shapes that do not fit.

    Examples
    --------
    >>> system = System([[2.0, -1.0], [-1.0, 2.0]], [1.0, 0.0])
    >>> system.n, system.block_offsets
    (2, array([0, 1, 2]))
    """

    A: Any
    b: Float
    block_offsets: Int = None  # type: ignore[assignment]  # never None after construction
    mesh: Mesh | None = None
    near_null: Float | None = None
    symmetric: bool = True

    def __post_init__(self) -> None:
        A = real_matrix(self.A)
        if A.shape[0] != A.shape[1] or not A.shape[0]:
            raise OptionError(f"A must be a square matrix, given shape {A.shape}")
        b = _columns("b", self.b, A.shape[0], (1, 2))
        require_finite(b, A)
        if self.symmetric:
            _require_symmetric(A)
        near = None if self.near_null is None else _columns("near_null", self.near_null, A.shape[0], (2,))
        if near is not None and not np.isfinite(near).all():
            raise OptionError("near_null holds values that are not finite")
        offsets = _offsets(self.block_offsets, A, self.mesh)
        for name, value in (("A", A), ("b", b), ("block_offsets", offsets), ("near_null", near)):
            object.__setattr__(self, name, value)

    @classmethod
    def trusted(
        cls, A: Any, b: Float, block_offsets: Int, mesh: Mesh | None, near_null: Float | None = None
    ) -> Self:
        """Build a system from consistent arrays without checks, for discretisations."""
        system = object.__new__(cls)
        parts = {"A": A, "b": b, "block_offsets": block_offsets, "mesh": mesh, "near_null": near_null}
        for name, value in parts.items():
            object.__setattr__(system, name, value)
        return system

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return int(self.A.shape[0])

    @property
    def n_blocks(self) -> int:
        """Block count."""
        return len(self.block_offsets) - 1

    @property
    def width(self) -> int | None:
        """Number of unknowns per block, or None if it varies."""
        sizes = np.diff(self.block_offsets)
        return int(sizes[0]) if (sizes == sizes[0]).all() else None

    def to_scipy(self) -> tuple[sparse.csr_array, Float]:
        """Return copies of matrix and right-hand side for scipy, PyAMG and others.

        Indices have 32 bits if possible, as required by PyAMG and scikit-learn.
        """
        A = sparse.csr_array(self.A, copy=True)
        indices, indptr = (index_cast(each, max(A.nnz, *A.shape)) for each in (A.indices, A.indptr))
        return sparse.csr_array((A.data, indices, indptr), shape=A.shape), np.array(self.b)


def _columns(name: str, array: Any, n: int, dimensions: tuple[int, ...]) -> Float:
    if sparse.issparse(array):
        raise OptionError(
            f"{name} must be an array, given a sparse array of shape {array.shape}: pass {name}.toarray()"
        )
    values = real_array(name, array)
    if values.ndim not in dimensions or len(values) != n or 0 in values.shape:
        shapes = " or ".join(f"({n},)" if d == 1 else f"({n}, k)" for d in dimensions)
        raise OptionError(f"{name} must have the shape {shapes} to match A, given {values.shape}")
    return frozen_float(values)


def _offsets(block_offsets: Any, A: Any, mesh: Mesh | None) -> Int:
    n, cells = A.shape[0], None if mesh is None else mesh.n_cells
    if block_offsets is None and cells == n:
        return frozen_int(np.arange(n + 1))
    if block_offsets is None and cells not in (None, n // block_size(A)):
        raise OptionError(f"block_offsets are required: they assign the {n} unknowns to the {cells} cells")
    block_offsets = offsets_of_blocks(block_offsets, A)
    values = plain_array(block_offsets, "block_offsets", OptionError)
    if values.ndim != 1 or values.dtype.kind not in "iu" or not len(values):
        raise OptionError(
            "block_offsets must be a block size or whole numbers of shape (blocks + 1,), given "
            f"{block_offsets!r:.60}"
        )
    fit = values[0] == 0 and values[-1] == n and (np.diff(values.astype(np.int64)) > 0).all()
    if not fit:
        raise OptionError(
            f"block_offsets must increase from 0 to the number of unknowns {n}, given {block_offsets!r:.60}"
        )
    if cells not in (None, len(values) - 1):
        raise OptionError(f"block_offsets define {len(values) - 1} blocks, but the mesh has {cells} cells")
    return frozen_int(values)


def _require_symmetric(A: Any) -> None:
    """Raise OptionError unless A is symmetric.

    A random test compares x·Ay and y·Ax first, because a transpose costs far more.
    """
    x, y = np.random.default_rng(0).normal(size=(2, A.shape[0])) / np.sqrt(row_sizes(A))
    with np.errstate(over="ignore", invalid="ignore"):
        gap = abs(float(x @ (A @ y)) - float(y @ (A @ x)))
    if not gap <= _SUSPECT:
        require_symmetric(A)
