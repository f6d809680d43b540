"""Cuts through a forest: the nodes of largest value refined first, and cuts made graded.

``trees`` are the cells in the order of the forest, the range ``start[p]:stop[p]`` of them in each node p, its
first child and number of children, the finest and the coarsest level that it is a part of. The children of p
are ``first[p]``, …, ``count[p]`` of them; ``at`` holds the node of each cell.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.compiled.sorting import put_in, take_out


@helper
def _split(p, trees, at):
    """Replace node p by its children."""
    cells, start, stop, first, count = trees[:5]
    for child in range(first[p], first[p] + count[p]):
        for k in range(start[child], stop[child]):
            at[cells[k]] = child


@helper
def _join(p, trees, at):
    """Replace all nodes below p by p."""
    cells, start, stop = trees[:3]
    for k in range(start[p], stop[p]):
        at[cells[k]] = p


@helper
def _grade_around(begin, end, trees, near, grade, at, log, n_log, room):
    """Split nodes that are too coarse for the cells at places ``begin`` to ``end`` adjacent to them.

    ``room`` is how many more parts there may be. Nodes split are added to the log. Returns its length and the
    room left, which is negative if it was too small.
    """
    cells, count, finest, coarsest = trees[0], trees[4], trees[5], trees[6]
    for k in range(begin, end):
        x = cells[k]
        for h in range(near[0][x], near[0][x + 1]):
            y = near[1][h]
            # The node of a neighbour is split until its finest level is at most ``grade`` above the coarsest
            # level of the node here. One split may not be enough.
            while finest[at[y]] - coarsest[at[x]] > grade:
                q = at[y]
                room -= count[q] - 1
                if room < 0:
                    return n_log, room
                _split(q, trees, at)
                log[n_log] = q
                n_log += 1
    return n_log, room


@helper
def _settle(done, trees, near, grade, at, log, n_log, room):
    """Grade around the nodes of the log from ``done`` on, and around those split on the way."""
    start, stop = trees[1], trees[2]
    while done < n_log and room >= 0:
        p = log[done]
        n_log, room = _grade_around(start[p], stop[p], trees, near, grade, at, log, n_log, room)
        done += 1
    return n_log, room


@kernel
def refine_largest(trees, near, grade, value, roots, most):
    """Node of each cell ``(n,)`` in the cut of at most ``most`` parts that splits the largest value first.

    ``value (N,)`` is that of each node; the first ``roots`` nodes are the roots. Nodes that have no children,
    or no value, stay, as do those that would make too many. With a grade of 0 or more neighbours are split
    until their levels differ by no more than that.
    """
    cells, start, _, first, count = trees[:5]
    at = np.empty(len(cells), np.int64)
    heap, keys = np.empty(len(start), np.int64), np.empty(len(start))
    place = np.full(len(start), -1, np.int64)
    log = np.empty(len(start), np.int64)
    size, room = 0, most - roots
    # 1. The cut begins with the roots; those that can be split go into the heap.
    for p in range(roots):
        _join(p, trees, at)
        if count[p] > 0 and value[p] > 0.0:
            size = put_in(heap, keys, place, size, p, value[p])
    while size > 0 and room > 0:
        # 2. The largest value, unless grading has split the node already or its children are too many.
        p, size = take_out(heap, keys, place, size)
        if at[cells[start[p]]] != p or count[p] - 1 > room:
            continue
        # 3. Split it, and grade around what was split. All nodes split are in the log.
        _split(p, trees, at)
        log[0] = p
        n_log, left = 1, room - (count[p] - 1)
        if grade >= 0:
            n_log, left = _settle(0, trees, near, grade, at, log, n_log, left)
        # 4. Too many parts: the log is undone, those below before those above, and the node stays.
        if left < 0:
            for i in range(n_log - 1, -1, -1):
                _join(log[i], trees, at)
            continue
        # 5. Kept: all new nodes that can be split go into the heap.
        room = left
        for i in range(n_log):
            for child in range(first[log[i]], first[log[i]] + count[log[i]]):
                if count[child] > 0 and value[child] > 0.0:
                    size = put_in(heap, keys, place, size, child, value[child])
    return at


@kernel
def make_graded(trees, near, grade, at):
    """Split nodes ``at`` each cell until the levels of neighbours differ by at most ``grade``."""
    n = len(trees[0])
    log = np.empty(len(trees[1]), np.int64)
    n_log, _ = _grade_around(0, n, trees, near, grade, at, log, 0, n)
    _settle(0, trees, near, grade, at, log, n_log, n)
