"""Find the cut through trees with minimum cost and a bounded part count: a knapsack on trees.

Tables hold the minimum cost for each part count above the minimum. Children of a node are summed in
pairs, and so are these sums, so that the choices follow from the tables and need no storage.

Nodes are numbered from the roots down, pairs follow after all nodes. The table of node p is
``tables[offsets[p]:offsets[p + 1]]``: entry k is the minimum cost with k parts above the minimum.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@helper
def _pair_up(begin, end, n_pairs, left_half, right_half, lengths, most, queue):
    """Build a balanced binary tree over the nodes ``begin`` to ``end``, and return its root.

    Pairs are numbered after the nodes; ``left_half`` and ``right_half`` are their halves. Also returns the
    pair count over all calls.
    """
    n_nodes = len(left_half)
    for p in range(begin, end):
        queue[p - begin] = p
    # A queue: the two oldest entries become a pair at the end, so the tree is balanced. Tables have at most
    # ``most`` entries, because later entries are never used.
    head, tail = 0, end - begin
    while tail - head > 1:
        a, b = queue[head], queue[head + 1]
        left_half[n_pairs], right_half[n_pairs] = a, b
        pair = n_nodes + n_pairs
        lengths[pair] = min(lengths[a] + lengths[b] - 1, most)
        queue[tail] = pair
        head, tail, n_pairs = head + 2, tail + 1, n_pairs + 1
    return queue[head], n_pairs


@helper
def _add_up(a, b, pair, offsets, tables):
    """Fill a pair's cost table: minimum cost over all distributions of its parts to halves a and b."""
    begin, length = offsets[pair], offsets[pair + 1] - offsets[pair]
    for k in range(length):
        tables[begin + k] = np.inf
    for i in range(min(offsets[a + 1] - offsets[a], length)):
        cost_a = tables[offsets[a] + i]
        if cost_a < np.inf:
            for j in range(min(offsets[b + 1] - offsets[b], length - i)):
                cost = cost_a + tables[offsets[b] + j]
                if cost < tables[begin + i + j]:
                    tables[begin + i + j] = cost


@helper
def _share(a, b, k, offsets, tables):
    """Return how many of a pair's k additional parts belong to its half a in the optimum."""
    best, least = 0, np.inf
    for i in range(min(offsets[a + 1] - offsets[a], k + 1)):
        if k - i < offsets[b + 1] - offsets[b]:
            cost = tables[offsets[a] + i] + tables[offsets[b] + k - i]
            if cost < least:
                best, least = i, cost
    return best


@helper
def _node_table(p, count, cost, top, offsets, tables):
    """Fill a node's cost table: the node itself as one part, or its children with more parts."""
    begin, fewest = offsets[p], count[p] - 1
    for k in range(1, offsets[p + 1] - begin):
        tables[begin + k] = tables[offsets[top[p]] + k - fewest] if k >= fewest else np.inf
    tables[begin] = cost[p]


@helper
def _fewest_of_least(begin, end, tables):
    """Return the index of the smallest table entry, the first among equals."""
    best = begin
    for k in range(begin, end):
        if tables[k] < tables[best]:
            best = k
    return best - begin


@helper
def _trace(root, best, count, top, left_half, right_half, offsets, tables, queue, n_extra, is_part):
    """Mark the nodes of the optimal cut, from the table entry ``best`` of ``root`` down."""
    n_nodes, size = len(count), 1
    queue[0], n_extra[0] = root, best
    while size > 0:
        size -= 1
        p, k = queue[size], n_extra[size]
        # A pair distributes its k parts to both halves as in its table. A node without additional parts is a
        # part itself; otherwise its children are parts, whose minimum number is count − 1 above one.
        if p >= n_nodes:
            a, b = left_half[p - n_nodes], right_half[p - n_nodes]
            i = _share(a, b, k, offsets, tables)
            queue[size], n_extra[size], queue[size + 1], n_extra[size + 1] = a, i, b, k - i
            size += 2
        elif k == 0:
            is_part[p] = True
        else:
            queue[size], n_extra[size] = top[p], k - (count[p] - 1)
            size += 1


@kernel
def least_cut(first, count, cost, roots, most):
    """Mark the nodes ``(N,)`` of the minimum-cost cut with at most ``most`` parts.

    ``cost (N,)`` is the cost of each node as a part; costs add up over a cut. Of equal cuts, the cut with the
    fewest parts is marked.
    """
    n_nodes = len(first)
    left_half, right_half = np.empty(n_nodes, np.int64), np.empty(n_nodes, np.int64)
    lengths, queue = np.ones(2 * n_nodes, np.int64), np.empty(2 * n_nodes, np.int64)
    top, pairs = np.full(n_nodes, -1, np.int64), np.zeros(n_nodes + 1, np.int64)
    # 1. Lengths of all tables, from the leaves up (children have larger numbers). ``pairs`` counts the pairs
    #    up to each node, for the order in step 3.
    max_length, n_pairs = most - roots + 1, 0
    for p in range(n_nodes - 1, -1, -1):
        if count[p] > 0:
            begin, end = first[p], first[p] + count[p]
            top[p], n_pairs = _pair_up(begin, end, n_pairs, left_half, right_half, lengths, max_length, queue)
            lengths[p] = min(lengths[top[p]] + count[p] - 1, max_length)
        pairs[n_nodes - p] = n_pairs
    # 2. Pair the roots, then compute the table positions.
    root, n_pairs = _pair_up(0, roots, n_pairs, left_half, right_half, lengths, max_length, queue)
    offsets = np.zeros(n_nodes + n_pairs + 1, np.int64)
    for p in range(n_nodes + n_pairs):
        offsets[p + 1] = offsets[p] + lengths[p]
    # 3. Fill the tables from the leaves up: pairs of children, then the node itself, finally the pairs of
    #    roots.
    tables = np.empty(offsets[n_nodes + n_pairs])
    for p in range(n_nodes - 1, -1, -1):
        for k in range(pairs[n_nodes - 1 - p], pairs[n_nodes - p]):
            _add_up(left_half[k], right_half[k], n_nodes + k, offsets, tables)
        _node_table(p, count, cost, top, offsets, tables)
    for k in range(pairs[n_nodes], n_pairs):
        _add_up(left_half[k], right_half[k], n_nodes + k, offsets, tables)
    # 4. Take the minimum cost of the whole forest and trace it back to its nodes.
    best = _fewest_of_least(offsets[root], offsets[root + 1], tables)
    is_part, n_extra = np.zeros(n_nodes, np.bool_), np.empty(2 * n_nodes, np.int64)
    _trace(root, best, count, top, left_half, right_half, offsets, tables, queue, n_extra, is_part)
    return is_part
