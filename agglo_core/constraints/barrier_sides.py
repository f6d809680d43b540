"""The two sides of barriers inside parts, continued beyond their tips."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import kernel


@kernel
def barrier_sides(indptr, indices, labels, first, across):
    """Assign each node a side, 0 or 1, of the barriers inside its part.

    Nodes of parts without a barrier inside are on side 0. The graph is ``indptr`` and ``indices``, the parts
    are ``labels``.

    Node i has a barrier between itself and the nodes ``across[first[i]:first[i + 1]]`` of its part. Those
    are put on the other side where that has not been decided before, neighbours that also touch a barrier on
    the same one; then the sides grow, a layer of neighbours at a time.
    """
    n = len(labels)
    # 1. Nodes along barriers, breadth first from each one that has no side yet. Across the barrier comes
    #    first: nodes that touch it go to the other side before neighbours go to the same one.
    sides, queue, count = np.full(n, -1, np.int64), np.empty(n, np.int64), 0
    for seed in range(n):
        if first[seed] == first[seed + 1] or sides[seed] >= 0:
            continue
        sides[seed], queue[count] = 0, seed
        done, count = count, count + 1
        while done < count:
            i = queue[done]
            done += 1
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
    # 2. The rest of each part, from all nodes along barriers at once: each gets the side of the nearest of
    #    them, in layers of neighbours.
    done = 0
    while done < count:
        i = queue[done]
        done += 1
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            if sides[j] < 0 and labels[j] == labels[i]:
                sides[j], queue[count] = sides[i], j
                count += 1
    # 3. Nodes that no barrier reaches.
    for i in range(n):
        sides[i] = max(sides[i], 0)
    return sides
