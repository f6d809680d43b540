"""Sorting, and a priority queue of cells, for use in kernels."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper


@helper
def sort_by_keys(items, keys, m):
    """Sort ``items[:m]`` and their ``keys[:m]`` together, by ascending keys (Shell sort)."""
    gap = 1
    while gap < m // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for k in range(gap, m):
            item, key, place = items[k], keys[k], k
            while place >= gap and keys[place - gap] > key:
                items[place], keys[place] = items[place - gap], keys[place - gap]
                place -= gap
            items[place], keys[place] = item, key
        gap //= 3


@helper
def stable_sort(order, values, spare):
    """Sort ``order (m,)`` by ``values``, stably (merge sort)."""
    m, width = len(order), 1
    while width < m:
        # Merge pairs of runs of length ``width``. Equal values from the first run come first.
        for start in range(0, m, 2 * width):
            middle, stop = min(start + width, m), min(start + 2 * width, m)
            i, j = start, middle
            for k in range(start, stop):
                if j == stop or (i < middle and values[order[i]] <= values[order[j]]):
                    spare[k] = order[i]
                    i += 1
                else:
                    spare[k] = order[j]
                    j += 1
        for k in range(m):
            order[k] = spare[k]
        width *= 2


@helper
def _sift_up(heap, keys, place, at):
    """Move the heap element at index ``at`` up until its parent has no smaller key."""
    cell, key = heap[at], keys[at]
    while at > 0:
        parent = (at - 1) // 2
        if keys[parent] >= key:
            break
        heap[at], keys[at] = heap[parent], keys[parent]
        place[heap[at]] = at
        at = parent
    heap[at], keys[at], place[cell] = cell, key, at


@helper
def _sift_down(heap, keys, place, at, size):
    """Move the heap element at index ``at`` down until its children have no larger keys."""
    cell, key = heap[at], keys[at]
    while 2 * at + 1 < size:
        below = 2 * at + 1
        if below + 1 < size and keys[below + 1] > keys[below]:
            below += 1
        if keys[below] <= key:
            break
        heap[at], keys[at] = heap[below], keys[below]
        place[heap[at]] = at
        at = below
    heap[at], keys[at], place[cell] = cell, key, at


@helper
def put_in(heap, keys, place, size, cell, key):
    """Insert a cell into the heap, or change its key, and return the heap size."""
    at = np.int64(place[cell])
    if at < 0:
        at, size = size, size + 1
        heap[at], keys[at] = cell, key
    else:
        keys[at] = key
        _sift_down(heap, keys, place, at, size)
        at = np.int64(place[cell])
    _sift_up(heap, keys, place, at)
    return size


@helper
def take_out(heap, keys, place, size):
    """Remove the cell with the largest key from the heap, and return the cell and the heap size."""
    cell, size = heap[0], size - 1
    place[cell] = -1
    if size > 0:
        heap[0], keys[0] = heap[size], keys[size]
        place[heap[0]] = 0
        _sift_down(heap, keys, place, np.int64(0), size)
    return np.int64(cell), size
