"""Kernels for cuts through a forest: refinement of the largest values first, and grading.

``trees`` are the cells in forest order, the range ``start[p]:stop[p]`` per node p, its first child, child
count, finest level and coarsest level. The children of p are ``count[p]`` nodes from ``first[p]``; ``at``
holds the node of each cell.
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
    """Split nodes that are too coarse for adjacent cells at positions ``begin`` to ``end``.

    ``room`` is the number of parts that may be added. Split nodes are appended to the log. Returns the log
    length and the remaining room, which is negative if it was too small.
    """
    cells, count, finest, coarsest = trees[0], trees[4], trees[5], trees[6]
    for k in range(begin, end):
        x = cells[k]
        for h in range(near[0][x], near[0][x + 1]):
            y = near[1][h]
            # Split the node of a neighbour until its finest level is at most ``grade`` above the coarsest
            # level of the node here, which may take several splits.
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
    """Grade around the log entries from ``done`` on, and around the nodes split in the process."""
    start, stop = trees[1], trees[2]
    while done < n_log and room >= 0:
        p = log[done]
        n_log, room = _grade_around(start[p], stop[p], trees, near, grade, at, log, n_log, room)
        done += 1
    return n_log, room


@kernel
def refine_largest(trees, near, grade, value, roots, most):
    """Return the node of each cell ``(n,)`` in the cut that splits the largest value first.

    The cut has at most ``most`` parts.

    ``value (N,)`` is given per node; the first ``roots`` nodes are the roots. Nodes without children or value
    are not split, nor are nodes that would create too many parts. With ``grade`` ≥ 0, neighbours are split
    until their levels differ by at most ``grade``.
    """
    cells, start, _, first, count = trees[:5]
    at = np.empty(len(cells), np.int64)
    heap, keys = np.empty(len(start), np.int64), np.empty(len(start))
    place = np.full(len(start), -1, np.int64)
    log = np.empty(len(start), np.int64)
    size, room = 0, most - roots
    # 1. The cut begins with the roots; divisible roots enter the heap.
    for p in range(roots):
        _join(p, trees, at)
        if count[p] > 0 and value[p] > 0.0:
            size = put_in(heap, keys, place, size, p, value[p])
    while size > 0 and room > 0:
        # 2. Take the largest value, unless grading has already split the node or it has too many children.
        p, size = take_out(heap, keys, place, size)
        if at[cells[start[p]]] != p or count[p] - 1 > room:
            continue
        # 3. Split the node, and grade around the split. The log contains all split nodes.
        _split(p, trees, at)
        log[0] = p
        n_log, left = 1, room - (count[p] - 1)
        if grade >= 0:
            n_log, left = _settle(0, trees, near, grade, at, log, n_log, left)
        # 4. Too many parts: undo the log in reverse order, so the node is not split.
        if left < 0:
            for i in range(n_log - 1, -1, -1):
                _join(log[i], trees, at)
            continue
        # 5. Accepted: divisible new nodes enter the heap.
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
