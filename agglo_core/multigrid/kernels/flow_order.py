"""Kernel that sorts parts along a flow."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from heapq import heapify, heappop, heappush

import numpy as np

from agglo_core.compiled.compiling import kernel

_ROUNDING = 1e-9  # remaining inflow of a part relative to its whole inflow, above rounding errors


@kernel()
def flow_order(indptr, indices, flows):
    """Return the parts ``(n,)``, each the one with the least inflow from parts not yet sorted.

    The inflow is relative to the whole inflow of the part; smaller numbers come first where it is equal.
    Part i flows into ``indices[indptr[i]:indptr[i + 1]]`` by the positive amounts ``flows``.
    """
    n = len(indptr) - 1
    whole, order, done = np.zeros(n), np.empty(n, np.int64), np.zeros(n, np.bool_)
    for k in range(len(indices)):
        whole[indices[k]] += flows[k]
    remaining = whole.copy()
    # 1. Queue of parts by their remaining share; entries that are out of date are skipped.
    queue = [(1.0 if whole[i] > 0.0 else 0.0, i) for i in range(n)]
    heapify(queue)
    # 2. The next part leaves the inflow of those below.
    count = 0
    while count < n:
        _, i = heappop(queue)
        if done[i]:
            continue
        done[i] = True
        order[count] = i
        count += 1
        for k in range(indptr[i], indptr[i + 1]):
            j = np.int64(indices[k])
            remaining[j] -= flows[k]
            if not done[j]:
                share = remaining[j] / whole[j]
                heappush(queue, (share if share > _ROUNDING else 0.0, j))  # type: ignore[misc]
    return order
