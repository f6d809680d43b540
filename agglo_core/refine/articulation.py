"""Articulation points: cells whose removal disconnects their part."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import kernel


@kernel
def cut_cells(indptr, indices, labels):
    """Mark the cells ``(n,)`` whose removal splits their part into more components.

    These are the articulation points of the graph without edges between different labels (Tarjan 1972,
    Hopcroft and Tarjan 1973), computed by a depth-first search with an explicit stack. ``number`` is a cell's
    number in search order. ``lowest`` is the smallest number that the cell's subtree reaches by one non-tree
    edge.
    """
    n = len(labels)
    number, lowest = np.full(n, -1, np.int64), np.empty(n, np.int64)
    parent, entry = np.full(n, -1, np.int64), indptr[:-1].copy()
    stack, cut = np.empty(n, np.int64), np.zeros(n, np.bool_)
    count = 0
    for root in range(n):
        # 1. Every cell not visited yet is the root of a spanning tree for its component.
        if number[root] >= 0:
            continue
        number[root] = lowest[root] = count
        count += 1
        stack[0], depth, branches = root, 1, 0
        while depth > 0:
            # 2. Take the next edge of the top cell. Edges to other labels are ignored. An edge to a visited
            #    cell lowers ``lowest``, except the edge back to the parent.
            i = stack[depth - 1]
            if entry[i] < indptr[i + 1]:
                j = indices[entry[i]]
                entry[i] += 1
                if labels[j] != labels[i]:
                    continue
                if number[j] >= 0:
                    if j != parent[i]:
                        lowest[i] = min(lowest[i], number[j])
                    continue
                # 3. A newly visited cell becomes a child.
                parent[j] = i
                number[j] = lowest[j] = count
                count += 1
                stack[depth] = j
                depth += 1
                if i == root:
                    branches += 1
                continue
            # 4. All edges are done. If the subtree does not reach above the parent, the parent cuts the
            #    subtree off.
            depth -= 1
            p = parent[i]
            if p >= 0:
                lowest[p] = min(lowest[p], lowest[i])
                if p != root and lowest[i] >= number[p]:
                    cut[p] = True
        # 5. A root is an articulation point if it has several children.
        cut[root] = branches > 1
    return cut
