"""Classical algebraic multigrid: some unknowns become coarse unknowns, the others interpolate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from agglo_core.arrays import Float, Int, Mask, frozen, frozen_int
from agglo_core.errors import OptionError
from agglo_core.multigrid.coarsening.aggregation import aggregation_stack, check_labels
from agglo_core.multigrid.coarsening.near_null import smoothed_near_null
from agglo_core.multigrid.coarsening.strong_groups import group_smoother
from agglo_core.multigrid.kernels.coarse_points import (
    classical_weights,
    coarse_first,
    coarse_points,
    strong_entries,
)
from agglo_core.multigrid.matrices.checks import canonical, check_system
from agglo_core.multigrid.matrices.galerkin import csr_galerkin, product_entries
from agglo_core.multigrid.smoothers.scalar_gauss_seidel import ScalarGaussSeidel
from agglo_core.multigrid.stack import Level, LevelStack, Real

_NEEDLESS = 0.1
"""An unknown with a coupling sum of at most this fraction of its diagonal entry needs no coarse level.

Larger: smaller coarse matrices, but more error is left to the smoother (benchmarks/linear.py).
"""
_SLOW = 0.9
"""Maximum fraction of unknowns kept on the coarse level. Above, smoothed aggregation continues."""
_FULL = 2.5
"""Maximum entries of a coarse matrix relative to the next finer matrix and to A.

