"""Transfers: prolongations from a coarse level to the next finer level."""

from __future__ import annotations

from typing import Any

import numpy as np

from agglo_core.arrays import Int, frozen_int
from agglo_core.errors import OptionError
from agglo_core.multigrid.coarsening.near_null import smoothed_near_null
from agglo_core.multigrid.coarsening.prolongation import Couplings, smooth_tentative, tentative
from agglo_core.multigrid.coarsening.smoothed import smoothed_prolongation
from agglo_core.multigrid.matrices.checks import check_system
from agglo_core.problems import Coarsening, CoarseSpace


def parents(fine: Int, coarse: Int) -> Int | None:
    """Return the coarse part that contains each fine part, or None if a fine part lies in several.

    Both levels are given by labels ``(n,)``.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.multigrid import parents
    >>> parents(np.array([0, 0, 1, 2]), np.array([0, 0, 0, 1]))
    array([0, 0, 1])
    >>> print(parents(np.array([0, 0, 1, 1]), np.array([0, 1, 1, 1])))
    None
    """
    holder = np.empty(int(fine.max()) + 1, np.int64)
    holder[fine] = coarse
    return frozen_int(holder) if (holder[fine] == coarse).all() else None


class Injection:
    """Injection of the coarse functions, or their L2 projection for levels that are not nested.

    The functions are polynomials on agglomerates for discretisations, and constants for linear systems.
    """

    def prolongation(self, step: Coarsening) -> Any:
        """Return the prolongation P ``(n, m)``.

        Raises
        ------
        OptionError
            If the method has no own coarse space, as for linear systems with parts of unequal size.
        """
        if step.injected is None:
            raise OptionError(
                "transfer=injection is not possible here: parts have unequal numbers of unknowns, or are "
                "not nested; transfer=aggregation builds coarse unknowns from the matrix"
            )
        return step.injected


class SmoothedInjection:
    """Injection followed by a damped block Jacobi step: :func:`~agglo_core.multigrid.smoothed_prolongation`.

    Parameters
    ----------
    damping : float
    """

    def __init__(self, damping: float = 4 / 3) -> None:
        if not 0.0 < damping < 2.0:
            raise OptionError(f"damping must lie between 0 and 2; given {damping!r}")
        self.damping = damping

    def prolongation(self, step: Coarsening) -> Any:
        """Return the prolongation P ``(n, m)``.

        Errors are those of :class:`Injection`, and LinAlgError if A is not positive definite.
        """
        return smoothed_prolongation(step.A, Injection().prolongation(step), self.damping)


class Aggregation:
    """Smoothed aggregation of near-null vectors, with agglomerates as aggregates.

    Unknown near-null vectors are computed by :func:`~agglo_core.multigrid.smoothed_near_null`.

    Parameters
    ----------
    weak : float
        Couplings up to this fraction of the diagonal are omitted from smoothing.
    """

    def __init__(self, weak: float = 0.01) -> None:
        if not weak >= 0.0:
            raise OptionError(f"weak must be 0 or more; given {weak!r}")
        self.weak = weak

    def prolongation(self, step: Coarsening) -> CoarseSpace:
        """Return the prolongation P with its block offsets, and the coarse near-null vectors.

        Raises
        ------
        OptionError
            If agglomerates are not unions of finer agglomerates.
        LinAlgError
            If a diagonal block is not positive definite and near-null vectors must be computed.
        """
        if step.parents is None:
            raise OptionError(
                "aggregation requires agglomerates that are unions of agglomerates of the finer level; "
                "agglomerate with nested=True"
            )
        near_null = step.near_null
        if near_null is None:
            near_null = smoothed_near_null(step.A, step.block_offsets)
        matrix, offsets, B = check_system(step.A, step.block_offsets, near_null)
        part_of = frozen_int(np.repeat(np.arange(len(offsets) - 1), np.diff(offsets)))
        start = tentative(frozen_int(step.parents[part_of]), int(step.parents.max()) + 1, B)
        P = smooth_tentative(
            matrix, offsets, part_of, Couplings.of(matrix, offsets, part_of), start, B, self.weak
        )
        return CoarseSpace(P, start.offsets, start.near_null)
