"""Levels of multigrid methods: what smoothers and coarse operators are given, and the table of all levels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from agglo_core.arrays import Float, Int


@dataclass(frozen=True, eq=False)
class Patches:
    """Groups of parts whose unknowns are solved for together; they may overlap.

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
    """A level to be smoothed.

    Attributes
    ----------
    A : (n, n) sparse
        Its matrix.
    inherited : (n, n) sparse
        Pᵀ A P down from the finest level; A itself where levels are not rediscretised.
    block_offsets : (parts + 1,) int
        The unknowns of part p are ``block_offsets[p]:block_offsets[p + 1]``.
    labels : (n_cells,) int
        Part of this level that holds each cell of the mesh.
    P : (n, m) sparse
        Prolongation from the next coarser level.
    coarse : callable, optional
        Maps a residual ``(n,)`` to the correction ``(n,)`` by the next level; None if there is to be none.
    steps : int
        Smoothing steps asked for in one application.
    patches : Patches, optional
        Groups of parts that meet at a vertex; None without a mesh.

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
    """A level, and the agglomerates that are to be the parts of the next coarser one.

    Attributes
    ----------
    A : (n, n) sparse
        Matrix of the level, in blocks (``bsr_array``) where all parts have the same number of unknowns.
    block_offsets : (parts + 1,) int
        The unknowns of part p are ``block_offsets[p]:block_offsets[p + 1]``.
    labels, coarse_labels : (n_cells,) int
        Part of the level, and of the next coarser one, that holds each cell of the mesh.
    parents : (parts,) int, optional
        Coarse part of each part; None where a part lies in several.
    near_null : (n, k) float, optional
        Vectors that A takes to nearly nothing, if any are known.
    injected : (n, m) sparse, optional
        The functions of the coarse space as they are on the finer level, or their L2 projections; None where
        the method has no coarse space of its own.
    rediscretised : callable, optional
        Makes the matrix ``(m, m)`` of the problem on the coarse parts; None where there is no discretisation.

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
    """What a transfer may return in place of P alone, where P does not say all.

    Attributes
    ----------
    P : (n, m) sparse
        Prolongation.
    block_offsets : (parts + 1,) int, optional
        The unknowns of each coarse part; by default all have the same number.
    near_null : (m, k) float, optional
        Near-null vectors of the coarse level, handed on to its own transfer.

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
    """Unknowns and matrix entries of each level, printed as a table.

    Parameters
    ----------
    unknowns, entries : sequence of int
        Of each level, finest first.
    smoothers : sequence of str, optional
        What smooths each level, and what solves on the coarsest.

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
