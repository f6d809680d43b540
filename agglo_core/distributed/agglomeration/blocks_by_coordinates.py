"""Cell blocks by recursive coordinate bisection, independent of the distribution to ranks."""

from __future__ import annotations

from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.errors import OptionError

BLOCK_CELLS = {2: 16_384, 3: 131_072}
"""Approximate maximum number of cells in a separate block, in 2-D and 3-D.

In 3-D a larger share of a block's parts lies at its border, where shapes are worse. Larger blocks have better
shapes, but occupy fewer ranks (benchmarks/scale.py).
"""

_BITS = 32
"""Bits per integer coordinate: rounding errors along a row of cells are far below one step."""

_DIGIT = 4
"""Bits per median step: more bits mean fewer exchanges, but more counts in each (benchmarks/scale.py)."""


class Reduced(Protocol):
    """Entrywise sum, minimum or maximum over the ranks' arrays of equal shape, as :meth:`Ranks.reduced`."""

    def __call__(self, values: NDArray[Any], how: Literal["sum", "min", "max"], /) -> NDArray[Any]: ...


def _reduce_on_one_rank(values: NDArray[Any], how: Literal["sum", "min", "max"], /) -> NDArray[Any]:
    """Return the values unchanged: the reduction over a single rank."""
    return values


def halvings(n_cells: int, dim: int, block_cells: int | None) -> int:
    """Return the number of successive halvings that lead to blocks of about ``block_cells`` cells or fewer.

    Raises
    ------
    OptionError
        For blocks without cells.
    """
    most = BLOCK_CELLS[dim] if block_cells is None else block_cells
    if not most >= 1:
        raise OptionError(f"block_cells must be at least 1, given {block_cells!r}")
    return max(0, int(np.ceil(np.log2(max(n_cells, 1) / most))))


def rank_of_block(block: Int, count: int, size: int) -> Int:
    """Return the rank of each block: ``count`` blocks on ``size`` ranks, consecutive blocks together."""
    return frozen_int(np.asarray(block) * size // count)


def coordinate_blocks(points: Float, depth: int, reduced: Reduced = _reduce_on_one_rank) -> Int:
    """Assign each of this rank's points to one of ``2**depth`` blocks by recursive coordinate bisection.

    Each block is cut across the longest side of its box, at the coordinate that gives the most equal halves:
    points with equal coordinate, up to rounding, stay together. Blocks with equal leading digits are
    neighbours. Some blocks stay empty where points coincide.

    Parameters
    ----------
    points : (n, d) float
        Local points. The result depends on all points, not on their distribution.
    depth : int
        Number of cuts from all points to a block.
    reduced : callable, optional
        Reduction across ranks. Default: all points are local.
    """
    block = np.zeros(len(points), np.int64)
    if depth == 0:
        return frozen_int(block)
    axes, every = _on_grid(points, reduced), np.arange(len(points))
    for level in range(depth):
        longest = _longest_sides(axes, block, 1 << level, reduced)
        along = axes[longest[block], every]
        cut = _medians(frozen_int(along), frozen_int(block), 1 << level, reduced)
        block = 2 * block + (along > cut[block])
    return frozen_int(block)


def _on_grid(points: Float, reduced: Reduced) -> Int:
    """Round coordinates to integers ``(d, n)`` from 0 to 2^31, with equal step along all axes.

    The middle is an integer, too, so that rounding does not tear a row of cells there.
    """
    columns = [np.ascontiguousarray(column) for column in points.T]  # contiguous: ten times faster
    ends = [(column.min(initial=np.inf), -column.max(initial=-np.inf)) for column in columns]
    least = reduced(np.array(ends), "min")  # (d, 2)
    extent = float(-least.sum(axis=1).min())
    scale = (1 << (_BITS - 1)) / extent if extent > 0.0 else 0.0
    axes = [np.rint((column - low) * scale) for column, low in zip(columns, least[:, 0], strict=True)]
    return frozen_int(np.array(axes).astype(np.int64))


def _longest_sides(axes: Int, block: Int, count: int, reduced: Reduced) -> Int:
    """Return the axis along which each block's bounding box is longest."""
    low, high = np.full((len(axes), count), 1 << _BITS), np.full((len(axes), count), -1 << _BITS)
    for k, along in enumerate(axes):
        np.minimum.at(low[k], block, along)
        np.maximum.at(high[k], block, along)
    low, high = reduced(np.stack((low, -high)), "min")
    return frozen_int(np.argmin(low + high, axis=0))


def _medians(coordinate: Int, block: Int, count: int, reduced: Reduced) -> Int:
    """Return for each block the coordinate that splits its points most evenly (≤ and >).

    The middle point's coordinate is found digit by digit, by counting the points that share all digits so
    far.
    """
    middle, below, blocks = np.zeros(count, np.int64), np.zeros(count, np.int64), np.arange(count)
    total = reduced(np.bincount(block, minlength=count), "sum")
    for shift in range(_BITS - _DIGIT, -1, -_DIGIT):
        # Choose the digit where the cumulative count reaches half of the points.
        keys = (block << _DIGIT) + (coordinate >> shift) % (1 << _DIGIT)
        counts = reduced(np.bincount(keys, minlength=count << _DIGIT).reshape(count, -1), "sum")
        upto = below[:, None] + np.cumsum(counts, axis=1)
        digit = np.argmax(2 * upto >= total[:, None], axis=1)
        middle = (middle << _DIGIT) + digit
        below = upto[blocks, digit] - counts[blocks, digit]
        # Continue with the points that share all digits so far.
        candidates = np.flatnonzero(coordinate >> shift == middle[block])
        coordinate, block = coordinate[candidates], block[candidates]
    # Cut before the middle coordinate if that is more even.
    before = (below > 0) & (total - 2 * below <= 2 * upto[blocks, digit] - total)
    return frozen_int(middle - before)
