"""Matrices and vectors between scipy and PETSc, on one rank or with rows divided among several."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, OptionError, frozen_float


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


def agree(comm: Any, wrong: str) -> None:
    """Raise OptionError on all ranks if there is a message on any, so that none waits for another.

    Parameters
    ----------
    comm : petsc4py.PETSc.Comm
    wrong : str
        What is wrong on this rank; empty if nothing is.
    """
    told = comm.tompi4py().allgather(wrong)
    first = next((rank for rank, message in enumerate(told) if message), None)
    if first is not None:
        raise OptionError(told[first] if len(told) == 1 else f"rank {first}: {told[first]}")


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
