"""The inside of a thin outline in trapezoids, each between two edges and the vertical lines through vertices.

No circle in an outline is wider than the vertical line through its centre is long inside. On a trapezoid
that is at most the longer of its two vertical sides: of a thin outline few are left once a circle about the
middle of the longest side is known.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper
from agglo_core.compiled.sorting import sort_by_keys
from agglo_core.shapes.box_heap import push
from agglo_core.shapes.circle_edges import signed_distance

_CROWD = 24  # edges beside one another, on average, from which on trapezoids are dearer than boxes


@helper
def _next_slab(edges, order, begins, active, count, begun, left):
    """Let edges that end at ``left`` leave the active ones, those that begin there join.

    Returns how many are active and how many have begun, and where the slab lies: from ``left``, or where
    the next edge begins if none is active, to the next vertex.
    """
    kept, right = 0, np.inf
    for k in range(count):
        i = active[k]
        end = max(edges[0, i], edges[4, i])
        if end > left:
            active[kept], right = i, min(right, end)
            kept += 1
    if kept == 0 and begun < len(order):
        left = begins[begun]
    while begun < len(order) and begins[begun] <= left:
        i = order[begun]
        end = max(edges[0, i], edges[4, i])
        if end > left:  # a vertical edge bounds no trapezoid from above or below
            active[kept], right = i, min(right, end)
            kept += 1
        begun += 1
    return kept, begun, left, min(right, begins[begun]) if begun < len(order) else right


@helper
def _sort_upwards(edges, active, one, two, count, left, right):
    """Sort the active edges by height; theirs at ``left`` and ``right`` are left in ``one`` and ``two``."""
    for k in range(count):
        i, place = active[k], k
        slope = edges[3, i] / edges[2, i]
        a, b = edges[1, i] + (left - edges[0, i]) * slope, edges[1, i] + (right - edges[0, i]) * slope
        while place > 0 and one[place - 1] + two[place - 1] > a + b:
            active[place], one[place], two[place] = active[place - 1], one[place - 1], two[place - 1]
            place -= 1
        active[place], one[place], two[place] = i, a, b


@helper(allocates=True)
def slabs(edges, m, best, accuracy, heap, box):
    """Push the box around each trapezoid in which there may be a larger circle than the best so far.

    That is one of radius ``best`` about the origin, or about the middle of one of the longest vertical lines
    looked at; one is larger if it is so by a factor of ``1 + accuracy``. Returns the centre and the radius
    of the best, the heap and its size, and whether it holds all trapezoids: not if there were too many.
    """
    order, begins = np.empty(m, np.int64), np.empty(m)
    for i in range(m):
        order[i], begins[i] = i, min(edges[0, i], edges[4, i])
    sort_by_keys(order, begins, np.int64(m))
    active, one, two = np.empty(m, np.int64), np.empty(m), np.empty(m)
    best_x, best_y, longest, size = 0.0, 0.0, 0.0, np.int64(0)
    count, begun, work, left = 0, 0, 0, begins[0]
    while work <= _CROWD * m:
        count, begun, left, right = _next_slab(edges, order, begins, active, count, begun, left)
        if count == 0:
            break
        work += count
        _sort_upwards(edges, active, one, two, count, left, right)
        for k in range(0, count - 1, 2):
            a, b, c, d = one[k], one[k + 1], two[k], two[k + 1]
            length = max(b - a, d - c)
            if length > longest:
                longest = length
                x, y = (left, 0.5 * (a + b)) if b - a >= d - c else (right, 0.5 * (c + d))
                radius = signed_distance(edges, m, x, y)
                if radius > best:
                    best, best_x, best_y = radius, x, y
            if 0.5 * length > best * (1.0 + accuracy):
                low, high = min(a, c), max(b, d)
                box[0, 0], box[0, 1], box[0, 2] = 0.5 * length, 0.5 * (left + right), 0.5 * (low + high)
                box[0, 3], box[0, 4] = 0.5 * (right - left), 0.5 * (high - low)
                box[0, 5], box[0, 6], box[0, 7] = 0.0, 0.0, m
                box[0, 8] = 0.0 if right - left >= high - low else 1.0
                heap = push(heap, size, box)
                size += 1
        left = right
    return best_x, best_y, best, heap, size, count == 0
