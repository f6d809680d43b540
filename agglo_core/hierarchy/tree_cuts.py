"""Compiled loops for cuts through trees: split the largest values first, limit level differences.

``trees`` are the cells in forest order, the range ``start[p]:stop[p]`` per node p, its first child, child
count, finest level and coarsest level. The children of p are ``count[p]`` nodes from ``first[p]``;
``node_of`` holds the node per cell.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.compiled.sorting import put_in, take_out


@helper
def _split(p, trees, node_of):
    """Replace node p of a cut by its children."""
    cells, start, stop, first, count = trees[:5]
    for child in range(first[p], first[p] + count[p]):
        for k in range(start[child], stop[child]):
            node_of[cells[k]] = child


@helper
def _join(p, trees, node_of):
    """Replace all descendants of node p in a cut by p."""
    cells, start, stop = trees[:3]
    for k in range(start[p], stop[p]):
        node_of[cells[k]] = p


@helper
def _grade_around(begin, end, trees, adjacency, grade, node_of, log, n_log, budget):
    """Split nodes that are too coarse next to the cells ``begin`` to ``end`` in tree order.

    ``budget`` is the number of parts that may be added. Split nodes are appended to the log. Returns the log
    length and the remaining budget, which is negative if it was too small.
    """
    cells, count, finest, coarsest = trees[0], trees[4], trees[5], trees[6]
    for k in range(begin, end):
        x = cells[k]
        for h in range(adjacency[0][x], adjacency[0][x + 1]):
            y = adjacency[1][h]
            # Split the node of a neighbour until its finest level is at most ``grade`` above the coarsest
            # level of the node here, which may take several splits.
            while finest[node_of[y]] - coarsest[node_of[x]] > grade:
                q = node_of[y]
                budget -= count[q] - 1
                if budget < 0:
                    return n_log, budget
                _split(q, trees, node_of)
                log[n_log] = q
                n_log += 1
    return n_log, budget


@helper
def _settle(n_settled, trees, adjacency, grade, node_of, log, n_log, budget):
    """Split too coarse neighbours of the nodes logged from ``n_settled`` on, including newly logged ones."""
    start, stop = trees[1], trees[2]
    while n_settled < n_log and budget >= 0:
        p = log[n_settled]
        n_log, budget = _grade_around(start[p], stop[p], trees, adjacency, grade, node_of, log, n_log, budget)
        n_settled += 1
    return n_log, budget


@kernel
def refine_largest(trees, adjacency, grade, value, roots, most):
    """Refine a cut from the roots, largest value first, and return the node per cell ``(n,)``.

    The cut has at most ``most`` parts.

    ``value (N,)`` is given per node; the first ``roots`` nodes are the roots. Nodes without children or value
    are not split, nor are nodes that would create too many parts. With ``grade`` ≥ 0, neighbours are split
    until their levels differ by at most ``grade``.
    """
    cells, start, _, first, count = trees[:5]
    node_of = np.empty(len(cells), np.int64)
    heap, keys = np.empty(len(start), np.int64), np.empty(len(start))
    place = np.full(len(start), -1, np.int64)
    log = np.empty(len(start), np.int64)
    size, budget = 0, most - roots
    # 1. The cut begins with the roots; divisible roots enter the heap.
    for p in range(roots):
        _join(p, trees, node_of)
        if count[p] > 0 and value[p] > 0.0:
            size = put_in(heap, keys, place, size, p, value[p])
    while size > 0 and budget > 0:
        # 2. Take the largest value, unless grading has already split the node or it has too many children.
        p, size = take_out(heap, keys, place, size)
        if node_of[cells[start[p]]] != p or count[p] - 1 > budget:
            continue
        # 3. Split the node, and grade around the split. The log contains all split nodes.
        _split(p, trees, node_of)
        log[0] = p
        n_log, new_budget = 1, budget - (count[p] - 1)
        if grade >= 0:
            n_log, new_budget = _settle(0, trees, adjacency, grade, node_of, log, n_log, new_budget)
        # 4. Too many parts: undo the log in reverse order, so the node is not split.
        if new_budget < 0:
            for i in range(n_log - 1, -1, -1):
                _join(log[i], trees, node_of)
            continue
        # 5. Accepted: divisible new nodes enter the heap.
        budget = new_budget
        for i in range(n_log):
            for child in range(first[log[i]], first[log[i]] + count[log[i]]):
                if count[child] > 0 and value[child] > 0.0:
                    size = put_in(heap, keys, place, size, child, value[child])
    return node_of


@kernel
def make_graded(trees, adjacency, grade, node_of):
    """Split nodes of a cut (``node_of`` each cell) until adjacent levels differ by at most ``grade``."""
    n = len(trees[0])
    log = np.empty(len(trees[1]), np.int64)
    n_log, _ = _grade_around(0, n, trees, adjacency, grade, node_of, log, 0, n)
    _settle(0, trees, adjacency, grade, node_of, log, n_log, n)
