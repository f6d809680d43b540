"""Smoothed aggregation: levels from the matrix graph, or from agglomerates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Int, frozen_int
from agglo_core.errors import OptionError
from agglo_core.multigrid.coarse_solve import direct_solver
from agglo_core.multigrid.coarsening.prolongation import Couplings, smooth_tentative, tentative
from agglo_core.multigrid.kernels.aggregates import greedy_aggregates, split_labels
from agglo_core.multigrid.matrices.checks import check_system
from agglo_core.multigrid.matrices.galerkin import csr_galerkin, product_entries
from agglo_core.multigrid.smoothers.level_smoothers import GaussSeidel
from agglo_core.multigrid.smoothers.scalar_gauss_seidel import ScalarGaussSeidel
from agglo_core.multigrid.stack import Level, LevelSmoother, LevelStack
from agglo_core.problems import MultigridLevel

MakeSmoother = Callable[[Any, Int, Any], LevelSmoother]
"""Builds a level smoother from matrix, block offsets and precision."""

_LEAST_NEIGHBOURS = 6.0
"""Minimum number of neighbours per part for the coupling strength, used on sparser graphs.

Larger: more couplings of sparse graphs are strong (benchmarks/linear.py).
"""
_LENIENT = 0.25
"""Labels are split at couplings below this fraction of a strong coupling: at jumps, not at thin faces.

Larger: more pieces (benchmarks/linear.py, column ``labels``).
"""
_PIECES = 2.0
"""Mean number of pieces per label above which labels do not suit the matrix, and its graph replaces them.

Larger: labels are kept although jumps divide more of them (benchmarks/linear.py, column ``labels``).
"""
_NEEDLESS = 0.1
"""A part with a coupling sum of at most this fraction of its size needs no coarse unknown.

Larger: smaller coarse matrices, but more error is left to the smoother.
"""
_HALVED = 0.5
"""Fraction for single unknowns: a sweep at least halves their error (as at Dirichlet boundaries).

Larger: fewer coarse unknowns (benchmarks/linear.py).
"""
_SLOW = 0.7
"""Maximum number of aggregates, relative to the number of parts, for a worthwhile level.

Smaller: weak couplings join parts more often (benchmarks/linear.py).
"""
_FULL = 2.5
"""Smoothing is omitted if the coarse matrix would have more entries than this times A, or its level.

