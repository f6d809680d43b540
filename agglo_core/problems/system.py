"""What a discretisation assembles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from agglo_core.arrays import Float, Int
from agglo_core.mesh import Mesh

__all__ = ["System"]


@dataclass(frozen=True, eq=False)
class System:
    """A linear system whose unknowns belong to the cells of a mesh.

    Attributes
    ----------
    A : (n, n) sparse
    b : (n,) float
    block_offsets : (n_cells + 1,) int
        The unknowns of cell c are ``block_offsets[c]:block_offsets[c + 1]``.
    mesh : Mesh
    near_null : (n, k) float, optional
        Vectors that A takes to nearly nothing, such as constants and rigid motions.
    """

    A: Any
    b: Float
    block_offsets: Int
    mesh: Mesh
    near_null: Float | None = None
