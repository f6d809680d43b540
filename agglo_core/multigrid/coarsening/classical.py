"""Classical algebraic multigrid: some unknowns stay on the coarse level, the others interpolate from them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from agglo_core.arrays import Float, Int, Mask, frozen, frozen_int
from agglo_core.errors import OptionError
from agglo_core.multigrid.coarsening.aggregation import aggregation_stack, checked_labels
from agglo_core.multigrid.coarsening.near_null import smoothed_near_null
from agglo_core.multigrid.coarsening.strong_groups import group_smoother
from agglo_core.multigrid.kernels.coarse_points import (
    classical_weights,
    coarse_first,
    coarse_points,
    strong_entries,
)
from agglo_core.multigrid.matrices.checks import canonical, checked_system
from agglo_core.multigrid.matrices.galerkin import csr_galerkin, product_entries
from agglo_core.multigrid.smoothers.scalar_gauss_seidel import ScalarGaussSeidel
from agglo_core.multigrid.stack import Level, LevelStack, Real

_NEEDLESS = 0.1
"""An unknown whose couplings add up to this part of its diagonal entry needs no coarse level."""
_SLOW = 0.9
"""A level that keeps more of the unknowns than this is not worth having."""
_FULL = 2.5
"""Nor is one whose matrix has so many times the entries of the level above or of A."""
_NEGATIVE = 0.1
"""A row is negative if it adds up to less than minus this part of its diagonal entry."""
_MANY = 0.01
"""With more negative rows than this part, A does not take constants to nearly nothing."""


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
    """Levels of classical coarsening for a scalar symmetric positive (semi)definite matrix.

    They need fewer iterations than smoothed aggregation, most of all where coefficients jump or directions
    differ, and hold more entries: two to three times those of A. Couplings should be negative entries; some
    positive ones do no harm.

    Parameters
    ----------
    A : (n, n) sparse
    labels : sequence of (n,) int, optional
        Agglomerates, finest first, as in ``Hierarchy.levels``. After one classical step the unknowns that
        stay are aggregated by these, as :func:`aggregation_stack` does; with a guide, after as many as leave
        no more unknowns than the first has agglomerates. By default all levels are classical.
    near_null : (n,) or (n, 1) float, optional
        A vector that A takes to nearly nothing, of positive entries. By default ones; where they are not
        such a vector, as after a scaling of the unknowns, what Gauss–Seidel leaves of them. The levels are
        then those of the matrix scaled by it, and the stack has the ``scaling``.
    guide : (n, n) sparse, optional
        A symmetric matrix of the same energy, within factors, whose couplings are negative where those of A
        are not: it says in place of A which unknowns stay and how the others interpolate. Matrices of levels
        are Galerkin products of A all the same.
    theta : float
        Unknown i depends on j if −a_ij ≥ θ max_k −a_ik; between 0 and 1.
    dtype : numpy dtype
        Precision of the cycles; levels are set up in double precision.
    coarsest : int
        A level of at most so many unknowns is solved directly.
    groups : int
        With more than 1, up to so many unknowns that strong couplings of either sign join are smoothed
        together (:func:`~agglo_core.multigrid.coarsening.strong_groups.group_smoother`): they make up for
        weights of interpolation that serve badly.

    Raises
    ------
    OptionError
        For arrays that do not fit the matrix, and entries of the diagonal or of ``near_null`` that are not
        positive.
    LinAlgError
        If the matrix is indefinite on a group.

    Notes
    -----
    Ruge, Stüben, Algebraic multigrid (in McCormick, Multigrid methods, 1987), with the second pass, by which
    unknowns that depend on each other also depend on a common one that stays. Gauss–Seidel takes the
    unknowns that stay first and mirrors that after the correction (:class:`CoarseFirst`): a sweep each is
    then worth nearly two in the order of the matrix. Where a level would keep too much, smoothed aggregation
    goes on from there.

    Examples
    --------
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import classical_stack
    >>> A = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(1000, 1000))
    >>> [level.A.shape[0] for level in classical_stack(A, coarsest=200).levels]
    [1000, 500, 250, 125]
    """
    matrix, _, vectors = checked_system(A, None, near_null)
    scale = _scale(matrix, None if near_null is None else vectors)
    D = None if scale is None else sparse.diags_array(scale)
    matrix = matrix if D is None else canonical(D @ matrix @ D)
    if guide is not None:
        guide, *_ = checked_system(guide, None, None)
        if guide.shape != matrix.shape:
            raise OptionError(f"guide has shape {guide.shape}; expected that of A, {matrix.shape}")
        guide = guide if D is None else canonical(D @ guide @ D)
    given = checked_labels(labels, matrix.shape[0])
    if not 0.0 < theta <= 1.0:
        raise OptionError(f"theta must be between 0 and 1; given {theta!r}")
    levels: list[Level] = []
    finest = matrix.nnz
    first = _agglomerates(given[:1]) if guide is not None else matrix.shape[0]
    while matrix.shape[0] > coarsest and not (levels and given and matrix.shape[0] <= first):
        P, stays = _interpolation(matrix if guide is None else guide, theta)
        if stays.sum() > _SLOW * len(stays):
            break
        if product_entries(matrix, P) > _FULL * min(finest, matrix.nnz):
            break
        below = csr_galerkin(matrix, P)
        own = frozen_int(np.arange(len(stays) + 1))
        smoother = CoarseFirst(matrix, stays, dtype) if groups == 1 else group_smoother(matrix, groups, dtype)
        levels.append(Level(matrix.astype(dtype), own, P.astype(dtype), smoother))
        if not (below.diagonal() > 0.0).all():
            raise np.linalg.LinAlgError("a coarse matrix is not positive definite: nor is A, or not by much")
        matrix, given = below, [each[stays] for each in given]
        guide = None if guide is None else csr_galerkin(guide, P)
    if guide is not None:
        given = [each for each in given if _agglomerates([each]) < matrix.shape[0]]
    rest = aggregation_stack(matrix, labels=given or None, dtype=dtype, coarsest=coarsest)
    unlabelled = [Level(each.A, each.block_offsets, each.P, each.smoother) for each in rest.levels]
    return LevelStack([*levels, *unlabelled], rest.coarse, dtype, None if D is None else sparse.csr_array(D))


class CoarseFirst:
    """Gauss–Seidel on the unknowns that stay on the coarse level, then on the others; and the mirror image.

    Parameters
    ----------
    A : (n, n) sparse
        Symmetric, of positive diagonal, its columns sorted.
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
        """Return x ``(n,)``, by a sweep from 0, and b − A x."""
        x, r = self._sweeps.before(b[self._order])
        return x[self._place], r[self._place]

    def after(self, b: Real, x: Real) -> Real:
        """Return x after the sweep in the opposite order."""
        return self._sweeps.after(b[self._order], x[self._order])[self._place]


