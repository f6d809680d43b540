"""Counting sort of items into rows (buckets), with several threads on ranges of items."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from agglo_core.arrays import Int, frozen_int
from agglo_core.threads import mapped, ranges

# minimum items per range of a thread, about a millisecond of work (benchmarks/threads.py --cells 50000)
_FEW = 20_000


def counting_sort(put: Callable[[int, int, Int, bool], None], n: int, rows: int, *, shares: int = 4) -> Int:
    """Sort items stably into rows with the callback ``put``, and return row offsets ``(rows + 1,)``.

    Parameters
    ----------
    put : callable
        ``put(start, stop, places, only_count)`` processes the items start..stop−1: the next item of row r
        goes to ``places[r]``, which is then incremented. With ``only_count`` items are only counted.
    n, rows : int
        Item and row counts.
    shares : int
        As for :func:`~agglo_core.threads.ranges`; 1 for as many rows as items.
    """
    spans = ranges(n, few=max(_FEW, rows // 2), shares=shares)  # each range has counters for all rows

    def count_range(start: int, stop: int) -> Int:
        count = np.zeros(rows, np.int64)
        put(start, stop, count, True)
        return count

    def fill_range(span: tuple[int, int], next_places: Int) -> None:
        put(span[0], span[1], next_places, False)

    # Count per range, then compute the first position of each range in each row.
    counts = list(mapped(count_range, *zip(*spans, strict=True)))
    offsets = np.zeros(rows + 1, np.int64)
    np.cumsum(counts[0] if len(counts) == 1 else np.sum(counts, axis=0), out=offsets[1:])
    places = [offsets[:-1].copy()]
    for count in counts[:-1]:  # items of a range follow those of the previous range
        places.append(places[-1] + count)
    list(mapped(fill_range, spans, places))
    return frozen_int(offsets)
