"""Connectivity repair: loose components join the kept neighbour with which they share the most interface."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import kernel

__all__ = ["absorb"]


@kernel
def absorb(indptr, indices, interface, kept, nodes, component_offsets, loose, n_parts):
    """Part of each node once every loose component has joined a kept one.

    ``kept`` is the part of the nodes that stay, −1 elsewhere; ``loose`` lists components, whose nodes
    are ``nodes[component_offsets[c]:component_offsets[c + 1]]``. All components that touch nodes with
    a part choose at once and join; then the next ring of components. A node left at −1 cannot be reached.
    """
    parts = kept.copy()
    waiting = loose.copy()
    shared = np.zeros(n_parts)
    touched = np.empty(n_parts, np.int64)
    choice = np.empty(len(loose), np.int64)
    m = len(waiting)
    while m > 0:
        for w in range(m):
            c, count = waiting[w], 0
            for k in range(component_offsets[c], component_offsets[c + 1]):
                for h in range(indptr[nodes[k]], indptr[nodes[k] + 1]):
                    p = parts[indices[h]]
                    if p >= 0:
                        if shared[p] == 0.0:
                            touched[count] = p
                            count += 1
                        shared[p] += interface[h] + 1e-300
            choice[w] = -1
            for t in range(count):
                if choice[w] < 0 or shared[touched[t]] > shared[choice[w]]:
                    choice[w] = touched[t]
            for t in range(count):
                shared[touched[t]] = 0.0
        left = 0
        for w in range(m):
            c = waiting[w]
            if choice[w] < 0:
                waiting[left] = c
                left += 1
                continue
            for k in range(component_offsets[c], component_offsets[c + 1]):
                parts[nodes[k]] = choice[w]
        if left == m:
            break
        m = left
    return parts
