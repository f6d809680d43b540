"""Blocks of cells by their coordinates, whatever the ranks they lie on: the top of a tree that all share."""

from __future__ import annotations

from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.errors import OptionError

BLOCK_CELLS = {2: 16_384, 3: 131_072}
"""Cells that are agglomerated by themselves, at most about, in the plane and in space.

In space more of a block's parts are at its border, where they are of worse shape.
"""

_BITS = 32
"""Of coordinates as whole numbers: rounding errors of cells in a row are far smaller than one."""

_DIGIT = 4
"""Bits that are found at a time: with more of them ranks meet less often, but tell more counts."""


class Reduced(Protocol):
    """Arrays of one shape from all ranks, put together item by item: :meth:`Ranks.reduced`."""

    def __call__(self, values: NDArray[Any], how: Literal["sum", "min", "max"], /) -> NDArray[Any]: ...


def _alone(values: NDArray[Any], how: Literal["sum", "min", "max"], /) -> NDArray[Any]:
    """What is put together where one rank has all points."""
    return values


def halvings(n_cells: int, dim: int, block_cells: int | None) -> int:
    """Cuts from all cells to a block of at most about ``block_cells``, by default ``BLOCK_CELLS``.

    Raises
    ------
    OptionError
        For blocks of no cells.
    """
    most = BLOCK_CELLS[dim] if block_cells is None else block_cells
    if not most >= 1:
        raise OptionError(f"block_cells must be at least 1, given {block_cells!r}")
    return max(0, int(np.ceil(np.log2(max(n_cells, 1) / most))))


def rank_of_block(block: Int, count: int, size: int) -> Int:
    """The rank, of ``size``, that has each block of ``count``: consecutive ones."""
    return frozen_int(np.asarray(block) * size // count)


def coordinate_blocks(points: Float, depth: int, reduced: Reduced = _alone) -> Int:
    """Block ``(n,)`` of each point of this rank, one of ``2**depth``, by recursive halving.

    Each block is cut across the longest side of its box, at the coordinate that leaves the halves as equal in
    number as it can: points of the same coordinate, up to rounding, stay together. Blocks with the same
    leading digits are near one another. Some stay empty where points coincide.

    Parameters
    ----------
    points : (n, d) float
        Those of this rank; the result depends on all, not on where they lie.
    depth : int
        Number of cuts from all points to a block.
    reduced : callable, optional
        How ranks put arrays together; by default all points are here.
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
    """Coordinates as whole numbers ``(d, n)`` from 0 to 2^31, of one step along all axes.

    The middle is a whole number too: a row of cells there is not torn by how numbers are rounded.
    """
    columns = [np.ascontiguousarray(along) for along in points.T]  # along which numpy is ten times faster
    ends = [(along.min(initial=np.inf), -along.max(initial=-np.inf)) for along in columns]
    least = reduced(np.array(ends), "min")  # (d, 2)
    extent = float(-least.sum(axis=1).min())
    scale = (1 << (_BITS - 1)) / extent if extent > 0.0 else 0.0
    axes = [np.rint((along - low) * scale) for along, low in zip(columns, least[:, 0], strict=True)]
    return frozen_int(np.array(axes).astype(np.int64))


def _longest_sides(axes: Int, block: Int, count: int, reduced: Reduced) -> Int:
    """Axis of the longest side of the box of each block."""
    low, high = np.full((len(axes), count), 1 << _BITS), np.full((len(axes), count), -1 << _BITS)
    for k, along in enumerate(axes):
        np.minimum.at(low[k], block, along)
        np.maximum.at(high[k], block, along)
    low, high = reduced(np.stack((low, -high)), "min")
    return frozen_int(np.argmin(low + high, axis=0))


def _medians(along: Int, block: Int, count: int, reduced: Reduced) -> Int:
    """Coordinate of each block at or below which as near to half of its points lie as can be.

    That of the point in the middle is found digit by digit, by counts of those that share the digits so far.
    """
    middle, below, every = np.zeros(count, np.int64), np.zeros(count, np.int64), np.arange(count)
    total = reduced(np.bincount(block, minlength=count), "sum")
    for shift in range(_BITS - _DIGIT, -1, -_DIGIT):
        keys = (block << _DIGIT) + (along >> shift) % (1 << _DIGIT)
        found = reduced(np.bincount(keys, minlength=count << _DIGIT).reshape(count, -1), "sum")
        upto = below[:, None] + np.cumsum(found, axis=1)
        digit = np.argmax(2 * upto >= total[:, None], axis=1)
        middle = (middle << _DIGIT) + digit
        below = upto[every, digit] - found[every, digit]
        still = np.flatnonzero(along >> shift == middle[block])
        along, block = along[still], block[still]
    before = (below > 0) & (total - 2 * below <= 2 * upto[every, digit] - total)
    return frozen_int(middle - before)
