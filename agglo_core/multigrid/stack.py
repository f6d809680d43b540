"""Multigrid levels, ready for cycles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from agglo_core.arrays import FieldState, Int, frozen
from agglo_core.multigrid.kernels.column_blocks import column_products
from agglo_core.problems import Patches
from agglo_core.problems.multigrid_level import LevelTable

Real = NDArray[np.floating[Any]]
"""Vector in single or double precision."""

_UNROLLED = 6
"""Maximum block height with a separate kernel. Larger: more kernels to compile (benchmarks/solve.py)."""

Solve = Callable[[Real], Real]
"""Maps a right-hand side ``(n,)`` to a solution."""


class LevelSmoother(Protocol):
    """Smoother set up on a level: pre- and post-smoothing of a cycle.

    For a symmetric cycle, ``after`` must be the adjoint of ``before``: if before computes x = B b from 0,
    after computes x + Bᵀ (b − A x).

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.multigrid import LevelSmoother
    >>> class Richardson:
    ...     def __init__(self, A):
    ...         self.A = A
    ...
    ...     def before(self, b):
    ...         x = 0.25 * b
    ...         return x, b - self.A @ x
    ...
    ...     def after(self, b, x):
    ...         return x + 0.25 * (b - self.A @ x)
    >>> smoother: LevelSmoother = Richardson(np.diag([2.0, 4.0]))
    >>> smoother.before(np.ones(2))[1]
    array([0.5, 0. ])
    """

    def before(self, b: Real) -> tuple[Real, Real]:
        """Return x ``(n,)`` after smoothing from 0, and the residual b − A x."""
        ...

    def after(self, b: Real, x: Real) -> Real:
        """Return x after post-smoothing for A x = b.

        The given array may be modified.
        """
        ...


@dataclass(frozen=True, eq=False)
class Level(FieldState):
    """Multigrid level: its matrix and, except on the coarsest, the transfer to the next coarser level.

    Attributes
    ----------
    A : (n, n) sparse
    block_offsets : (parts + 1,) int
        Part p has the unknowns ``block_offsets[p]:block_offsets[p + 1]``.
    P : (n, m) sparse, optional
        Prolongation from the next coarser level.
    smoother : LevelSmoother, optional
    labels : (n_cells,) int, optional
        Part on this level for each mesh cell, if parts are agglomerates.
    patches : Patches, optional
        Groups of parts to be smoothed together.
    visits : int
        Number of visits for each visit of the next finer level, for any cycle. Residuals between visits
        have the precision of A.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.csr_array(2.0 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    >>> from agglo_core.multigrid import build_stack, cycle, pcg
    >>> P = sparse.csr_array(np.kron(np.eye(3), np.ones((2, 1))))
    >>> fine, coarse = build_stack(A, np.array([0, 2, 4, 6]), [P]).levels
    >>> fine.P.shape, coarse.P is None
    ((6, 3), True)
    """

    A: Any
    block_offsets: Int
    P: Any = None
    smoother: LevelSmoother | None = None
    labels: Int | None = None
    patches: Patches | None = None
    visits: int = 1

    @cached_property
    def PT(self) -> Any:
        """Pᵀ stored by rows, transposed once instead of in each cycle."""
        return sparse.csr_array(self.P.T)

    def restricted(self, r: Real) -> Real:
        """Return the restricted residual Pᵀ r ``(m,)``."""
        columns = self._columns
        if columns is None or r.dtype != self.P.dtype:
            return np.asarray(self.PT @ r)
        (restricted, _), arrays = columns
        found: Real = restricted(*arrays, frozen(r, r.dtype), self.P.shape[1])
        return found

    def prolonged(self, x: Real, y: Real) -> Real:
        """Return the corrected iterate x + P y ``(n,)`` as a new array, in the precision of x."""
        columns = self._columns
        if columns is None or not x.dtype == y.dtype == self.P.dtype:
            return np.asarray(x + self.P @ y, x.dtype)
        (_, prolonged), arrays = columns
        found: Real = prolonged(*arrays, frozen(x, x.dtype), frozen(y, y.dtype))
        return found

    @cached_property
    def _columns(self) -> tuple[Any, tuple[Any, ...]] | None:
        """Compiled products and arrays for a P in blocks of one column, or None for any other P."""
        P = self.P
        if P.format != "bsr" or P.blocksize[1] != 1 or P.indptr[-1] >= np.iinfo(np.int32).max:
            return None
        width = P.blocksize[0]
        arrays = (
            *(frozen(each, np.int32) for each in (P.indptr, P.indices)),
            frozen(P.data[:, :, 0], P.dtype),
        )
        return column_products(width if width <= _UNROLLED else 0), arrays


@dataclass(frozen=True, eq=False, repr=False)
class LevelStack:
    """Multigrid levels, finest first, with the coarsest-level solver.

    Attributes
    ----------
    levels : sequence of Level
    coarse : callable
        Solver for the last level.
    dtype : numpy dtype
        Precision of the vectors in a cycle: float32 or float64.
    scaling : (n, n) sparse, optional
        T, if the finest level matrix is T A Tᵀ. A cycle preconditions A itself.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.csr_array(2.0 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    >>> from agglo_core.multigrid import build_stack, cycle, pcg
    >>> P = sparse.csr_array(np.kron(np.eye(3), np.ones((2, 1))))
    >>> stack = build_stack(A, np.array([0, 2, 4, 6]), [P])
    >>> [level.A.shape for level in stack.levels]
    [(6, 6), (3, 3)]
    >>> pcg(A, np.ones(6), cycle(stack)).converged
    True
    """

    levels: Sequence[Level]
    coarse: Solve
    dtype: Any = np.float64
    scaling: Any = None

    @property
    def operators(self) -> list[tuple[Any, Any]]:
        """Pairs ``(A, P)`` per level, finest first, with P None on the coarsest level."""
        return [(level.A, level.P) for level in self.levels]

    @property
    def parts(self) -> tuple[int | None, ...]:
        """Agglomerate count per level, None for a level without labels."""
        return tuple(None if each.labels is None else int(each.labels.max()) + 1 for each in self.levels)

    @property
    def operator_complexity(self) -> float:
        """Matrix entries of all levels divided by those of the finest level."""
        entries = [level.A.nnz for level in self.levels]
        return float(sum(entries) / entries[0])

    @property
    def grid_complexity(self) -> float:
        """Unknowns of all levels divided by those of the finest level."""
        unknowns = [level.A.shape[0] for level in self.levels]
        return float(sum(unknowns) / unknowns[0])

    @property
    def table(self) -> LevelTable:
        """Table of unknowns, matrix entries and smoother per level."""
        smoothers = [level.smoother for level in self.levels]
        names = [type(each).__name__.lstrip("_") if each else "direct" for each in smoothers]
        matrices = [level.A for level in self.levels]
        return LevelTable([A.shape[0] for A in matrices], [A.nnz for A in matrices], names)

    def __repr__(self) -> str:
        return repr(self.table)

    @cached_property
    def memory(self) -> int:
        """Memory of matrices and smoothers in bytes, with each array counted once."""
        sizes: dict[int, int] = {}
        for level in self.levels:
            _weigh((level.A, level.P, level.smoother), sizes)
        return sum(sizes.values())


def _weigh(thing: Any, sizes: dict[int, int], depth: int = 4) -> None:
    """Record the size in bytes of each array in an object, to a small depth of attributes."""
    if isinstance(thing, np.ndarray):
        base = thing if thing.base is None else thing.base
        sizes[id(base)] = getattr(base, "nbytes", thing.nbytes)
    elif depth and isinstance(thing, list | tuple):
        for child in thing:
            _weigh(child, sizes, depth - 1)
    elif depth and isinstance(attributes := getattr(thing, "__dict__", None), dict):
        for child in attributes.values():
            _weigh(child, sizes, depth - 1)
