"""Find bisected blocks with a disconnected side."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.compiled.graphs import flood
from agglo_core.compiled.ring_search import are_connected

# Nodes per cut node below which a block is flooded as a whole, instead of searched from its cut nodes. Larger
# floods more blocks, smaller starts more searches (benchmarks/pathologies.py, bisector metis).
_THIN = 4


@helper
def _beside(start, stop, indptr, indices, sides, edge):
    """List the block's nodes adjacent to the other side, and return their number."""
    m = np.int64(0)
    for i in range(start, stop):
        side, is_adjacent = sides[i], False
        for h in range(indptr[i], indptr[i + 1]):
            is_adjacent |= sides[indices[h]] != side  # no branch: it would be mispredicted
        edge[m] = i
        m += is_adjacent
    return m


@kernel
def broken_halves(offsets, indptr, indices, sides):
    """Mark the connected blocks ``(B,)`` with a disconnected side.

    Every component on a side touches the other side. A side is therefore connected if its nodes along the cut
    are connected within the side. The search rarely leaves the cut's neighbourhood.
    """
    n = np.int64(len(sides))
    queue, root, marks = np.empty(n + 1, np.int32), np.empty(n, np.int32), np.zeros((n, 2), np.int32)
    edge, broken, stamp = np.empty(n + 1, np.int32), np.empty(len(offsets) - 1, np.bool_), np.int64(0)
    for b in range(len(offsets) - 1):
        start, stop = offsets[b], offsets[b + 1]
        # 1. List the nodes along the cut, on both sides.
        m, whole = _beside(start, stop, indptr, indices, sides, edge), True
        # 2. Flood a small block, or a block that is nearly all cut, and count its components: more than two
        #    mean a broken side.
        if _THIN * m > stop - start:
            for i in range(start, stop):
                root[i] = sides[i]
            components = 0
            for i in range(start, stop):
                if root[i] >= 0:
                    flood(i, indptr, indices, root, queue, 0)
                    components += 1
            broken[b] = components > 2
            continue
        # 3. Otherwise grow rings from the cut nodes of each side until all have met. The number of rings is
        #    unlimited, so the answer is exact.
        for side in range(2):
            filled, stamp = np.int64(0), stamp + 1
            for c in range(m):
                queue[filled] = edge[c]
                filled += sides[edge[c]] == side
            whole &= are_connected(indptr, indices, sides, side, (queue, root, marks), filled, stamp, n, n)
        broken[b] = not whole
    return broken
