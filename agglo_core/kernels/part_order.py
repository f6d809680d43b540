"""Where parts are along an axis of their block: a geometric order."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import helper, kernel
from agglo_core.kernels.shape_state import CENTRE, MASS

__all__ = ["part_places"]

_FLAT = 1e-6
"""A third moment below this share of its bound is rounding."""


@helper(allocates=True)
def _block_axes(block, count, tally):
    """Third moment of the centres of the parts of each block ``(count, 3)``, or a fixed direction.

    The moment turns with the block, and does not vanish unless there is symmetry.
    """
    k = len(block)
    mass, spread = np.zeros(count), np.zeros(count)
    centres, axes = np.zeros((count, 3)), np.zeros((count, 3))
    extent = 0.0
    for p in range(k):
        b, m = block[p], tally[p, MASS]
        mass[b] += m
        for a in range(3):
            centres[b, a] += m * tally[p, CENTRE + a]
            extent = max(extent, abs(tally[p, CENTRE + a] - tally[0, CENTRE + a]))
    unit = 1.0 / extent if extent > 1e-300 else 1.0  # cubes of any unit are finite
    for b in range(count):
        for a in range(3):
            centres[b, a] = centres[b, a] / mass[b] if mass[b] > 0.0 else 0.0
    for p in range(k):
        b, square = block[p], 0.0
        for a in range(3):
            square += (unit * (tally[p, CENTRE + a] - centres[b, a])) ** 2
        square *= tally[p, MASS]
        spread[b] += square
        for a in range(3):
            axes[b, a] += square * (unit * (tally[p, CENTRE + a] - centres[b, a]))
    for b in range(count):
        length, bound = 0.0, spread[b] * np.sqrt(spread[b] / mass[b]) if mass[b] > 0.0 else 0.0
        for a in range(3):
            length += axes[b, a] ** 2
        if not np.sqrt(length) > _FLAT * bound:
            for a in range(3):
                axes[b, a] = 1.0 / (1.0 + np.sqrt(2.0) * a)
    return axes


@kernel
def part_places(block, count, tally):
    """Axes of the blocks ``(count, 3)``; where each part's centre is along that of its block ``(k,)``."""
    axes, places = _block_axes(block, count, tally), np.zeros(len(block))
    for p in range(len(block)):
        for a in range(3):
            places[p] += axes[block[p], a] * tally[p, CENTRE + a]
    return axes, places