def _agglomerates(labels: Sequence[Int]) -> int:
    """How many agglomerates labels have, 0 if there are none."""
    return max((len(np.unique(each)) for each in labels), default=0)


def _scale(A: Any, near_null: Float | None) -> Float | None:
    """The near-null vector ``(n,)``; None for constants."""
    if near_null is None:
        negative = A.sum(axis=1) < -_NEGATIVE * A.diagonal()
        if negative.sum() <= _MANY * len(negative):
            return None
        ones = np.ones((len(negative), 1))
        near_null = smoothed_near_null(A, np.arange(len(negative) + 1), ones)
        if not (near_null > 0.0).all():  # couplings of both signs: ones are as good
            return None
    if near_null.shape[1] != 1 or not (near_null > 0.0).all():
        raise OptionError("classical coarsening takes one near-null vector, of positive entries")
    return None if np.ptp(near_null) == 0.0 else near_null[:, 0]


def _interpolation(A: Any, theta: float) -> tuple[Any, Mask]:
    """P, and which unknowns stay: at least one."""
    pattern = (A.indptr, A.indices)
    strong, needy = strong_entries(*pattern, A.data, theta, _NEEDLESS)
    stays = coarse_points(*pattern, strong, needy)
    stays[0] |= not stays.any()
    number = np.cumsum(stays, dtype=np.int32) - np.int32(1)
    graph, to, weight = classical_weights(*pattern, A.data, strong, stays, number)
    return sparse.csr_array((weight, to, graph), shape=(len(stays), int(stays.sum()))), stays
