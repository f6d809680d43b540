"""Straight cuts across rotated principal axes: the baseline for a learned bisector."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from agglo_core.arrays import Int, UInt64
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.graph.blocks import principal_frames
from agglo_core.graph.sweep import sweep, sweep_arrays
from agglo_core.split.piece_growth import PieceGrowth


class SweepBisection:
    """Find the best straight cut along the principal axis and rotated axes.

    The best threshold along all axes minimises the cost in :func:`agglo_core.graph.sweep.sweep`, which
    favours a short interface and compact sides. In 3-D the axes are three principal and four diagonal axes.
    The method uses neither random numbers nor learned parameters.

    Parameters
    ----------
    axes : int
        Number of directions in 2-D, evenly spaced over the half circle.

    Examples
    --------
    >>> from agglo_core.authoring import SweepBisection
    >>> strip = agglo.samples.strip(6).graph
    >>> SweepBisection(axes=4).bisect_level(strip, np.zeros(1, np.uint64))
    array([0, 0, 0, 1, 1, 1])
    """

    needs_points = True

    def __init__(self, axes: int = 8) -> None:
        if isinstance(axes, bool) or not isinstance(axes, int) or axes < 1:
            raise OptionError(f"sweep: axes must be a whole number, 1 or more, given {axes!r}")
        self.axes = axes

    def bisect_level(self, level: Graph, seeds: UInt64) -> Int:
        """Return the side ``(n,)`` per node, independent of ``seeds``."""
        from agglo_core.compiled.thresholds import sweep_axes

        if level.dim == 3:
            diagonals = np.array([(1.0, *rest) for rest in product((1.0, -1.0), repeat=2)]) / np.sqrt(3.0)
            return sweep(level, principal_frames(level)[1] @ np.concatenate((np.eye(3), diagonals)).T)
        sides: Int = sweep_axes(*sweep_arrays(level), self.axes)
        return sides

    def grow(self, graph: Graph, pieces: Int, refiners: Sequence[Any], fixer: Any) -> PieceGrowth | None:
        """Return an object for all splits in one call, or None if refiners or fixer are unsupported."""
        from agglo_core.split.piece_sweeps import split_along_axes

        return PieceGrowth.for_components(
            graph, pieces, partial(split_along_axes, self.axes), refiners, fixer
        )
