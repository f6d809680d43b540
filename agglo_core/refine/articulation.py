"""Articulation points: cells that hold their part together."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import kernel


@kernel
def cut_cells(indptr, indices, labels):
    """Which cells leave their part in more pieces when they are taken out of it.

    The articulation points of the graph without its edges between labels (Tarjan 1972, Hopcroft and
    Tarjan 1973), by a depth-first search with a stack of its own.
    """
    n = len(labels)
    found, lowest = np.full(n, -1, np.int64), np.empty(n, np.int64)
    parent, entry = np.full(n, -1, np.int64), indptr[:-1].copy()
    stack, cut = np.empty(n, np.int64), np.zeros(n, np.bool_)
    count = 0
    for root in range(n):
        if found[root] >= 0:
            continue
        found[root] = lowest[root] = count
        count += 1
        stack[0], depth, branches = root, 1, 0
        while depth > 0:
            i = stack[depth - 1]
            if entry[i] < indptr[i + 1]:
                j = indices[entry[i]]
                entry[i] += 1
                if labels[j] != labels[i]:
                    continue
                if found[j] >= 0:
                    if j != parent[i]:
                        lowest[i] = min(lowest[i], found[j])
                    continue
                parent[j] = i
                found[j] = lowest[j] = count
                count += 1
                stack[depth] = j
                depth += 1
                if i == root:
                    branches += 1
                continue
            depth -= 1
            p = parent[i]
            if p >= 0:
                lowest[p] = min(lowest[p], lowest[i])
                if p != root and lowest[i] >= found[p]:
                    cut[p] = True
        cut[root] = branches > 1
    return cut
