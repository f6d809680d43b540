"""Conversion of matrices, vectors and linear problems between scipy and PETSc, on one or several ranks."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from agglo_core.authoring import Float, Linear, OptionError, frozen_float, frozen_int
from agglo_petsc.messages import agree


def petsc() -> Any:
    """Return the module ``petsc4py.PETSc``, importing MPI first so that wheels find its library.

    Raises
    ------
    OptionError
        If it is not installed, or uses complex numbers or another precision.
    """
    try:
        import mpi4py.MPI  # noqa: F401
        from petsc4py import PETSc
    except ImportError as error:
        raise OptionError(
            f"PETSc cannot be used here: {error} (see 'Install petsc4py' in agglo's guide PETSc)"
        ) from error
    if PETSc.ScalarType is not np.float64:
        raise OptionError(f"this PETSc computes with {PETSc.ScalarType.__name__}; expected one with float64")
    return PETSc


def to_petsc(matrix: Any, width: int = 1) -> Any:
    """Convert a scipy matrix ``(n, m)`` to a PETSc matrix on this process (``seqaij``).

    Parameters
    ----------
    matrix : (n, m) sparse
    width : int
        Row block size, used by block smoothers.
    """
    return mat_from_rows(sparse.csr_array(matrix), petsc().COMM_SELF, matrix.shape[1], (width, 1))


def mat_from_rows(rows: Any, comm: Any, own_columns: int, widths: tuple[int, int] = (1, 1)) -> Any:
    """Assemble a distributed PETSc matrix (``aij``) from each rank's rows. Collective.

    Parameters
    ----------
    rows : (n_own, m) csr
        Rows of this rank, with global columns; ranks are ordered 0, 1, ….
    comm : petsc4py.PETSc.Comm
    own_columns : int
        Number of columns whose vector entries belong to this rank; the sum over all ranks is m.
    widths : pair of int
        Row and column block sizes.

    Raises
    ------
    OptionError
        On all ranks, for more unknowns or entries on a rank than PETSc's index type can count.
    """
    PETSc = petsc()
    # 1. Check the index range
    rows = sparse.csr_array(rows)
    rows.sum_duplicates()
    most = np.iinfo(PETSc.IntType).max
    many = max(rows.nnz, *rows.shape) > most
    agree(
        comm,
        f"{rows.nnz} entries and {rows.shape[1]} columns: one exceeds {most}, the largest index of "
        "this PETSc; use a PETSc with 64-bit indices"
        if many
        else "",
    )
    # 2. Fill the matrix
    csr = rows.indptr.astype(PETSc.IntType), rows.indices.astype(PETSc.IntType), rows.data.astype(np.float64)
    sizes = ((rows.shape[0], PETSc.DETERMINE), (own_columns, rows.shape[1]))
    mat = PETSc.Mat().create(comm=comm)
    mat.setSizes(sizes)
    mat.setType("aij")
    mat.setBlockSizes(*(1 if each < 1 else each for each in widths))
    mat.setPreallocationCSR(csr)
    mat.assemble()
    return mat


def rows_of(mat: Any) -> Any:
    """Return this rank's rows of a PETSc matrix ``(n_own, m)`` as CSR, with global column indices.

    Raises
    ------
    OptionError
        For a matrix without accessible entries, for example a shell.
    """
    PETSc = petsc()
    explicit = mat
    try:
        if mat.getType() not in ("seqaij", "mpiaij"):
            explicit = mat.convert("aij", PETSc.Mat())
        indptr, indices, data = explicit.getValuesCSR()
    except PETSc.Error as error:
        raise OptionError(
            f"a PETSc matrix of type {mat.getType()} has no accessible entries (error {error.ierr}); "
            "expected aij, baij, sbaij or another type that converts to aij"
        ) from error
    shape = (mat.getLocalSize()[0], mat.getSize()[1])
    rows = sparse.csr_array((data, indices, indptr), shape=shape)
    if explicit is not mat:
        explicit.destroy()
    return rows


def to_scipy(mat: Any) -> Any:
    """Convert a PETSc matrix on one process, ``aij``, ``baij`` or ``sbaij``, to CSR ``(n, m)``.

    Raises
    ------
    OptionError
        If its rows are distributed over ranks; see also :func:`rows_of`.
    """
    if mat.getComm().getSize() > 1:
        raise OptionError(
            f"the rows of the matrix are divided among {mat.getComm().getSize()} ranks; expected one"
        )
    return rows_of(mat)


def vector(like: Any, values: Float) -> Any:
    """Create a PETSc vector distributed like the rows of a matrix, with values ``(n_own,)`` on this rank."""
    found = like.createVecLeft()
    found.setArray(np.asarray(values, np.float64))
    return found


def entries(vec: Any) -> Float:
    """Return a copy of a PETSc vector's entries on this rank ``(n_own,)``."""
    return frozen_float(np.array(vec.getArray(readonly=True)))


def near_null_vectors(mat: Any) -> Float | None:
    """Return the near-null vectors ``(n_own, k)`` stored with a matrix, or None if there are none."""
    space = mat.getNearNullSpace()
    if not space:
        return None
    columns = [np.ones(mat.getLocalSize()[0])] if space.hasConstant() else []
    columns += [np.array(each.getArray(readonly=True)) for each in space.getVecs()]
    return frozen_float(np.stack(columns, axis=1)) if columns else None


def linear(
    mat: Any, rhs: Any, *, block_offsets: ArrayLike | None = None, near_null: ArrayLike | None = None
) -> Linear:
    """Return the problem A x = b with a PETSc matrix and vector, for any agglo solver.

    Works on one process only.

    Parameters
    ----------
    mat : petsc4py.PETSc.Mat
        With type ``aij``, ``baij`` or ``sbaij``, or convertible to ``aij``.
    rhs : petsc4py.PETSc.Vec or (n,) float
    block_offsets : (parts + 1,) int, optional
        Part p has the unknowns ``block_offsets[p]:block_offsets[p + 1]``; by default parts have the block
        size of the matrix.
    near_null : (n, k) float, optional
        By default the matrix's near-null space (``setNearNullSpace``), if any.

    Raises
    ------
    OptionError
        If rows are distributed over ranks, entries are not accessible, or shapes do not fit.
    """
    A = to_scipy(mat)
    n, size = A.shape[0], int(mat.getBlockSize())
    offsets = np.arange(0, n + 1, size) if block_offsets is None else np.asarray(block_offsets)
    b = np.asarray(rhs, np.float64) if isinstance(rhs, np.ndarray | list | tuple) else entries(rhs)
    if b.shape != (n,):
        raise OptionError(f"rhs must have shape ({n},) for this matrix, given {b.shape}")
    near_null = near_null_vectors(mat) if near_null is None else near_null
    B = None if near_null is None else frozen_float(np.asarray(near_null, np.float64))
    return Linear(A, frozen_float(b), frozen_int(offsets), B)
