"""Find the records of a stream of numbers in which each record states its length.

They can only be found one after the other. The stream is taken by windows that stay in the processor's
cache: there the end of a record is looked up for all places as if one began at each, and steps are doubled.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, frozen_int
from agglo_core.errors import FileError

_WINDOW = 1 << 15  # numbers looked at together
_NEVER = 1 << 60  # where a record ends that can be none


def counted_lists(stream: Int, n: int, ahead: int = 0, behind: int = 0) -> tuple[Int, Int, int]:
    """The lists ``k, v1, …, vk`` that a stream consists of.

    Parameters
    ----------
    stream : int
    n : int
        How many there should be; no memory is taken by it.
    ahead : int
        How many numbers stand before each k (names of cells).
    behind : int
        How many numbers follow each list (colours).

    Returns
    -------
    offsets : (n + 1,) int
    places : int
        Those of all v in the stream.
    used : int
        How many numbers the lists take.

    Raises
    ------
    FileError
        Naming the list that is cut short, or has no or fewer entries.
    """

    def ends(window: Int) -> Int:
        return _list_ends(window, ahead, behind)

    starts, used = record_starts(stream, n, ends)
    sizes = stream[starts + ahead]
    offsets = np.concatenate(([0], np.cumsum(sizes)))
    places = np.repeat(starts + ahead + 1 - offsets[:-1], sizes)
    places += np.arange(offsets[-1])
    return frozen_int(offsets), frozen_int(places), used


def counted_solids(stream: Int, n: int, ahead: int) -> tuple[Int, Int, Int, int]:
    """Lists of lists: ``f``, then f lists ``k, v1, …, vk``, with ``ahead`` numbers before each f and k.

    Returns
    -------
    cell_offsets : (n + 1,) int
    loop_offsets : (n_loops + 1,) int
    places : int
        Those of all v in the stream.
    used : int
        How many numbers the cells take.

    Raises
    ------
    FileError
        As :func:`counted_lists`.
    """

    def ends(window: Int) -> Int:
        return _solid_ends(window, ahead)

    starts, used = record_starts(stream, n, ends)
    counts = stream[starts + ahead]
    cell_offsets = np.concatenate(([0], np.cumsum(counts)))
    heads = np.zeros(used, bool)  # the numbers that begin a cell, which are left out
    for shift in range(ahead + 1):
        heads[starts + shift] = True
    kept = np.flatnonzero(~heads)
    loop_offsets, places, _ = counted_lists(frozen_int(stream[kept]), int(cell_offsets[-1]), ahead)
    return frozen_int(cell_offsets), loop_offsets, frozen_int(kept[places]), used


def record_starts(stream: NDArray[Any], n: int, ends: Callable[[NDArray[Any]], Int]) -> tuple[Int, int]:
    """Find the start of each of n records, and the end of the last one.

    Parameters
    ----------
    stream : (N, …) array
    n : int
    ends : callable
        Given a window of the stream, where a record at each of its places would end, counted from its begin.
        What cannot be told within the window is one more than its length.

    Raises
    ------
    FileError
        Naming the first record that does not end in the stream.
    """
    found: list[Int] = []
    count, place, size = 0, 0, _WINDOW
    while count < n:
        window = stream[place : place + size]
        stops = ends(window)
        chain, after = _chain(frozen_int(np.minimum(stops, len(window) + 1)), len(window), n - count)
        if len(chain):
            found.append(frozen_int(chain + place))
            count, place, size = count + len(chain), place + after, _WINDOW
        elif len(stops) and stops[0] <= len(stream) - place:
            size *= 2
        else:
            raise FileError(f"cell {count} (of {n}, from 0 on) is longer than the rest of the file, or empty")
    return frozen_int(np.concatenate([np.empty(0, np.int64), *found])), place


def _chain(ends: Int, size: int, most: int) -> tuple[Int, int]:
    """Records of a window one after the other from 0 on, as far as they end in it, and where the last ends.

    ``ends[i]`` is where a record at i would end; ``size + 1`` stands for one that does not end here, and
    follows itself, as the end of the window does.
    """
    chain = np.arange(0, size, max(int(ends[0]), 1)) if size else np.zeros(1, np.int64)
    if not np.array_equal(ends[chain[:-1]], chain[1:]):  # else they are all of one length
        step = np.concatenate((ends, [size, size + 1]))
        chain = np.zeros(1, np.int64)
        while chain[-1] < size and len(chain) <= most:
            chain = np.concatenate((chain, step[chain]))
            step = step[step]
    whole = int(np.searchsorted(chain, size))  # those that begin in the window
    whole = min(whole, most)
    if whole and ends[chain[whole - 1]] > size:
        whole -= 1
    return frozen_int(chain[:whole]), int(ends[chain[whole - 1]]) if whole else 0


def _list_ends(window: Int, ahead: int, behind: int = 0) -> Int:
    size = len(window)
    ends = np.full(size, size + 1)
    counts = window[ahead:]
    fits = (counts > 0) & (counts < _NEVER)
    after = np.arange(1 + ahead + behind, 1 + ahead + behind + len(counts))
    ends[: len(counts)] = np.where(fits, after + np.where(fits, counts, 0), _NEVER)
    return frozen_int(ends)


def _solid_ends(window: Int, ahead: int) -> Int:
    """The ends of lists are stepped to as many times as the record at each place says, by powers of two."""
    size = len(window)
    step = np.concatenate((np.minimum(_list_ends(window, ahead), size + 1), [size + 1, size + 1]))
    place = np.full(size, size + 1)
    counts = window[ahead:]
    fits = (counts > 0) & (counts < size)
    place[: len(counts)] = np.where(fits, np.arange(1 + ahead, 1 + ahead + len(counts)), size + 1)
    rest = np.zeros(size, np.int64)
    rest[: len(counts)] = np.where(fits, counts, 0)
    while rest.any():
        odd = (rest & 1).astype(bool)
        place[odd] = step[place[odd]]
        step, rest = step[step], rest >> 1
    if len(counts) and (counts[0] < 1 or counts[0] >= _NEVER):
        place[0] = _NEVER
    return frozen_int(place)
