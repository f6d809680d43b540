"""Linear systems A x = b given by the user, with unknowns in the cells of a mesh.

As a TOML table:

.. code-block:: toml

    kind = "linear"
    matrix = "A.mtx"                          # MatrixMarket, or .npz of scipy.sparse.save_npz
    rhs = "b.npy"                             # or .mtx, .txt, .npz with an array b; n numbers
    unknowns = 3                              # of each cell, one cell after the other; by default n / cells
    near_null = "B.npy"                       # optional: n rows; or .mtx, .txt, .npz with an array near_null
    symmetric = false                         # optional: the matrix need not be symmetric

File names are relative to the table's folder. The ``.npz`` file from ``agglo solve --write-system`` contains
matrix and rhs. Its ``block_offsets`` and ``near_null`` are used unless the table gives ``unknowns`` or
``near_null``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import AggloError, FileError, OptionError
from agglo_core.files.stored_matrices import (
    MATRIX_SUFFIXES,
    VECTOR_SUFFIXES,
    matrix_archive,
    read_matrix,
    read_vectors,
)
from agglo_core.mesh import Mesh
from agglo_core.problems.real_arrays import (
    canonical_matrix,
    offsets_of_blocks,
    protect_array,
    real_array,
    real_matrix,
    require_finite,
    require_symmetric,
)
from agglo_core.problems.table import require_keys
from agglo_core.suggestions import suggest_keywords

_KEYS = ("matrix", "rhs", "unknowns", "near_null", "symmetric")


@suggest_keywords()
@dataclass(frozen=True, eq=False)
class Linear:
    """Linear problem A x = b. Cell c has the unknowns ``block_offsets[c]:block_offsets[c + 1]``.

    Arrays are copied unless read-only, so that neither side can change the other's data.

    Attributes
    ----------
    A : (n, n) sparse
        Matrix in CSR, or in BSR if given as BSR: sorted columns, no duplicates, read-only arrays.
    b : (n,) or (n, k) float
        One right-hand side, or several if the solver supports several.
    block_offsets : (n_cells + 1,) int or int
        Cell offsets. The number of unknowns may vary, and be zero, if the solver supports this. A whole
        number is the number of unknowns in every cell. Default: the blocks of a BSR matrix are the cells,
        otherwise every cell has one unknown.
    near_null : (n, m) float, optional
        Near-null vectors of A, such as constants and rigid motions.
    symmetric : bool
        False if A need not be symmetric. The solvers ``polydg_mg`` and ``direct`` accept such matrices.

    Raises
    ------
    OptionError
        If ``block_offsets`` is neither a block size that fits A nor an array ``(n_cells + 1,)``, indices in A
        are out of range, or ``symmetric`` is not a bool.

    Examples
    --------
    >>> from scipy import sparse
    >>> A = sparse.diags_array(np.full(4, 2.0))
    >>> agglo.Linear(A, np.ones(4)).block_offsets  # one unknown in each cell
    array([0, 1, 2, 3, 4])
    >>> agglo.Linear(A, np.ones(4), 2).block_offsets
    array([0, 2, 4])
    """

    kind: ClassVar[str] = "linear"

    A: Any
    b: Float
    block_offsets: Int = None  # type: ignore[assignment]  # never None after construction
    near_null: Float | None = None
    symmetric: bool = True

    def __post_init__(self) -> None:
        if not isinstance(self.symmetric, bool | np.bool_):
            raise OptionError(f"symmetric must be True or False, given {self.symmetric!r:.60}")
        A = self.A if hasattr(self.A, "shape") else np.asarray(self.A)
        if len(A.shape) == 2:
            object.__setattr__(self, "block_offsets", offsets_of_blocks(self.block_offsets, A))
        if np.ndim(self.block_offsets) != 1:
            raise OptionError(
                "block_offsets must be a number of unknowns per cell or an array (n_cells + 1,), given "
                f"{self.block_offsets!r:.60}; to use a matrix file, name it in a problem file"
            )
        for name in ("A", "b", "block_offsets", "near_null"):
            value = getattr(self, name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, name, protect_array(value))
        if sparse.issparse(self.A):
            object.__setattr__(self, "A", canonical_matrix(self.A))

    @classmethod
    def from_table(cls, table: Mapping[str, Any], mesh: Mesh, folder: Path) -> Self:
        """Build the system from a table. The format is described in :mod:`agglo_core.problems.linear`.

        Raises
        ------
        OptionError
            For unknown or missing keys, a matrix that is not square, a right-hand side or near-null
            vectors of wrong size, or unknowns that do not fit the cells.
        FileError
            If a file cannot be read, or contains values that are not finite real numbers.
        """
        require_keys(table, _KEYS)
        # Read matrix and right-hand side.
        matrix, rhs = _file("matrix", table, folder), _file("rhs", table, folder)
        with _guard_reading("matrix", matrix, MATRIX_SUFFIXES):
            A = real_matrix(read_matrix(matrix))
            _require_finite(A.data)
        n = A.shape[0]
        if A.shape != (n, n):
            raise OptionError(f"matrix: {matrix} must be square, given {A.shape[0]} x {A.shape[1]}")
        with _guard_reading("rhs", rhs, VECTOR_SUFFIXES):
            b = read_vectors(rhs, "b", n)
            _require_finite(b)
        if b.size != n:
            raise OptionError(f"rhs: {rhs} has {b.size} numbers; the matrix has {n} rows")
        # Unknowns per cell: from the table, the matrix file, or by equal division.
        offsets = None if "unknowns" in table else _stored_offsets(matrix, n, mesh)
        if offsets is None:
            width = _width(table.get("unknowns"), n, mesh)
            offsets = frozen_int(np.arange(mesh.n_cells + 1) * width)
        near_null, symmetric = _near_null(table, matrix, n, folder), table.get("symmetric", True)
        return cls(A, frozen_float(b.ravel()), offsets, near_null, symmetric)

    @classmethod
    def example(cls, mesh: Mesh) -> Self:
        """Return the shifted Laplacian of the dual graph, well conditioned, with one unknown per cell."""
        links = mesh.graph.to_scipy()
        shift = 0.1 * (float(links.sum()) / mesh.n_cells or 1.0)
        A = sparse.csr_array(sparse.diags_array(links.sum(axis=1) + shift) - links)
        b = frozen_float(1.0 + np.arange(mesh.n_cells) / mesh.n_cells)
        return cls(A, b, frozen_int(np.arange(mesh.n_cells + 1)))


def _file(key: str, table: Mapping[str, Any], folder: Path) -> Path:
    name = table.get(key)
    if not isinstance(name, str) or not name:
        given = "not given" if name is None else f"given {name!r:.60}"
        raise OptionError(f"{key} must be the name of a file, {given}")
    return folder / name


@contextmanager
def _guard_reading(key: str, path: Path, suffixes: Sequence[str]) -> Iterator[None]:
    """Check a file's suffix, and convert reader exceptions to FileErrors that name the file."""
    if path.suffix.lower() not in suffixes:
        raise OptionError(f"{key} must end in {', '.join(suffixes)}, given {path.name!r}")
    try:
        if not path.is_file():
            raise FileError("no such file" if not path.exists() else "is not a regular file")
        yield
    except AggloError as error:
        raise FileError(f"{key}: {path}: {error}") from error.__cause__
    except OSError as error:
        raise FileError(f"{key}: {path}: {error.strerror or error}") from error
    except MemoryError as error:
        raise FileError(f"{key}: {path}: not enough memory to read it") from error


