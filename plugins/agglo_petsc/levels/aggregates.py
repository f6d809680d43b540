"""Smoothed aggregation with matrix rows distributed over ranks.

P. Vaněk, J. Mandel, M. Brezina, "Algebraic multigrid by smoothed aggregation for second and fourth order
elliptic problems", Computing 56 (1996), with blocks instead of scalars. The near-null vectors for
discontinuous polynomials are all polynomials: restricted to agglomerates they are the polynomials on the
agglomerates, and the block Jacobi step removes the jumps that the penalty punishes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from agglo_core.authoring import (
    Float,
    Hierarchy,
    Int,
    OptionError,
    Patches,
    frozen_float,
    frozen_int,
    multigrid,
)
from agglo_petsc.levels.jacobi_smoothing import jacobi_smoothed
from agglo_petsc.levels.labels import nested_aggregates
from agglo_petsc.levels.owned_bases import bases_where_owned
from agglo_petsc.matrices import mat_from_rows, near_null_vectors, petsc
from agglo_petsc.messages import agree


@dataclass(frozen=True, eq=False)
class PetscLevels:
    """Multigrid levels for PETSc: prolongations, finest first, from which ``PCMG`` computes the matrices.

    Attributes
    ----------
    prolongations : sequence of petsc4py.PETSc.Mat
        Rows of this rank, global columns. There is one more level than prolongations.
    widths : sequence of int or None
        Unknowns per part on the finer level; None if parts differ.
    patches : sequence of Patches or None
        Groups of fine parts to smooth together, by global numbers; each group is contributed by one rank.
    """

    prolongations: Sequence[Any]
    widths: Sequence[int | None]
    patches: Sequence[Patches | None]


Levels = PetscLevels | Hierarchy | Sequence[ArrayLike]
"""Accepted forms of levels in :func:`levels_for`: ready levels, a hierarchy, or labels per level."""

_ADVICE = (
    "(call mat.setBlockSize if a cell has several unknowns, or labels_of_unknowns if cells share unknowns)"
)


def given_levels(
    prolongations: Sequence[Any],
    *,
    widths: Sequence[int | None] | None = None,
    patches: Sequence[Patches | None] | None = None,
) -> PetscLevels:
    """Return levels with given prolongations: scipy matrices on one process, or PETSc matrices.

    Parameters
    ----------
    prolongations : sequence of (n, m) sparse or petsc4py.PETSc.Mat
        Finest first, for example ``P`` in ``Solution.operators``. Distributed matrices come from
        :func:`~agglo_petsc.matrices.mat_from_rows`.
    widths, patches : sequence, optional
        See :class:`PetscLevels`, one for each prolongation.

    Raises
    ------
    OptionError
        If the matrix sizes do not match, or the number of widths or patches is wrong.
    """
    PETSc, count = petsc(), len(prolongations)
    matrices = [P if isinstance(P, PETSc.Mat) else _petsc_matrix(P) for P in prolongations]
    sizes = [P.getSize() for P in matrices]
    wrong = next((k for k in range(1, count) if sizes[k - 1][1] != sizes[k][0]), None)
    if wrong is not None:
        raise OptionError(
            f"prolongations[{wrong}] has {sizes[wrong][0]} rows; "
            f"the one before has {sizes[wrong - 1][1]} columns"
        )
    for name, values in (("widths", widths), ("patches", patches)):
        if values is not None and len(values) != count:
            raise OptionError(f"{name} must be given for each of {count} prolongations; given {len(values)}")
    return PetscLevels(matrices, widths or [None] * count, patches or [None] * count)


def aggregate_levels(
    A: Any,
    aggregates: Sequence[ArrayLike],
    near_null: ArrayLike | None = None,
    *,
    block_offsets: ArrayLike | None = None,
    patches: Sequence[Patches | None] | None = None,
    owned: Sequence[int] | None = None,
    smooth: bool = True,
    damping: float = 4 / 3,
) -> PetscLevels:
    """Build multigrid levels by smoothed aggregation from given aggregates. Collective.

    Parameters
    ----------
    A : petsc4py.PETSc.Mat
        Symmetric and positive definite; each rank has the rows of its own parts, parts one after the other.
    aggregates : sequence of (own parts,) int
        For each part on this rank the global number of its aggregate, −1 for none; then for each aggregate
        its aggregate on the next level, and so on. Numbers continue from rank to rank, like a scan of their
        counts: 0, 1, … on the first rank with any.
    near_null : (own unknowns, k) float, optional
        Vectors that A maps to nearly zero. By default the vectors of the matrix (``setNearNullSpace``) or,
        without any, constants: one vector for each unknown of a part.
    block_offsets : (own parts + 1,) int, optional
        Part p has the unknowns ``block_offsets[p]:block_offsets[p + 1]``, counted on this rank; by default
        parts have the matrix block size.
    patches : sequence of Patches, optional
        See :class:`PetscLevels`; one for each of ``aggregates``.
    owned : sequence of int, optional
        Aggregate count per level on this rank, wherever their parts are. By default an aggregate is on
        the rank of all its parts.
    smooth : bool
        Whether a block Jacobi step smooths the prolongations.
    damping : float
        Damping of that step, over the largest eigenvalue of D⁻¹A.

    Raises
    ------
    OptionError
        On all ranks: for arrays that do not fit, numbers with gaps or on several ranks, or a matrix that is
        not positive definite.

    Examples
    --------
    On one rank, a path of eight in pairs and in fours:

    >>> import numpy as np  # doctest: +SKIP
    >>> levels = aggregate_levels(mat, [np.arange(8) // 2, np.arange(4) // 2])  # doctest: +SKIP
    >>> [P.getSize() for P in levels.prolongations]  # doctest: +SKIP
    [(8, 4), (4, 2)]
    """
    comm = A.getComm()
    offsets, B, prolongations, widths, galerkin_matrices = *_start(A, block_offsets, near_null), [], [], []
    # Each level: aggregates, tentative prolongation, Jacobi step, Galerkin matrix
    for level, part_aggregates in enumerate(aggregates):
        ids, count = _number_aggregates(
            comm, level, part_aggregates, len(offsets) - 1, None if owned is None else owned[level]
        )
        start = bases_where_owned(comm, np.repeat(ids, np.diff(offsets)), count, B)
        width, below = (_width(comm, item) for item in (offsets, start.offsets))
        P = mat_from_rows(start.rows, comm, int(start.offsets[-1]), (width or 1, below or 1))
        if smooth:
            P = jacobi_smoothed(A, offsets, P, damping)
        prolongations.append(P)
        widths.append(width)
        offsets, B = start.offsets, start.near_null
        if smooth and level + 1 < len(aggregates):
            A = A.ptap(P)
            galerkin_matrices.append(A)
    for item in galerkin_matrices:
        item.destroy()
    return given_levels(prolongations, widths=widths, patches=patches)


def levels_for(A: Any, given: Levels) -> PetscLevels:
    """Return the levels for a matrix, built from a hierarchy or labels if necessary. Collective.

    Raises
    ------
    OptionError
        On all ranks, if they do not fit the matrix.
    """
    # 1. Check the labels
    if isinstance(given, PetscLevels):
        return given
    comm, width = A.getComm(), A.getBlockSize()
    parts = A.getLocalSize()[0] // width
    labels = [frozen_int(values) for values in (given.levels if isinstance(given, Hierarchy) else given)]
    wrong = next((f"labels have shape {values.shape}" for values in labels if values.shape != (parts,)), "")
    agree(comm, wrong and f"{wrong}; the matrix has {parts} parts of {width} unknowns on this rank {_ADVICE}")
    # 2. Number aggregates across the ranks
    ups = nested_aggregates(labels)
    counts = [parts, *(int(values.max(initial=-1)) + 1 for values in ups)]
    before = [
        sum(values) for values in zip(*comm.tompi4py().allgather(counts)[: comm.getRank()], strict=True)
    ]
    first = before or [0] * len(counts)
    numbered = [frozen_int(up + start) for up, start in zip(ups, first[1:], strict=True)]
    return aggregate_levels(A, numbered, patches=_vertex_patches(given, labels, first))


def _vertex_patches(levels: Any, labels: list[Int], first: list[int]) -> list[Patches | None] | None:
    """Return the sets of parts around vertices, with global part numbers, or None without a 2-D mesh."""
    mesh = levels.fine if isinstance(levels, Hierarchy) else None
    if mesh is None or mesh.dim != 2:
        return None
    patches: list[Patches | None] = []
    for finer, start in zip([None, *labels[:-1]], first[:-1], strict=True):
        level_patches = multigrid.vertex_patches(mesh, finer)
        patches.append(Patches(level_patches.offsets, frozen_int(level_patches.parts + start)))
    return patches


def _petsc_matrix(P: Any) -> Any:
    if not sparse.issparse(P):
        raise OptionError(f"a prolongation must be a sparse matrix or a PETSc.Mat, given {P!r:.60}")
    return mat_from_rows(P, petsc().COMM_SELF, P.shape[1])


def _start(A: Any, block_offsets: ArrayLike | None, near_null: ArrayLike | None) -> tuple[Int, Float]:
    """Return block offsets and near-null vectors for the rows of this rank, checked on all ranks."""
    # 1. Offsets and vectors, with defaults
    n, size = A.getLocalSize()[0], A.getBlockSize()
    offsets = np.arange(0, n + 1, size) if block_offsets is None else np.asarray(block_offsets)
    if near_null is None:
        near_null = _near_null_or_constants(A, n, offsets)
    B = np.asarray(near_null, np.float64)
    B = B[:, None] if B.ndim == 1 else B
    # 2. Check both on all ranks
    fit = offsets.ndim == 1 and len(offsets) and offsets[0] == 0 and offsets[-1] == n
    wrong = (
        ""
        if fit and (np.diff(offsets) > 0).all()
        else (
            f"block_offsets must increase from 0 to {n}, the rows of this rank; given {block_offsets!r:.60}"
        )
    )
    if not wrong and (B.ndim != 2 or len(B) != n or B.shape[1] < 1 or not np.isfinite(B).all()):
        wrong = (
            f"near_null must be ({n}, k) finite numbers, one row for each row of this rank; given {B.shape}"
        )
    agree(A.getComm(), wrong)
    return frozen_int(offsets), frozen_float(B)


def _near_null_or_constants(A: Any, n: int, offsets: Any) -> Any:
    """Return the near-null vectors stored with the matrix, or a constant per unknown of a part."""
    found = near_null_vectors(A)
    if found is not None:
        return found
    sizes = np.diff(offsets)
    width = int(A.getBlockSize()) if (sizes == A.getBlockSize()).all() else 1
    return (np.arange(n)[:, None] % width == np.arange(width)).astype(float)


def _number_aggregates(
    comm: Any, level: int, aggregates: ArrayLike, parts: int, owned: int | None
) -> tuple[Int, int]:
    """Return each part's aggregate, −1 for none, and the aggregate count on this rank.

    Checked on all ranks.
    """
    ids, ranks = np.asarray(aggregates), comm.tompi4py()
    fits = ids.shape == (parts,) and (ids.dtype.kind in "iu" or not parts)
    inside = np.unique(ids[ids >= 0]) if fits and parts else np.empty(0, np.int64)
    count = len(inside) if owned is None else owned
    counts = ranks.allgather(count)
    first, total, wrong = sum(counts[: ranks.rank]), sum(counts), ""
    if not fits:
        wrong = (
            f"aggregates[{level}] must be {parts} whole numbers, one for each part; given {aggregates!r:.60}"
        )
    elif owned is not None and len(inside) and inside[-1] >= total:
        wrong = f"aggregates[{level}] go up to {inside[-1]}, but all ranks together have {total} aggregates"
    elif owned is None and len(inside) and (inside[0] != first or inside[-1] != first + count - 1):
        wrong = (
            f"aggregates[{level}] are {inside[0]} to {inside[-1]} on this rank; expected {first} to "
            f"{first + count - 1}: each aggregate must lie on one rank, numbered consecutively by rank"
        )
    agree(comm, wrong)
    return frozen_int(np.where(ids >= 0, ids, -1) if len(ids) else np.empty(0)), int(count)


def _width(comm: Any, offsets: Int) -> int | None:
    """Return the number of unknowns per part, or None if parts on any ranks differ."""
    sizes = np.diff(offsets)
    own = (int(sizes.min()), int(sizes.max())) if len(sizes) else None
    seen = [each for each in comm.tompi4py().allgather(own) if each is not None]
    least, most = min((each[0] for each in seen), default=1), max((each[1] for each in seen), default=1)
    return least if least == most and least > 0 else None
