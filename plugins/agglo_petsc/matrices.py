"""Matrices, vectors and linear problems between scipy and PETSc, on one rank or several."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from agglo_core.authoring import Float, Linear, OptionError, frozen_float, frozen_int
from agglo_petsc.messages import agree


def petsc() -> Any:
    """The module ``petsc4py.PETSc``; MPI is loaded before it, so that the library of a wheel is found.

    Raises
    ------
    OptionError
        If it is not installed, or works with complex numbers or in another precision.
    """
    try:
        import mpi4py.MPI  # noqa: F401
        from petsc4py import PETSc
    except ImportError as error:
        raise OptionError(
            f"PETSc cannot be used here: {error} (agglo's guide PETSc says which wheel)"
        ) from error
    if PETSc.ScalarType is not np.float64:
        raise OptionError(f"this PETSc computes with {PETSc.ScalarType.__name__}; expected one with float64")
    return PETSc


def to_petsc(matrix: Any, width: int = 1) -> Any:
    """A scipy matrix ``(n, m)`` as a PETSc matrix of this process alone (``seqaij``).

    Parameters
    ----------
    matrix : (n, m) sparse
    width : int
        Block size of its rows, known to block smoothers.
    """
    return mat_from_rows(sparse.csr_array(matrix), petsc().COMM_SELF, matrix.shape[1], (width, 1))


def mat_from_rows(rows: Any, comm: Any, own_columns: int, widths: tuple[int, int] = (1, 1)) -> Any:
    """A PETSc matrix (``aij``) of which each rank gives its rows; collective.

    Parameters
    ----------
    rows : (n_own, m) csr
        Rows of this rank, with global columns; those of rank 0 come first, then those of rank 1, ….
    comm : petsc4py.PETSc.Comm
    own_columns : int
        Columns whose entries of a vector belong to this rank; over all ranks they add up to m.
    widths : pair of int
        Block sizes of rows and columns.

    Raises
    ------
    OptionError
        On all ranks, for more unknowns or entries on a rank than the indices of this PETSc can count.
    """
    PETSc = petsc()
    rows = sparse.csr_array(rows)
    rows.sum_duplicates()
    most = np.iinfo(PETSc.IntType).max
    many = max(rows.nnz, *rows.shape) > most
    agree(
        comm, f"{rows.nnz} entries, {rows.shape[1]} columns: more than {most}, this PETSc's" if many else ""
    )
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
    """Rows of this rank ``(n_own, m)`` as CSR, with global columns.

    Raises
    ------
    OptionError
        For a matrix whose entries PETSc does not give out, such as a shell.
    """
    PETSc = petsc()
    explicit = mat
    try:
        if mat.getType() not in ("seqaij", "mpiaij"):
            explicit = mat.convert("aij", PETSc.Mat())
        indptr, indices, data = explicit.getValuesCSR()
    except PETSc.Error as error:
        raise OptionError(
            f"a PETSc matrix of type {mat.getType()} has no entries to be had (error {error.ierr}); "
            "expected aij, baij, sbaij or another that converts to aij"
        ) from error
    shape = (mat.getLocalSize()[0], mat.getSize()[1])
    found = sparse.csr_array((data, indices, indptr), shape=shape)
    if explicit is not mat:
        explicit.destroy()
    return found


def to_scipy(mat: Any) -> Any:
    """A PETSc matrix of one process, of type ``aij``, ``baij`` or ``sbaij``, as CSR ``(n, m)``.

    Raises
    ------
    OptionError
        If its rows are divided among ranks, or as :func:`rows_of`.
    """
    if mat.getComm().getSize() > 1:
        raise OptionError(
            f"the rows of the matrix are divided among {mat.getComm().getSize()} ranks; expected one"
        )
    return rows_of(mat)


def vector(like: Any, values: Float) -> Any:
    """A PETSc vector for the rows of a matrix, with the values ``(n_own,)`` of this rank."""
    found = like.createVecLeft()
    found.setArray(np.asarray(values, np.float64))
    return found


def entries(vec: Any) -> Float:
    """The entries of a vector on this rank ``(n_own,)``, a copy."""
    return frozen_float(np.array(vec.getArray(readonly=True)))


def near_null_vectors(mat: Any) -> Float | None:
    """The near-null vectors ``(n_own, k)`` that come with a matrix (``setNearNullSpace``), if any."""
    space = mat.getNearNullSpace()
    if not space:
        return None
    columns = [np.ones(mat.getLocalSize()[0])] if space.hasConstant() else []
    columns += [np.array(each.getArray(readonly=True)) for each in space.getVecs()]
    return frozen_float(np.stack(columns, axis=1)) if columns else None


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
    near_null = near_null_vectors(mat) if near_null is None else near_null
    B = None if near_null is None else frozen_float(np.asarray(near_null, np.float64))
    return Linear(A, frozen_float(b), frozen_int(offsets), B)