Above, smoothed aggregation continues. Larger: fewer iterations, but more memory and time per iteration.
Benchmark: benchmarks/constants.py.
"""
_NEGATIVE = 0.1
"""A row is negative if its sum is below minus this fraction of its diagonal entry.
Benchmark: benchmarks/constants.py."""
_MANY = 0.01
"""Fraction of negative rows above which constants are not near-null, and are smoothed first.
Benchmark: benchmarks/constants.py."""


def classical_stack(
    A: Any,
    *,
    labels: Sequence[ArrayLike] | None = None,
    near_null: ArrayLike | None = None,
    guide: Any = None,
    theta: float = 0.25,
    dtype: Any = np.float64,
    coarsest: int = 500,
    groups: int = 1,
) -> LevelStack:
    """Build levels of classical coarsening for a scalar symmetric positive (semi)definite matrix.

    Classical levels need fewer iterations than smoothed aggregation, especially for jumping coefficients or
    anisotropy, but more entries: two to three times those of A. Couplings should be negative entries, with
    few positive exceptions.

    Parameters
    ----------
    A : (n, n) sparse
    labels : sequence of (n,) int, optional
        Agglomerates, finest first, as in ``Hierarchy.levels``. After one classical step, the coarse unknowns
        are aggregated by labels as in :func:`aggregation_stack`. With a guide, classical steps continue until
        no more unknowns are left than the finest agglomerates. By default all levels are classical.
    near_null : (n,) or (n, 1) float, optional
        Near-null vector with positive entries. Default: ones, or Gauss–Seidel applied to ones if these
        are not near-null, as after scaling the unknowns. The levels then belong to the matrix scaled
        by this vector, with ``scaling`` in the stack.
    guide : (n, n) sparse, optional
        Symmetric matrix with equivalent energy, and with negative couplings where those of A are
        positive. It determines coarse unknowns and interpolation instead of A. Level matrices remain
        Galerkin products of A.
    theta : float
        Unknown i depends on j if −a_ij ≥ θ max_k −a_ik, with θ between 0 and 1. In rows with positive
        couplings of that size θ is at least ½.
    dtype : numpy dtype
        Precision of the cycles. Levels are built in double precision.
    coarsest : int
        Maximum number of unknowns to be solved directly.
    groups : int
        With more than 1, up to this number of unknowns joined by strong couplings of either sign are
        smoothed together (:func:`~agglo_core.multigrid.coarsening.strong_groups.group_smoother`), which
        compensates for poor interpolation weights.

    Raises
    ------
    OptionError
        For arrays that do not fit the matrix, or entries of the diagonal or of ``near_null`` that are not
        positive.
    LinAlgError
        If the matrix is indefinite on a group.

    Notes
    -----
    Ruge, Stüben, Algebraic multigrid (in McCormick, Multigrid methods, 1987), with the second pass: unknowns
    that depend on each other also depend on a common coarse unknown. Gauss–Seidel treats coarse unknowns
    first, and mirrors this order after the correction (:class:`CoarseFirst`): these sweeps are worth nearly
    twice as many in matrix order. Where a level would keep too many unknowns, smoothed aggregation continues.

    Examples
    --------
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import classical_stack
    >>> A = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(1000, 1000))
    >>> [level.A.shape[0] for level in classical_stack(A, coarsest=200).levels]
    [1000, 500, 250, 125]
    """
    matrix, _, vectors = check_system(A, 1, near_null)
    # 1. Scale the matrix by the near-null vector.
    scale = _scale(matrix, None if near_null is None else vectors)
    D = None if scale is None else sparse.diags_array(scale)
    matrix = matrix if D is None else canonical(D @ matrix @ D)
    if guide is not None:
        guide, *_ = check_system(guide, 1, None)
        if guide.shape != matrix.shape:
            raise OptionError(f"guide has shape {guide.shape}; expected that of A, {matrix.shape}")
        guide = guide if D is None else canonical(D @ guide @ D)
    # 2. Classical steps, until small enough or no longer efficient.
    level_labels = check_labels(labels, matrix.shape[0])
    if not 0.0 < theta <= 1.0:
        raise OptionError(f"theta must be between 0 and 1; given {theta!r}")
    levels: list[Level] = []
    finest = matrix.nnz
    first = _agglomerates(level_labels[:1]) if guide is not None else matrix.shape[0]
    while matrix.shape[0] > coarsest and not (levels and level_labels and matrix.shape[0] <= first):
        P, stays = _interpolation(matrix if guide is None else guide, theta)
        if stays.sum() > _SLOW * len(stays):
            break
        if product_entries(matrix, P) > _FULL * min(finest, matrix.nnz):
            break
        coarse_matrix = csr_galerkin(matrix, P)
        unit_offsets = frozen_int(np.arange(len(stays) + 1))
        smoother = CoarseFirst(matrix, stays, dtype) if groups == 1 else group_smoother(matrix, groups, dtype)
        levels.append(Level(matrix.astype(dtype), unit_offsets, P.astype(dtype), smoother))
        if not (coarse_matrix.diagonal() > 0.0).all():
            raise np.linalg.LinAlgError(
                "a coarse matrix is not positive definite: A is not positive definite either, or only barely"
            )
        matrix, level_labels = coarse_matrix, [each[stays] for each in level_labels]
        guide = None if guide is None else csr_galerkin(guide, P)
    # 3. Smoothed aggregation for the rest.
    if guide is not None:
        level_labels = [each for each in level_labels if _agglomerates([each]) < matrix.shape[0]]
    tail = aggregation_stack(matrix, labels=level_labels or None, dtype=dtype, coarsest=coarsest)
    unlabelled = [Level(each.A, each.block_offsets, each.P, each.smoother) for each in tail.levels]
    return LevelStack([*levels, *unlabelled], tail.coarse, dtype, None if D is None else sparse.csr_array(D))


class CoarseFirst:
    """Gauss–Seidel on coarse unknowns, then on the others, in mirrored order after the coarse correction.

    Parameters
    ----------
    A : (n, n) sparse
        Symmetric matrix with positive diagonal and sorted columns.
    stays : (n,) bool
    dtype : numpy dtype
        Precision of the sweeps: float32 or float64.

    Examples
    --------
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import CoarseFirst
    >>> A = sparse.csr_array([[2.0, -1.0], [-1.0, 2.0]])
    >>> CoarseFirst(A, np.array([False, True])).before(np.array([0.0, 2.0]))
    (array([0.5, 1. ]), array([0. , 0.5]))
    """

    def __init__(self, A: Any, stays: Mask, dtype: Any = np.float64) -> None:
        self._order = np.concatenate((np.flatnonzero(stays), np.flatnonzero(~stays)))
        self._place = np.empty_like(self._order)
        self._place[self._order] = np.arange(len(stays))
        parts = (frozen(each, each.dtype) for each in (A.indptr, A.indices, A.data))
        indptr, indices, data = coarse_first(*parts, frozen(stays, np.bool_), frozen(self._place, np.int32))
        self._sweeps = ScalarGaussSeidel(sparse.csr_array((data, indices, indptr), shape=A.shape), dtype)

    def before(self, b: Real) -> tuple[Real, Real]:
        """Return x ``(n,)`` after a sweep from x = 0, and the residual b − A x."""
        x, r = self._sweeps.before(b[self._order])
        return x[self._place], r[self._place]

    def after(self, b: Real, x: Real) -> Real:
        """Return x after a sweep in the opposite order."""
        return self._sweeps.after(b[self._order], x[self._order])[self._place]


def _agglomerates(labels: Sequence[Int]) -> int:
    """Return the largest number of distinct labels in an array of ``labels``, or 0 without arrays."""
    return max((len(np.unique(each)) for each in labels), default=0)


def _scale(A: Any, near_null: Float | None) -> Float | None:
    """Return the near-null vector ``(n,)`` by which the matrix is scaled, or None for a constant vector."""
    if near_null is None:
        negative = A.sum(axis=1) < -_NEGATIVE * A.diagonal()
        if negative.sum() <= _MANY * len(negative):
            return None
        ones = np.ones((len(negative), 1))
        near_null = smoothed_near_null(A, np.arange(len(negative) + 1), ones)
        if not (near_null > 0.0).all():  # mixed signs of couplings: ones are as good
            return None
    if near_null.shape[1] != 1 or not (near_null > 0.0).all():
        raise OptionError("classical coarsening requires one near-null vector with positive entries")
    return None if np.ptp(near_null) == 0.0 else near_null[:, 0]


def _interpolation(A: Any, theta: float) -> tuple[Any, Mask]:
    """Return the prolongation P, and a mask of the coarse unknowns, at least one."""
    pattern = (A.indptr, A.indices)
    strong, needy = strong_entries(*pattern, A.data, theta, _NEEDLESS)
    stays = coarse_points(*pattern, strong, needy)
    stays[0] |= not stays.any()
    number = np.cumsum(stays, dtype=np.int32) - np.int32(1)
    graph, to, weight = classical_weights(*pattern, A.data, strong, stays, number)
    return sparse.csr_array((weight, to, graph), shape=(len(stays), int(stays.sum()))), stays
