"""A heap of cells, of which that with the largest key is taken out first; each is in it once.

``place`` tells where in the heap a cell is, −1 for nowhere.
"""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper


@helper
def _sift_up(heap, keys, place, at):
    """Move the entry ``at`` up to where the one above it has a larger key."""
    cell, key = heap[at], keys[at]
    while at > 0:
        above = (at - 1) // 2
        if keys[above] >= key:
            break
        heap[at], keys[at] = heap[above], keys[above]
        place[heap[at]] = at
        at = above
    heap[at], keys[at], place[cell] = cell, key, at


@helper
def _sift_down(heap, keys, place, at, size):
    """Move the entry ``at`` down to where those below it have smaller keys."""
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
    """Put a cell in the heap, or give it another key; returns the size."""
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
    """Take the cell of the largest key out of the heap; returns it and the size."""
    cell, size = heap[0], size - 1
    place[cell] = -1
    if size > 0:
        heap[0], keys[0] = heap[size], keys[size]
        place[heap[0]] = 0
        _sift_down(heap, keys, place, np.int64(0), size)
    return np.int64(cell), size
