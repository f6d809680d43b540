"""One level of a multigrid method, as it is given to a smoother."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from agglo_core.arrays import Float, Int

__all__ = ["MultigridLevel"]


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
    """

    A: Any
    inherited: Any
    block_offsets: Int
    labels: Int
    P: Any
    coarse: Callable[[Float], Float] | None
    steps: int