def _require_finite(values: Any) -> None:
    if not np.isfinite(values).all():
        raise FileError("holds values that are not finite")


def _near_null(table: Mapping[str, Any], matrix: Path, n: int, folder: Path) -> Float | None:
    """Read near-null vectors ``(n, m)`` from their own or the matrix file, or return None without any."""
    path = matrix
    if "near_null" in table:
        path = _file("near_null", table, folder)
    elif not _has_array(matrix, "near_null"):
        return None
    with _guard_reading("near_null", path, VECTOR_SUFFIXES):
        vectors = read_vectors(path, "near_null", n)
        _require_finite(vectors)
    if vectors.ndim not in (1, 2) or len(vectors) != n or not vectors.size:
        raise OptionError(f"near_null: {path} has shape {vectors.shape}; the matrix has {n} rows")
    return frozen_float(vectors.reshape(n, -1))


def _has_array(path: Path, name: str) -> bool:
    """Return True if a matrix file (``.npz``) also contains an array with this name."""
    with _guard_reading("matrix", path, MATRIX_SUFFIXES):
        return path.suffix.lower() == ".npz" and name in matrix_archive(path).members


def _stored_offsets(matrix: Path, n: int, mesh: Mesh) -> Int | None:
    """Return ``block_offsets`` from a matrix file, or None if the file does not contain them."""
    if not _has_array(matrix, "block_offsets"):
        return None
    with _guard_reading("matrix", matrix, MATRIX_SUFFIXES):
        offsets = matrix_archive(matrix).integers("block_offsets", (None,))
    if (
        len(offsets) != mesh.n_cells + 1
        or offsets[0] != 0
        or offsets[-1] != n
        or (np.diff(offsets) < 0).any()
    ):
        raise OptionError(
            f"matrix: block_offsets of {matrix} do not divide its {n} rows among {mesh.n_cells} cells"
        )
    return offsets


