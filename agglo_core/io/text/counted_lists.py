"""Split a stream of numbers into records (lists of numbers), each of which states its own length.

The start of a record depends on all records before it. The stream is processed in windows that fit into the
processor cache. In each window the end of a record is computed for every possible start, and pointer doubling
then finds the actual chain of records.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, frozen_int
from agglo_core.errors import FileError

_WINDOW = 1 << 15  # numbers per window
_NEVER = 1 << 60  # end of a record with an invalid length


def locate_lists(stream: Int, n: int, ahead: int = 0, behind: int = 0) -> tuple[Int, Int, int]:
    """Locate consecutive lists ``k, v1, …, vk`` in a stream of integers.

    Parameters
    ----------
    stream : int
    n : int
        Expected list count; allocates no memory.
    ahead : int
        Value count before each k (cell names).
    behind : int
        Value count after each list (colours).

    Returns
    -------
    offsets : (n + 1,) int
    places : int
        Positions of all v in the stream.
    length : int
        Length of the lists in the stream.

    Raises
    ------
    FileError
        With the number of the first list that is truncated or has no positive length.
    """

    def ends(window: Int) -> Int:
        return _list_ends(window, ahead, behind)

    starts, length = record_starts(stream, n, ends)
    sizes = stream[starts + ahead]
    offsets = np.concatenate(([0], np.cumsum(sizes)))
    places = np.repeat(starts + ahead + 1 - offsets[:-1], sizes)
    places += np.arange(offsets[-1])
    return frozen_int(offsets), frozen_int(places), length


def locate_solids(stream: Int, n: int, ahead: int) -> tuple[Int, Int, Int, int]:
    """Locate consecutive nested lists in a stream: ``f``, then f lists ``k, v1, …, vk``.

    Each f and k follows ``ahead`` other values.

    Returns
    -------
    cell_offsets : (n + 1,) int
    loop_offsets : (n_loops + 1,) int
    places : int
        Positions of all v in the stream.
    length : int
        Length of the cells in the stream.

    Raises
    ------
    FileError
        As :func:`locate_lists`.
    """

    def ends(window: Int) -> Int:
        return _solid_ends(window, ahead)

    starts, length = record_starts(stream, n, ends)
    counts = stream[starts + ahead]
    cell_offsets = np.concatenate(([0], np.cumsum(counts)))
    heads = np.zeros(length, bool)  # heads of cells, removed before the inner lists are located
    for shift in range(ahead + 1):
        heads[starts + shift] = True
    inner_places = np.flatnonzero(~heads)
    loop_offsets, places, _ = locate_lists(frozen_int(stream[inner_places]), int(cell_offsets[-1]), ahead)
    return frozen_int(cell_offsets), loop_offsets, frozen_int(inner_places[places]), length


def record_starts(stream: NDArray[Any], n: int, ends: Callable[[NDArray[Any]], Int]) -> tuple[Int, int]:
    """Return the start indices of n consecutive records in a stream, and the end of the last record.

    Parameters
    ----------
    stream : (N, …) array
    n : int
    ends : callable
        Function of a window that returns, for each position, the end of a record that would start there,
        relative to the window. Ends outside the window are at least its length plus one.

    Raises
    ------
    FileError
        With the number of the first record that does not end in the stream.
    """
    blocks: list[Int] = []
    count, place, size = 0, 0, _WINDOW
    while count < n:
        window = stream[place : place + size]
        stops = ends(window)
        chain, after = _chain(frozen_int(np.minimum(stops, len(window) + 1)), len(window), n - count)
        if len(chain):
            blocks.append(frozen_int(chain + place))
            count, place, size = count + len(chain), place + after, _WINDOW
        # The record is longer than the window: enlarge the window.
        elif len(stops) and stops[0] <= len(stream) - place:
            size *= 2
        else:
            raise FileError(
                f"cell {count} (of {n}, counted from 0) is longer than the rest of the file, or empty"
            )
    return frozen_int(np.concatenate([np.empty(0, np.int64), *blocks])), place


def _chain(ends: Int, size: int, most: int) -> tuple[Int, int]:
    """Return the starts of consecutive records that end in a window, and the end of the last record.

    ``ends[i]`` is the end of a record that would start at i; ``size + 1`` marks a record that does not end
    here. Both ends are fixed points of the iteration.
    """
    # First guess: all records have the same length.
    chain = np.arange(0, size, max(int(ends[0]), 1)) if size else np.zeros(1, np.int64)
    if not np.array_equal(ends[chain[:-1]], chain[1:]):  # otherwise follow the chain by doubling
        step = np.concatenate((ends, [size, size + 1]))
        chain = np.zeros(1, np.int64)
        while chain[-1] < size and len(chain) <= most:
            chain = np.concatenate((chain, step[chain]))
            step = step[step]
    whole = int(np.searchsorted(chain, size))  # records that start in the window
    whole = min(whole, most)
    if whole and ends[chain[whole - 1]] > size:
        whole -= 1
    return frozen_int(chain[:whole]), int(ends[chain[whole - 1]]) if whole else 0


def _list_ends(window: Int, n_before: int, n_after: int = 0) -> Int:
    size = len(window)
    ends = np.full(size, size + 1)
    counts = window[n_before:]
    fits = (counts > 0) & (counts < _NEVER)
    after = np.arange(1 + n_before + n_after, 1 + n_before + n_after + len(counts))
    ends[: len(counts)] = np.where(fits, after + np.where(fits, counts, 0), _NEVER)
    return frozen_int(ends)


def _solid_ends(window: Int, n_before: int) -> Int:
    """Return for each index of a window the end of the nested list that would start there."""
    size = len(window)
    step = np.concatenate((np.minimum(_list_ends(window, n_before), size + 1), [size + 1, size + 1]))
    place = np.full(size, size + 1)
    counts = window[n_before:]
    fits = (counts > 0) & (counts < size)
    place[: len(counts)] = np.where(fits, np.arange(1 + n_before, 1 + n_before + len(counts)), size + 1)
    n_lists = np.zeros(size, np.int64)
    n_lists[: len(counts)] = np.where(fits, counts, 0)
    # Binary expansion of the number of lists; ``step`` is squared in each round.
    while n_lists.any():
        odd = (n_lists & 1).astype(bool)
        place[odd] = step[place[odd]]
        step, n_lists = step[step], n_lists >> 1
    if len(counts) and (counts[0] < 1 or counts[0] >= _NEVER):
        place[0] = _NEVER
    return frozen_int(place)
