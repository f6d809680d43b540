"""Diameters of blocks of cells: the largest distance of two of their vertices."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Index, Int, frozen_float
from agglo_core.threads import over_ranges

__all__ = ["compared_diameters", "diameters_of"]

_FEW = 2_000  # blocks one thread looks at in some milliseconds


def diameters_of(offsets: Int, cells: Int, vertex_offsets: Int, vertices: Index, points: Float) -> Float:
    """Diameter ``(B,)`` of each block; block b is ``cells[offsets[b]:offsets[b + 1]]``.

    Parameters
    ----------
    offsets : (B + 1,) int
    cells : (n,) int
    vertex_offsets, vertices : CSR
        Vertices of each cell.
    points : (p, d) float
    """
    from agglo_core.kernels.geometry import block_diameters

    def found(start: int, stop: int) -> Float:
        own: Float = block_diameters(offsets[start : stop + 1], cells, vertex_offsets, vertices, points)
        return own

    return frozen_float(np.concatenate(over_ranges(found, len(offsets) - 1, few=_FEW, shares=1)))


def compared_diameters(
    offsets: Int, cells: Int, vertex_offsets: Int, vertices: Index, points: Float, limits: Float
) -> Float:
    """As :func:`diameters_of`, but only on the right side of each of the ascending ``limits (k,)``.

    Exact where a limit is near, a lower bound elsewhere, or infinite beyond the last one: many times faster.
    """
    from agglo_core.kernels.geometry import compare_diameters

    def found(start: int, stop: int) -> Float:
        own = offsets[start : stop + 1]
        bounds: Float = compare_diameters(own, cells, vertex_offsets, vertices, points, limits)
        return bounds

    return frozen_float(np.concatenate(over_ranges(found, len(offsets) - 1, few=_FEW, shares=1)))
