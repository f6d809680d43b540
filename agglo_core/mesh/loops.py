"""Boundary loops of the cells of a plane mesh."""

from __future__ import annotations

from typing import NamedTuple

from agglo_core.arrays import Int

__all__ = ["Loops"]


class Loops(NamedTuple):
    """Boundary loops of every cell.

    Cell c owns loops ``cell_offsets[c]:cell_offsets[c + 1]``; loop l owns
    ``vertices[loop_offsets[l]:loop_offsets[l + 1]]``. The cell lies on the left of each loop: outer
    loops run counter-clockwise, holes clockwise. No loop visits a vertex twice.
    """

    cell_offsets: Int
    loop_offsets: Int
    vertices: Int
