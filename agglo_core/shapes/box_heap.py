"""A heap (priority queue) of boxes with the largest bound on top, for branch and bound.

The row of a box begins with its bound. In 2-D the other numbers are the centre x, y, both half sides, the
signed distance from the centre to the boundary (0 if unknown), the first and the last column of the relevant
edges, and the axis to halve. In 3-D they are the centre x, y, z, three half sides, 1 if the whole box is
inside (0 if unknown), and the first and the last column.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper

WIDTH = 10  # numbers per row, see above


@helper
def _move(source, i, target, j):
    """Copy row i of ``source`` to row j of ``target``.

    Number by number, because slices take numba a second longer to compile.
    """
    for k in range(WIDTH):
        target[j, k] = source[i, k]


@helper
def pop(heap, size, box):
    """Remove the box with the largest bound from a heap with ``size`` boxes, and write it to ``box``."""
    i, j = np.int64(0), np.int64(1)  # typed, because literals would compile another version of every kernel
    _move(heap, i, box, i)
    while j < size - 1:  # move the last entry to the top and sift it down
        if j + 1 < size - 1 and heap[j + 1, 0] > heap[j, 0]:
            j += 1
        if heap[j, 0] <= heap[size - 1, 0]:
            break
        _move(heap, j, heap, i)
        i, j = j, 2 * j + 1
    _move(heap, size - 1, heap, i)


@helper(allocates=True)
def push(heap, size, box):
    """Insert a box in a heap with ``size`` boxes, and return the heap, enlarged if it was full."""
    # 1. Enlarge a full heap.
    if size == len(heap):
        new_heap = np.empty((2 * size, WIDTH))
        for i in range(size):
            _move(heap, i, new_heap, i)
        heap = new_heap
    # 2. Sift the new box up.
    i = size
    while i > 0 and heap[(i - 1) // 2, 0] < box[0, 0]:
        _move(heap, (i - 1) // 2, heap, i)
        i = (i - 1) // 2
    _move(box, np.int64(0), heap, i)
    return heap
