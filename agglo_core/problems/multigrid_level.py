"""Multigrid levels as smoothers, transfers and coarse operators receive them, and a table of levels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from agglo_core.arrays import Float, Int


@dataclass(frozen=True, eq=False)
class Patches:
    """Groups of parts whose unknowns are solved for together, possibly overlapping.

    Attributes
    ----------
    offsets : (q + 1,) int
        The parts of patch i are ``parts[offsets[i]:offsets[i + 1]]``.
    parts : (m,) int

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.problems import Patches
    >>> patches = Patches(np.array([0, 2, 4]), np.array([0, 1, 1, 2]))  # two, which share part 1
    >>> patches.parts[patches.offsets[1] : patches.offsets[2]]
    array([1, 2])
    """

    offsets: Int
    parts: Int

    def __len__(self) -> int:
        return len(self.offsets) - 1


@dataclass(frozen=True, eq=False)
class MultigridLevel:
    """One multigrid level as smoothers receive it: matrix, blocks, and transfer to the coarser level.

    Attributes
    ----------
    A : (n, n) sparse
        Level matrix.
    inherited : (n, n) sparse
        Pᵀ A P from the finest level, equal to A on levels that are not rediscretised.
    block_offsets : (parts + 1,) int
        Part p has the unknowns ``block_offsets[p]:block_offsets[p + 1]``.
    labels : (n_cells,) int
        Part on this level for each mesh cell.
    P : (n, m) sparse
        Prolongation from the next coarser level.
    coarse : callable, optional
        Maps a residual ``(n,)`` to the coarse correction ``(n,)``. None for no coarse correction.
    steps : int
        Smoothing steps per application.
    patches : Patches, optional
        Groups of parts around a vertex, or None without a mesh.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from agglo_core.problems import MultigridLevel
    >>> A, P = sparse.diags_array([2.0, 4.0]), sparse.csr_array([[1.0], [1.0]])
    >>> level = MultigridLevel(A, A, np.arange(3), np.arange(2), P, coarse=None, steps=1)
    >>> (level.P.T @ level.A @ level.P).toarray()
    array([[6.]])
    """

    A: Any
    inherited: Any
    block_offsets: Int
    labels: Int
    P: Any
    coarse: Callable[[Float], Float] | None
    steps: int
    patches: Patches | None = None


@dataclass(frozen=True, eq=False)
class Coarsening:
    """One multigrid level as transfers receive it: matrix, parts, and agglomerates of the parts.

    Attributes
    ----------
    A : (n, n) sparse
        Level matrix, with blocks (``bsr_array``) if all parts have equally many unknowns.
    block_offsets : (parts + 1,) int
        Part p has the unknowns ``block_offsets[p]:block_offsets[p + 1]``.
    labels, coarse_labels : (n_cells,) int
        Part on this level, and on the next coarser level, for each mesh cell.
    parents : (parts,) int, optional
        Coarse part of each part, or None if some part lies in several.
    near_null : (n, k) float, optional
        Near-null vectors of A, if any are known.
    injected : (n, m) sparse, optional
        Coarse functions on the finer level, or their L2 projections, or None for methods without an own
        coarse space.
    rediscretised : callable, optional
        Builds the problem's matrix ``(m, m)`` on the coarse parts, or None without a discretisation.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from agglo_core.problems import Coarsening
    >>> parents = np.array([0, 0, 1])
    >>> step = Coarsening(sparse.eye_array(3), np.arange(4), np.arange(3), parents, parents)
    >>> step.A.shape, step.parents
    ((3, 3), array([0, 0, 1]))
    """

    A: Any
    block_offsets: Int
    labels: Int
    coarse_labels: Int
    parents: Int | None = None
    near_null: Float | None = None
    injected: Any = None
    rediscretised: Callable[[], Any] | None = None


@dataclass(frozen=True, eq=False)
class CoarseSpace:
    """Coarse space of a transfer: prolongation P, coarse block offsets, and coarse near-null vectors.

    Attributes
    ----------
    P : (n, m) sparse
        Prolongation.
    block_offsets : (parts + 1,) int, optional
        Unknowns per coarse part. Default: equally many.
    near_null : (m, k) float, optional
        Near-null vectors on the coarse level, passed to its own transfer.

    Examples
    --------
    >>> from scipy import sparse
    >>> from agglo_core.problems import CoarseSpace
    >>> P = sparse.csr_array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    >>> CoarseSpace(P, block_offsets=[0, 1, 2]).P.shape
    (3, 2)
    """

    P: Any
    block_offsets: Int | None = None
    near_null: Float | None = None


class LevelTable:
    """Table of unknowns and matrix entries per multigrid level.

    Parameters
    ----------
    unknowns, entries : sequence of int
        Counts per level, finest first.
    smoothers : sequence of str, optional
        Smoother per level, and the coarsest solver.

    Examples
    --------
    >>> from agglo_core.problems.multigrid_level import LevelTable
    >>> LevelTable([360, 187], [6858, 1257], ["block Gauss-Seidel", "direct"])
    level  unknowns  entries  smoother
        0       360     6858  block Gauss-Seidel
        1       187     1257  direct
    """

    def __init__(
        self, unknowns: Sequence[int], entries: Sequence[int], smoothers: Sequence[str] = ()
    ) -> None:
        self.unknowns, self.entries, self.smoothers = tuple(unknowns), tuple(entries), tuple(smoothers)

    def __len__(self) -> int:
        return len(self.unknowns)

    def __repr__(self) -> str:
        columns = [
            ["level", *map(str, range(len(self)))],
            ["unknowns", *map(str, self.unknowns)],
            ["entries", *map(str, self.entries)],
        ]
        aligned = [[cell.rjust(max(map(len, column))) for cell in column] for column in columns]
        if self.smoothers:
            aligned.append(["smoother", *self.smoothers])
        return "\n".join("  ".join(row) for row in zip(*aligned, strict=True))
