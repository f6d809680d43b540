"""A heap of boxes, the one with the largest bound on top.

Its rows are numbers, the bound first. Others in the plane: the centre x, y, both half sides, the signed
distance of the centre from the boundary (0 if it is not known), the first and the last column of the edges
that matter, and the axis along which the box is to be halved. In space: the centre x, y, z, three half
sides, 1 if all of the box is inside (0 if it is not known), the first and the last column.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper

WIDTH = 10  # numbers in a row


@helper
def _move(source, i, target, j):
    """Copy a row number by number: slices take numba a second longer to compile."""
    for k in range(WIDTH):
        target[j, k] = source[i, k]


@helper
def pop(heap, size, box):
    """Move the box with the largest bound, on top, off the heap of ``size``."""
    i, j = np.int64(0), np.int64(1)  # as constants they would have a version of every kernel compiled
    _move(heap, i, box, i)
    while j < size - 1:  # the last entry takes the first place and sinks
        if j + 1 < size - 1 and heap[j + 1, 0] > heap[j, 0]:
            j += 1
        if heap[j, 0] <= heap[size - 1, 0]:
            break
        _move(heap, j, heap, i)
        i, j = j, 2 * j + 1
    _move(heap, size - 1, heap, i)


@helper(allocates=True)
def push(heap, size, box):
    """Put a box on the heap of ``size``, in a longer copy if it is full."""
    if size == len(heap):
        grown = np.empty((2 * size, WIDTH))
        for i in range(size):
            _move(heap, i, grown, i)
        heap = grown
    i = size
    while i > 0 and heap[(i - 1) // 2, 0] < box[0, 0]:
        _move(heap, (i - 1) // 2, heap, i)
        i = (i - 1) // 2
    _move(box, np.int64(0), heap, i)
    return heap
