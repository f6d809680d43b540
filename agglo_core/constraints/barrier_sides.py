"""Divide parts with a barrier inside into its two sides, continued beyond the barrier's tips."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import kernel


@kernel
def barrier_sides(indptr, indices, labels, first, across):
    """Assign each node to side 0 or 1 of the barriers inside its part.

    Nodes in parts without an interior barrier are on side 0. ``indptr`` and ``indices`` are the graph,
    ``labels`` the parts.

    A barrier separates node i from the nodes ``across[first[i]:first[i + 1]]`` in its part. These nodes go to
    the other side unless already assigned, and neighbours of node i at a barrier go to its own side. Then the
    sides grow, one layer of neighbours at a time.
    """
    n = len(labels)
    # 1. Nodes along barriers, breadth-first from each unassigned node. Nodes across the barrier are assigned
    #    before neighbours on the own side.
    sides, queue, count = np.full(n, -1, np.int64), np.empty(n, np.int64), 0
    for seed in range(n):
        if first[seed] == first[seed + 1] or sides[seed] >= 0:
            continue
        sides[seed], queue[count] = 0, seed
        head, count = count, count + 1
        while head < count:
            i = queue[head]
            head += 1
            for k in range(first[i], first[i + 1]):
                j = across[k]
                if sides[j] < 0:
                    sides[j], queue[count] = 1 - sides[i], j
                    count += 1
            for k in range(indptr[i], indptr[i + 1]):
                j = indices[k]
                if sides[j] < 0 and labels[j] == labels[i] and first[j] < first[j + 1]:
                    sides[j], queue[count] = sides[i], j
                    count += 1
    # 2. The rest of each part, from all barrier nodes at once: each node gets the side of the nearest barrier
    #    node, layer by layer.
    head = 0
    while head < count:
        i = queue[head]
        head += 1
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            if sides[j] < 0 and labels[j] == labels[i]:
                sides[j], queue[count] = sides[i], j
                count += 1
    # 3. Nodes beyond the reach of all barriers.
    for i in range(n):
        sides[i] = max(sides[i], 0)
    return sides