def _width(unknowns: Any, n: int, mesh: Mesh) -> int:
    """Return the number of unknowns per cell, or raise OptionError if it does not fit the matrix."""
    if unknowns is None:
        if n % mesh.n_cells or not n:
            raise OptionError(f"matrix: its {n} rows cannot be divided equally among {mesh.n_cells} cells")
        return n // mesh.n_cells
    if not isinstance(unknowns, int) or isinstance(unknowns, bool) or unknowns < 1:
        raise OptionError(f"unknowns must be a whole number, at least 1; given {unknowns!r:.60}")
    if unknowns * mesh.n_cells != n:
        raise OptionError(
            f"unknowns = {unknowns} on {mesh.n_cells} cells gives {unknowns * mesh.n_cells} unknowns, but "
            f"the matrix has {n} rows"
        )
    return unknowns


def require_cells(problem: Linear, cells: int) -> None:
    """Raise OptionError unless the unknowns of a problem belong to ``cells`` cells.

    Examples
    --------
    >>> from agglo_core.problems.linear import require_cells
    >>> require_cells(agglo.Linear(np.diag([2.0, 2.0]), np.ones(2)), 3)
    Traceback (most recent call last):
        ...
    agglo_core.errors.OptionError: the system has unknowns in 2 cells, but the hierarchy has 3 cells
    """
    given, unknowns = len(problem.block_offsets) - 1, int(problem.block_offsets[-1])
    if given == cells:
        return
    size, rest = divmod(unknowns, cells)
    hint = f"; for {size} unknowns in every cell give Linear(A, b, {size})" if size and not rest else ""
    raise OptionError(f"the system has unknowns in {given} cells, but the hierarchy has {cells} cells{hint}")


def symmetric_system(problem: Linear) -> tuple[sparse.csr_array, Float]:
    """Return matrix ``(n, n)`` and right-hand side ``(n,)`` of a linear problem, checked to be symmetric.

    Raises
    ------
    OptionError
        For a matrix without entries (a LinearOperator), not square or not symmetric, several right-hand sides
        or a sparse right-hand side, complex, non-numeric or infinite values, or shapes that do not fit.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.problems.linear import symmetric_system
    >>> A, b = symmetric_system(agglo.Linear([[2, -1], [-1, 2]], [1, 0], np.arange(3)))
    >>> A.toarray(), b
    (array([[ 2., -1.],
           [-1.,  2.]]), array([1., 0.]))
    """
    A, b = general_system(problem)
    require_symmetric(A)
    return A, b


def general_system(problem: Linear) -> tuple[sparse.csr_array, Float]:
    """Return matrix ``(n, n)`` and right-hand side ``(n,)`` of a linear problem, symmetric or not.

    Raises
    ------
    OptionError
        As :func:`symmetric_system`, except for a matrix that is not symmetric.

    Examples
    --------
    >>> from agglo_core.problems.linear import general_system
    >>> general_system(agglo.Linear([[2, -1], [0, 2]], [1, 0], 1, symmetric=False))[0].toarray()
    array([[ 2., -1.],
           [ 0.,  2.]])
    """
    b, A = _vector(problem.b), sparse.csr_array(real_matrix(problem.A))
    unknowns = int(problem.block_offsets[-1])
    if A.shape != (unknowns, unknowns) or b.shape != (unknowns,):
        raise OptionError(
            f"A has shape {A.shape} and b {b.shape}, but block_offsets define {unknowns} unknowns"
        )
    require_finite(b, A)
    return A, b


def _vector(array: Any) -> Float:
    if sparse.issparse(array):
        raise OptionError(
            f"b must be an array (n,), given a sparse array of shape {array.shape}: pass b.toarray().ravel()"
        )
    b = real_array("b", array)
    if b.ndim == 2:
        raise OptionError(
            f"b must be one right-hand side (n,), given shape {b.shape}: solve for one column at a time"
        )
    return frozen_float(b)
