"""Articulation points: cells that hold their part together."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import kernel


@kernel
def cut_cells(indptr, indices, labels):
    """Mark the cells ``(n,)`` that leave their part in more pieces when they are taken out of it.

    The articulation points of the graph without its edges between labels (Tarjan 1972, Hopcroft and
    Tarjan 1973), by a depth-first search with a stack of its own. ``found`` is the number of a cell in the
    order of the search, ``lowest`` the least such number that its subtree reaches by one edge off the tree.
    """
    n = len(labels)
    found, lowest = np.full(n, -1, np.int64), np.empty(n, np.int64)
    parent, entry = np.full(n, -1, np.int64), indptr[:-1].copy()
    stack, cut = np.empty(n, np.int64), np.zeros(n, np.bool_)
    count = 0
    for root in range(n):
        # 1. Every cell not found so far is the root of a tree that spans its component.
        if found[root] >= 0:
            continue
        found[root] = lowest[root] = count
        count += 1
        stack[0], depth, branches = root, 1, 0
        while depth > 0:
            # 2. Next edge of the cell on top. Edges to other labels do not count; one to a cell found before
            #    lowers ``lowest``, except the one that leads back to the parent.
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
                # 3. A cell found now becomes a child.
                parent[j] = i
                found[j] = lowest[j] = count
                count += 1
                stack[depth] = j
                depth += 1
                if i == root:
                    branches += 1
                continue
            # 4. All edges were taken. If the subtree does not reach above the parent, the parent cuts it
            #    off.
            depth -= 1
            p = parent[i]
            if p >= 0:
                lowest[p] = min(lowest[p], lowest[i])
                if p != root and lowest[i] >= found[p]:
                    cut[p] = True
        # 5. Nothing is above a root: it cuts if it has several children.
        cut[root] = branches > 1
    return cut
