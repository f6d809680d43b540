"""One level of a multigrid method, as it is given to a smoother."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from agglo_core.arrays import Float, Int

__all__ = ["MultigridLevel", "Patches"]


@dataclass(frozen=True, eq=False)
class Patches:
    """Groups of parts whose unknowns are solved for together; they may overlap.

    Attributes
    ----------
    offsets : (q + 1,) int
        The parts of patch i are ``parts[offsets[i]:offsets[i + 1]]``.
    parts : (m,) int
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
        Groups of parts that meet at a vertex, where the method has found them.
    """

    A: Any
    inherited: Any
    block_offsets: Int
    labels: Int
    P: Any
    coarse: Callable[[Float], Float] | None
    steps: int
    patches: Patches | None = None
