"""The cut of a forest with at most so many parts whose costs add up to the least: a knapsack on trees.

Tables hold the least cost of each number of parts beyond the fewest. The children of a node are added up two
by two, and so are those sums, so that each sum knows what it was made of and no choice need be stored.

Nodes are numbered from the roots down, pairs of them after all nodes. The table of each is a range of
``tables``, from ``offsets[p]`` to ``offsets[p + 1]``: entry k is the least cost with k parts more than the
fewest.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@helper
def _pair_up(begin, end, n_pairs, left, right, lengths, most, queue):
    """Pair the nodes from ``begin`` to ``end``, then the pairs, until one is left; return it.

    Pairs are numbered after the nodes; ``left`` and ``right`` are their halves. Returns the number of pairs
    of all calls, too.
    """
    n_nodes = len(left)
    for p in range(begin, end):
        queue[p - begin] = p
    # The two that have waited longest become a pair, which waits behind the others: the tree is balanced.
    # Tables are no longer than ``most``: entries beyond are never used.
    head, tail = 0, end - begin
    while tail - head > 1:
        a, b = queue[head], queue[head + 1]
        left[n_pairs], right[n_pairs] = a, b
        made = n_nodes + n_pairs
        lengths[made] = min(lengths[a] + lengths[b] - 1, most)
        queue[tail] = made
        head, tail, n_pairs = head + 2, tail + 1, n_pairs + 1
    return queue[head], n_pairs


@helper
def _add_up(a, b, made, offsets, tables):
    """Fill the table of a pair with the least cost over all ways to share parts out to a and b."""
    begin, length = offsets[made], offsets[made + 1] - offsets[made]
    for k in range(length):
        tables[begin + k] = np.inf
    for i in range(min(offsets[a + 1] - offsets[a], length)):
        own = tables[offsets[a] + i]
        if own < np.inf:
            for j in range(min(offsets[b + 1] - offsets[b], length - i)):
                cost = own + tables[offsets[b] + j]
                if cost < tables[begin + i + j]:
                    tables[begin + i + j] = cost


@helper
def _share(a, b, k, offsets, tables):
    """Return how many of the k parts of a pair beyond the fewest belong to a."""
    best, least = 0, np.inf
    for i in range(min(offsets[a + 1] - offsets[a], k + 1)):
        if k - i < offsets[b + 1] - offsets[b]:
            cost = tables[offsets[a] + i] + tables[offsets[b] + k - i]
            if cost < least:
                best, least = i, cost
    return best


@helper
def _node_table(p, count, cost, top, offsets, tables):
    """Fill the table of a node: itself as one part, or its children together."""
    begin, fewest = offsets[p], count[p] - 1
    for k in range(1, offsets[p + 1] - begin):
        tables[begin + k] = tables[offsets[top[p]] + k - fewest] if k >= fewest else np.inf
    tables[begin] = cost[p]


@helper
def _fewest_of_least(begin, end, tables):
    """Index of the least cost of a table, the first of equal ones."""
    best = begin
    for k in range(begin, end):
        if tables[k] < tables[best]:
            best = k
    return best - begin


@helper
def _trace(whole, best, count, top, left, right, offsets, tables, queue, many, chosen):
    """Mark the nodes that make up the table entry ``best`` of ``whole``."""
    n_nodes, size = len(count), 1
    queue[0], many[0] = whole, best
    while size > 0:
        size -= 1
        p, k = queue[size], many[size]
        # A pair shares its k parts out to both halves, as its table did. A node with none beyond the fewest
        # is a part itself; with more, its children are, the fewest of which are count − 1 more than one.
        if p >= n_nodes:
            a, b = left[p - n_nodes], right[p - n_nodes]
            i = _share(a, b, k, offsets, tables)
            queue[size], many[size], queue[size + 1], many[size + 1] = a, i, b, k - i
            size += 2
        elif k == 0:
            chosen[p] = True
        else:
            queue[size], many[size] = top[p], k - (count[p] - 1)
            size += 1


@kernel
def least_cut(first, count, cost, roots, most):
    """Mark the nodes ``(N,)`` of the cut of least cost with at most ``most`` parts.

    ``cost (N,)`` is that of each node as a part; costs of a cut are added. Of equal cuts the one of fewest
    parts is marked.
    """
    n_nodes = len(first)
    left, right = np.empty(n_nodes, np.int64), np.empty(n_nodes, np.int64)
    lengths, queue = np.ones(2 * n_nodes, np.int64), np.empty(2 * n_nodes, np.int64)
    top, pairs = np.full(n_nodes, -1, np.int64), np.zeros(n_nodes + 1, np.int64)
    # 1. Lengths of all tables, from the leaves up: children have larger numbers. ``pairs`` counts the pairs
    #    made up to each node, for the order of step 3.
    room, n_pairs = most - roots + 1, 0
    for p in range(n_nodes - 1, -1, -1):
        if count[p] > 0:
            begin, end = first[p], first[p] + count[p]
            top[p], n_pairs = _pair_up(begin, end, n_pairs, left, right, lengths, room, queue)
            lengths[p] = min(lengths[top[p]] + count[p] - 1, room)
        pairs[n_nodes - p] = n_pairs
    # 2. The roots are paired, too; then tables get their places.
    whole, n_pairs = _pair_up(0, roots, n_pairs, left, right, lengths, room, queue)
    offsets = np.zeros(n_nodes + n_pairs + 1, np.int64)
    for p in range(n_nodes + n_pairs):
        offsets[p + 1] = offsets[p] + lengths[p]
    # 3. Tables from the leaves up: those of the pairs of a node's children, then its own; at last those of
    #    the roots.
    tables = np.empty(offsets[n_nodes + n_pairs])
    for p in range(n_nodes - 1, -1, -1):
        for k in range(pairs[n_nodes - 1 - p], pairs[n_nodes - p]):
            _add_up(left[k], right[k], n_nodes + k, offsets, tables)
        _node_table(p, count, cost, top, offsets, tables)
    for k in range(pairs[n_nodes], n_pairs):
        _add_up(left[k], right[k], n_nodes + k, offsets, tables)
    # 4. The least cost of the whole forest, traced back to the nodes that add up to it.
    best = _fewest_of_least(offsets[whole], offsets[whole + 1], tables)
    chosen, many = np.zeros(n_nodes, np.bool_), np.empty(2 * n_nodes, np.int64)
    _trace(whole, best, count, top, left, right, offsets, tables, queue, many, chosen)
    return chosen