Larger: fewer iterations, but more memory and time per iteration.
"""


def pointwise(A: Any, block_offsets: Int, dtype: Any) -> LevelSmoother:
    """Return a Gauss–Seidel smoother over single unknowns, whatever the division into parts.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.csr_array(2.0 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    >>> from agglo_core.multigrid import pointwise
    >>> x, residual = pointwise(A, np.arange(7), np.float64).before(np.ones(6))
    >>> bool(np.allclose(residual, 1.0 - A @ x))
    True
    """
    return ScalarGaussSeidel(A, dtype)


def blockwise(A: Any, block_offsets: Int, dtype: Any) -> LevelSmoother:
    """Return a block Gauss–Seidel smoother, or raise LinAlgError if a diagonal block is not definite.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.csr_array(2.0 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    >>> from agglo_core.multigrid import blockwise
    >>> x, residual = blockwise(A, np.array([0, 3, 6]), np.float64).before(np.ones(6))
    >>> bool(np.allclose(residual[3:], 0.0))  # the last part was solved for last
    True
    """
    parts = len(block_offsets) - 1
    if A.shape[0] == parts:
        return ScalarGaussSeidel(A, dtype)
    own = frozen_int(np.arange(parts))
    return GaussSeidel().setup(MultigridLevel(A, A, block_offsets, own, None, None, 1), dtype)


def aggregation_stack(
    A: Any,
    *,
    labels: Sequence[ArrayLike] | None = None,
    near_null: ArrayLike | None = None,
    block_offsets: ArrayLike | None = None,
    theta: float = 0.9,
    weak: float = 0.01,
    dtype: Any = np.float64,
    smoother: MakeSmoother = pointwise,
    coarsest: int = 500,
    visits: int = 1,
) -> LevelStack:
    """Build smoothed-aggregation levels for a symmetric positive (semi)definite matrix.

    Parameters
    ----------
    A : (n, n) sparse
        Scalar matrix, or matrix with several unknowns per part.
    labels : sequence of (parts,) int, optional
        Agglomerates, finest first, as in ``Hierarchy.levels``: each array has the label of each part *of
        A*, whatever the level. Aggregates are these labels, split where strong couplings do not connect
        them. Further levels, and by default all levels, come from the matrix graph. So do levels with
        labels in more than two pieces on average, as for a coefficient that jumps from cell to cell.
    near_null : (n, k) or (n,) float, optional
        Near-null vectors of A. Default: constants, one vector per unknown of a part.
    block_offsets : (parts + 1,) int or int, optional
        Part p has the unknowns ``block_offsets[p]:block_offsets[p + 1]``. A whole number is the size of all
        parts. Default: the blocks of a BSR matrix, else single unknowns.
    theta : float
        A coupling between parts i and j is strong if above θ times the value of ν equal couplings:
        −a_ij > θ max(a_ii, a_jj) / ν, with the mean number ν of neighbours, at least 6. Blocks are
        measured in the Frobenius norm. With one near-null vector v and single unknowns, a_ij is the entry
        of diag(v) A diag(v), so that no scaling of the unknowns matters.
    weak : float
        Couplings up to this fraction of the diagonal are omitted from prolongation smoothing.
    dtype : numpy dtype
        Precision of the cycles. Levels are built in double precision.
    smoother : callable, optional
        Function of ``(A, block_offsets, dtype)`` that returns a LevelSmoother. Default: Gauss–Seidel over
        unknowns, :func:`pointwise`. For parts with several unknowns :func:`blockwise` is better.
    coarsest : int
        Maximum number of unknowns to be solved directly.
    visits : int
        Number of visits of each level. From 2 on, matrices of the levels and the direct solver have double
        precision: between two visits single precision would lose errors with little energy, such as bending.

    Raises
    ------
    OptionError
        For arrays that do not fit the matrix, or a diagonal that is not positive.

    Notes
    -----
    If smoothing would fill the coarse matrix, as on graphs with nodes that have thousands of neighbours, the
    level uses the tentative prolongation, and the coarse matrix has no more entries than the finer matrix.

    Vaněk, Mandel, Brezina, Computing 56 (1996). Strength is measured against the *larger* diagonal entry, in
    the spirit of the aggregate quality by Napov and Notay (SIAM J. Sci. Comput. 34, 2012): two weakly joined
    parts with large diagonals must not share an unknown, since a jump between them has little energy and is
    not removed by smoothing. A part with small diagonal may lean on a part with large diagonal.

    Examples
    --------
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import aggregation_stack
    >>> A = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(1000, 1000))
    >>> [level.A.shape[0] for level in aggregation_stack(A, coarsest=200).levels]
    [1000, 333, 111]
    """
    matrix, offsets, B = check_system(A, block_offsets, near_null)
    level_labels = check_labels(labels, len(offsets) - 1)
    if not theta >= 0.0:
        raise OptionError(f"theta must be 0 or more; given {theta!r}")
    levels: list[Level] = []
    holder = np.arange(len(offsets) - 1)
    finest = matrix.nnz
    while matrix.shape[0] > coarsest:
        # 1. Coupling strength, and the aggregates of the level.
        part_of = frozen_int(np.repeat(np.arange(len(offsets) - 1), np.diff(offsets)))
        strength, scalar = Couplings.of(matrix, offsets, part_of), matrix.shape[0] == len(offsets) - 1
        if scalar and B.shape[1] == 1:
            strength = strength.scaled(B[:, 0])
        current_labels = (
            _current_labels(level_labels[len(levels)], holder, len(offsets) - 1)
            if len(levels) < len(level_labels)
            else None
        )
        aggregate_of, count = aggregates(strength, theta, current_labels, _HALVED if scalar else _NEEDLESS)
        if count > 0.9 * len(aggregate_of):
            break
        # 2. Tentative prolongation, smoothed unless the coarse matrix would fill.
        start = tentative(aggregate_of[part_of], count, B)
        P = smooth_tentative(matrix, offsets, part_of, strength, start, B, weak)
        if product_entries(matrix, P) > _FULL * min(finest, matrix.nnz):
            P = start.T
        # 3. Store the level and continue with the coarse matrix.
        levels.append(
            _level(matrix, offsets, dtype, holder, visits, P.astype(dtype), smoother(matrix, offsets, dtype))
        )
        holder = np.where(holder >= 0, aggregate_of[holder], -1)
        matrix, offsets, B = csr_galerkin(matrix, P), start.offsets, start.near_null
    levels.append(_level(matrix, offsets, dtype, holder, visits))
    return LevelStack(levels, direct_solver(matrix, dtype if visits == 1 else np.float64), dtype)


def aggregates(
    strength: Couplings, theta: float, labels: Int | None = None, needless: float = _NEEDLESS
) -> tuple[Int, int]:
    """Return the aggregate per part (−1 for none), and the aggregate count.

    Parts with a coupling sum of at most ``needless`` times their size belong to no aggregate.

    Given labels are split by strength. If this leaves too many pieces, aggregates come from the graph. If
    these are too many, every attractive coupling counts as strong.
    """
    n = len(strength.size)
    least = theta / max(strength.neighbours, _LEAST_NEIGHBOURS)
    aggregate_of, count = np.empty(0, np.int64), n
    if labels is not None:
        aggregate_of, count = split_labels(*strength, _LENIENT * least, frozen_int(labels))
        if count > _PIECES * len(np.unique(labels)):
            count = n
    for threshold in (least, 0.0):
        if count > _SLOW * n:
            aggregate_of, count = greedy_aggregates(*strength, threshold, needless)
        if count == 0:  # no part needs a coarse unknown: use a single aggregate
            return np.zeros(n, np.int64), 1
    return frozen_int(aggregate_of), int(count)


def _level(
    A: Any,
    offsets: Int,
    dtype: Any,
    holder: Int,
    visits: int,
    P: Any = None,
    smoother: LevelSmoother | None = None,
) -> Level:
    if visits == 1 and isinstance(smoother, ScalarGaussSeidel):
        return Level(smoother.matrix, offsets, P, smoother, frozen_int(holder))  # shares the matrix
    A = A.astype(dtype) if visits == 1 else A
    return Level(A, offsets, P, smoother, frozen_int(holder), visits=visits)


def _current_labels(labels: Int, holder: Int, parts: int) -> Int:
    """Return the label per part on a level, from the first part of A inside it."""
    inside = np.flatnonzero(holder >= 0)[::-1]
    found = np.zeros(parts, np.int64)
    found[holder[inside]] = labels[inside]
    return found


def check_labels(labels: Sequence[ArrayLike] | None, parts: int) -> list[Int]:
    """Return the labels per level, or raise OptionError unless each array has one label per part."""
    arrays = [frozen_int(array) for array in labels or ()]
    for k, array in enumerate(arrays):
        if array.shape != (parts,):
            raise OptionError(f"labels[{k}] has shape {array.shape}; expected ({parts},), one per part of A")
    return arrays
