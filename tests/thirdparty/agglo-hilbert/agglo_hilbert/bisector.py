"""Bisection along the Hilbert curve, with a whole level in one call."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agglo_core import Graph, OptionError
from agglo_hilbert.curve import hilbert_keys

__all__ = ["Hilbert"]


class Hilbert:
    """Bisector with the first half of the cells along the curve on one side.

    Parameters
    ----------
    bits : int in 1..20
        Depth of the curve; cells closer than extent / 2^bits keep the order of their numbers.
    """

    def __init__(self, bits: int = 16) -> None:
        if not isinstance(bits, int) or not 1 <= bits <= 20:
            raise OptionError(f"hilbert: bits must be an integer in 1..20, given {bits!r}")
        self.bits = bits

    def bisect_level(self, level: Graph, seeds: NDArray[np.uint64]) -> NDArray[np.int64]:
        """Return the sides ``(n,)`` of every block.

        The seeds are not used.
        """
        first, sizes = level.offsets[:-1], np.diff(level.offsets)
        low = np.minimum.reduceat(level.centroids, first)
        extent = (np.maximum.reduceat(level.centroids, first) - low).max(axis=1)
        extent[extent == 0] = 1.0
        unit = (level.centroids - low[level.block_ids]) / extent[level.block_ids, None]
        top = 2**self.bits - 1
        keys = hilbert_keys(np.minimum(unit * 2**self.bits, top).astype(np.uint64), self.bits)
        order = np.lexsort((keys, level.block_ids))
        place = np.arange(level.n) - np.repeat(first, sizes)
        sides = np.empty(level.n, np.int64)
        sides[order] = place >= np.repeat(sizes // 2, sizes)
        return sides
