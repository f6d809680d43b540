"""Levels along a flow, for matrices that need not be symmetric, as those of convection."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, Int, frozen_float, frozen_index, frozen_int
from agglo_core.multigrid.coarse_solve import lu_solve
from agglo_core.multigrid.coarsening.transfers import parents
from agglo_core.multigrid.kernels.aggregates import local_bases
from agglo_core.multigrid.kernels.flow_order import flow_order
from agglo_core.multigrid.smoothers.ordered import OrderedGaussSeidel
from agglo_core.multigrid.smoothers.patches import joined_patches
from agglo_core.multigrid.stack import Level, LevelStack
from agglo_core.problems import Patches, System

_FEWEST = 60  # parts that need no coarser level, as in `default_levels`
_FACTORISED = 2_000
"""Unknowns of the coarsest level. More: fewer iterations, and more memory of factors
(benchmarks/nonsymmetric.py)."""


def paired_levels(ends: Int, strength: Float, n: int, fewest: int, count: int | None = None) -> list[Int]:
    """Return the aggregate of each part ``(n,)`` on the coarse levels, finest first.

    Strongly coupled parts are paired, and the pairs paired again unless few enough: aggregates follow the
    flow where it dominates. Across closed streamlines a solution varies by diffusion alone, and wide
    aggregates would not resolve it.

    Parameters
    ----------
    ends : (m, 2) int
        Coupled parts.
    strength : (m,) float
        Strength of each coupling. Couplings between the same two aggregates are added.
    n : int
        Number of parts.
    fewest : int
        Number of aggregates that ends the coarsening, after at least one level if there are more than 60
        parts.
    count : int, optional
        Number of levels, counting the finest, as long as there are more than 60 aggregates.

    Examples
    --------
    >>> from agglo_core.multigrid.coarsening.along_flow import paired_levels
    >>> mesh = agglo.samples.squares(9)
    >>> inner = mesh.face_cells[mesh.face_cells[:, 1] >= 0]
    >>> [len(set(labels.tolist())) for labels in paired_levels(inner, np.ones(len(inner)), 81, 30)]
    [21]
    """
    labels, levels = np.arange(n), list[Int]()
    while n > _FEWEST and (n > fewest or not levels or count is not None) and len(levels) + 1 != count:
        for _ in range(2):
            # Pairs of parts by descending coupling
            sides = np.sort(labels[ends], axis=1).T
            sums = sparse.csr_array((strength, sides), shape=(n, n)).tocoo()
            pairs = np.stack(sums.coords, axis=1)[np.argsort(-sums.data, kind="stable")]
            pairs = pairs[pairs[:, 0] != pairs[:, 1]]
            groups = joined_patches(frozen_int(pairs), n, most=2)
            merged = np.empty(n, np.int64)
            merged[groups.parts] = np.repeat(np.arange(len(groups)), np.diff(groups.offsets))
            labels, n = merged[labels], len(groups)
            if n <= fewest:
                break
        if levels and n == levels[-1].max() + 1:  # parts without neighbours
            break
        levels.append(frozen_int(labels))
    return levels


def downstream_order(flows: Any) -> Int:
    """Return the parts ``(n,)`` sorted along the flow, so that each follows those from which it has inflow.

    Where the flow is closed, the next part is the one with the least inflow from later parts, relative to
    its whole inflow.

    Parameters
    ----------
    flows : (n, n) sparse
        Positive flow from the part of the row into the part of the column.

    Examples
    --------
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import downstream_order
    >>> downstream_order(sparse.csr_array([[0.0, 0.0, 1.0], [2.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    array([1, 0, 2])
    """
    flows = sparse.csr_array(flows)
    return frozen_int(flow_order(*map(frozen_index, (flows.indptr, flows.indices)), frozen_float(flows.data)))


def flow_stack(system: System) -> LevelStack:
    """Build the levels of a linear system whose matrix need not be symmetric.

    Aggregates are pairs of pairs of strongly coupled blocks. They carry the near-null vectors, by default
    constants, without smoothing: coarse matrices remain those of upwind schemes. Block Gauss–Seidel passes
    the blocks of every level along the flow, which are the differences between A and its transpose. Unknowns
    of unequal blocks are treated as single unknowns.

    Raises
    ------
    LinAlgError
        If a diagonal block or the coarsest matrix is singular.

    Notes
    -----
    Y. Notay, SIAM J. Sci. Comput. 34, 2012, without the K-cycle.

    Examples
    --------
    >>> from agglo_core.multigrid.coarsening.along_flow import flow_stack
    >>> from agglo_core.problems import System
    >>> upwind = sparse.diags_array([-1.0, 1.1], offsets=[-1, 0], shape=(3000, 3000))
    >>> flow_stack(System(upwind, np.ones(3000), symmetric=False))
    level  unknowns  entries  smoother
        0      3000     5999  OrderedGaussSeidel
        1      1500     2999  direct
    """
    width = system.width or 1
    A = sparse.bsr_array(system.A, blocksize=(width, width))
    near_null = system.near_null
    if near_null is None:
        near_null = frozen_float(np.tile(np.eye(width), (system.n // width, 1)))
    # 1. Aggregates of blocks by the couplings in both directions
    sizes = _block_norms(A)
    both = (sizes + sizes.T).tocoo()
    upper = both.coords[0] < both.coords[1]
    ends, strength = np.stack(both.coords, axis=1)[upper], both.data[upper]
    k, levels, finer = near_null.shape[1], list[Level](), np.arange(sizes.shape[0])
    for labels in paired_levels(frozen_int(ends), frozen_float(strength), sizes.shape[0], _FACTORISED // k):
        # 2. Smoother along the flow
        n_parts, width = A.shape[0] // A.blocksize[0], A.blocksize[0]
        order = downstream_order(_positive(sizes.T - sizes))
        smoother = OrderedGaussSeidel(A, width, Patches(frozen_int(np.arange(n_parts + 1)), order))
        # 3. Prolongation and coarse matrix
        holder, count = parents(frozen_int(finer), labels), int(labels.max()) + 1
        assert holder is not None  # aggregates are nested
        P, near_null, unused = _prolongation(np.repeat(holder, width), count, near_null)
        levels.append(Level(A, frozen_int(np.arange(n_parts + 1) * width), P, smoother))
        A = sparse.bsr_array(P.T @ A @ P + sparse.diags_array(unused), blocksize=(k, k))
        finer, sizes = labels, _block_norms(A)
    # 4. Coarsest level
    levels.append(Level(A, frozen_int(np.arange(0, A.shape[0] + 1, A.blocksize[0]))))
    return LevelStack(levels, lu_solve(A))


def _prolongation(holder: Int, count: int, near_null: Float) -> tuple[Any, Float, Float]:
    """Return orthonormal near-null vectors on aggregates as P ``(n, m)``, and those of the coarse level.

    Vectors that depend on others on an aggregate have zero columns, whose diagonal entries ``(m,)`` are 1.
    """
    n, k = near_null.shape
    starts = np.concatenate(([0], np.cumsum(np.bincount(holder, minlength=count))))
    Q, R, ranks = local_bases(frozen_int(starts), frozen_int(np.argsort(holder, kind="stable")), near_null)
    columns = holder[:, None] * k + np.arange(k)
    P = sparse.csr_array((Q.ravel(), columns.ravel(), np.arange(n + 1) * k), shape=(n, count * k))
    unused = np.arange(k) >= ranks[:, None]
    return P, frozen_float(R.reshape(-1, k)), frozen_float(unused.ravel())


def _block_norms(A: Any) -> Any:
    """Return the Frobenius norms of the off-diagonal blocks of a BSR matrix as CSR."""
    norms = np.sqrt(np.einsum("kij,kij->k", A.data, A.data))
    sizes = sparse.csr_array((norms, A.indices, A.indptr), shape=2 * (A.shape[0] // A.blocksize[0],))
    sizes = sizes - sparse.diags_array(sizes.diagonal())
    return _positive(sizes)


def _positive(A: Any) -> Any:
    """Return the positive entries of a sparse matrix as CSR."""
    A = sparse.csr_array(A)
    A.data = np.maximum(A.data, 0.0)
    A.eliminate_zeros()
    return A
