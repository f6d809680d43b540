"""Lists of items by row, made by counting: several threads each take a range of the items."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from agglo_core.arrays import Int, frozen_int
from agglo_core.threads import mapped, ranges

_FEW = 20_000  # items one thread puts in their places in a millisecond


def counting_sort(put: Callable[[int, int, Int, bool], None], n: int, rows: int, *, shares: int = 4) -> Int:
    """Let ``put`` sort all items into rows, stably, and return the start of each row ``(rows + 1,)``.

    Parameters
    ----------
    put : callable
        ``put(start, stop, places, only_count)`` takes items start..stop−1: the next one of row r belongs in
        ``places[r]``, which is then counted up; or they are only counted.
    n, rows : int
        Number of items, of rows.
    shares : int
        As for :func:`~agglo_core.threads.ranges`; 1 where there are as many rows as items.
    """
    spans = ranges(n, few=max(_FEW, rows // 2), shares=shares)  # each range counts in all rows

    def counted(start: int, stop: int) -> Int:
        count = np.zeros(rows, np.int64)
        put(start, stop, count, True)
        return count

    def filled(span: tuple[int, int], own: Int) -> None:
        put(span[0], span[1], own, False)

    counts = list(mapped(counted, *zip(*spans, strict=True)))
    offsets = np.zeros(rows + 1, np.int64)
    np.cumsum(counts[0] if len(counts) == 1 else np.sum(counts, axis=0), out=offsets[1:])
    places = [offsets[:-1].copy()]
    for count in counts[:-1]:  # in a row the items of one range follow those of the one before
        places.append(places[-1] + count)
    list(mapped(filled, spans, places))
    return frozen_int(offsets)
