"""Order the parts of a block in strips across its axis, and cut it into slices that trade no cells."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int

_WIDTH = 8.0
"""Parts side by side in a slice, more or less."""

_MANY = 16_384
"""Parts of which the cells do not fit a cache: with fewer, strips gain less time than they take."""


def strip_order(tally: Float, block: Int, axes: Float, places: Float, dim: int) -> Int:
    """Parts ``(k,)`` by block, and by their places along its axis; if many, in strips of a block's slices.

    A slice is two successive strips. In the next sweep slices are shifted by one strip, so that each strip,
    except the first and the last, is with its other neighbour. Within a strip, parts are sorted along a
    direction across the axis: see ``places_across``. The ``tally (k, 8)`` has masses and centres: see
    ``part_tally`` in ``state.py``.
    """
    if len(block) < _MANY:
        return frozen_int(np.lexsort((places, block)))
    order, size = _sorted(places, block), np.bincount(block)
    count = _slices_of(size, dim)
    if (count == 1).all():
        return frozen_int(order)
    from agglo_core.refine.compactness.part_order import places_across

    own = block[order]
    rank = np.arange(len(block)) - (np.cumsum(size) - size)[own]
    strip = ((rank + 1) * 2 * count[own] - 1) // size[own]
    several, across = count[own] > 1, places_across(block, tally, axes, dim)[order]
    strip = 2 * count.max() * own + np.where(several, strip, 0)
    return frozen_int(order[_sorted(np.where(several, across, rank), strip)])


def slices(starts: Int, shift: int, dim: int) -> Int:
    """Slices of a sweep ``(S, 5)``: first part, last plus 1, the same two of the block, and the block.

    A block has up to 16 slices, each some parts wide; with ``shift`` each begins and ends in the middle of
    others without.
    """
    counts = starts[1:] - starts[:-1]
    strips = _slices_of(counts, dim)
    shifts = shift * (strips > 1)
    block = np.repeat(np.arange(len(counts)), strips + shifts)
    before = np.cumsum(strips + shifts) - strips - shifts
    place = 2 * (np.arange(len(block)) - before[block]) - shifts[block]
    size, first, width = counts[block], starts[block], 2 * strips[block]
    rows = np.empty((len(block), 5), np.int64)
    for column, each in enumerate((place, place + 2)):
        rows[:, column] = first + np.minimum(np.maximum(size * each // width, 0), size)
    rows[:, 2], rows[:, 3], rows[:, 4] = first, first + size, block
    return frozen_int(rows)


def _slices_of(counts: Int, dim: int) -> Int:
    """Slices of blocks of so many parts."""
    return frozen_int(np.clip(counts ** (1.0 / dim) / _WIDTH, 1.0, 16.0).astype(np.int64))


def _sorted(values: Float, groups: Int) -> Int:
    """The order of values by group, and by themselves; of equal ones the first goes first."""
    width = float(np.ptp(values))
    keys = groups + (0.5 / width if width > 0.0 else 0.0) * (values - values.min())
    order: Int = keys.argsort()  # several times faster than what keeps the order of equal ones
    if (np.diff(keys[order]) > 4.0 * np.spacing(keys.max())).all():
        return order
    return np.asarray(np.lexsort((values, groups)))
