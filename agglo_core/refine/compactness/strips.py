"""Order a block's parts in strips across its axis, and divide them into independent slices.

Slices trade no cells with one another.
"""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int

_WIDTH = 8.0
"""Approximate width of a slice, in parts.

Narrower slices share the work more evenly, but more parts cannot trade cells with a neighbour in the next
slice (benchmarks/threads.py).
"""

_MANY = 16_384
"""Number of parts whose cells exceed the cache (benchmarks/partition.py, with a million cells).

With fewer parts, strips save less time than they cost.
"""


def strip_order(tally: Float, block: Int, axes: Float, places: Float, dim: int) -> Int:
    """Return the parts ``(k,)`` sorted by block, and within a block by position along its axis.

    With many parts, the parts are ordered in strips, two successive strips per slice. In the next sweep
    slices are shifted by one strip, so that each strip, except the first and the last, is paired with its
    other neighbour. Within a strip, parts are sorted along a direction across the axis: see
    ``places_across``. The ``tally (k, 8)`` contains masses and centres: see ``part_tally`` in ``state.py``.
    """
    # 1. Few parts: sort along the axis only.
    if len(block) < _MANY:
        return frozen_int(np.lexsort((places, block)))
    # 2. Rank of each part in its block, and the strip of this rank.
    order, size = _sort_in_groups(places, block), np.bincount(block)
    count = _slices_of(size, dim)
    if (count == 1).all():
        return frozen_int(order)
    from agglo_core.refine.compactness.part_order import places_across

    sorted_blocks = block[order]
    rank = np.arange(len(block)) - (np.cumsum(size) - size)[sorted_blocks]
    strip = ((rank + 1) * 2 * count[sorted_blocks] - 1) // size[sorted_blocks]
    several, across = count[sorted_blocks] > 1, places_across(block, tally, axes, dim)[order]
    # 3. Sort by strip, and by the position across within a strip.
    strip = 2 * count.max() * sorted_blocks + np.where(several, strip, 0)
    return frozen_int(order[_sort_in_groups(np.where(several, across, rank), strip)])


def slices(starts: Int, shift: int, dim: int) -> Int:
    """Divide the parts of each block into the slices ``(S, 5)`` of a sweep.

    The columns are the first part and the last part plus 1 in the slice, the first part and the last part
    plus 1 in its block, and the block number. A block has up to 16 slices, each several parts wide. With
    ``shift`` each slice begins and ends in the middle of an unshifted slice.
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
    """Return the slice count for blocks with ``counts`` parts."""
    return frozen_int(np.clip(counts ** (1.0 / dim) / _WIDTH, 1.0, 16.0).astype(np.int64))


def _sort_in_groups(values: Float, groups: Int) -> Int:
    """Return the order by group, and by value within a group, stable for equal values."""
    width = float(np.ptp(values))
    keys = groups + (0.5 / width if width > 0.0 else 0.0) * (values - values.min())
    order: Int = keys.argsort()  # several times faster than a stable sort
    if (np.diff(keys[order]) > 4.0 * np.spacing(keys.max())).all():
        return order
    return np.asarray(np.lexsort((values, groups)))
