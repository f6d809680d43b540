"""Connectivity repair: which component of a part stays, and which part each of the others joins."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import kernel

__all__ = ["absorb", "keepers"]

_TIE = 1e-7  # relative: closer sizes, interfaces and places count as equal (rounding far from the origin)


@kernel
def _before(one, other, value, beside, places):
    """Whether component ``one`` of some value comes before ``other``; of equal ones the one further along.

    That is the one whose ``places (components, k)`` are larger where they first differ.
    """
    if abs(value - beside) > _TIE * max(value, beside):
        return value > beside
    for k in range(places.shape[1]):
        if abs(places[one, k] - places[other, k]) > _TIE:
            return places[one, k] > places[other, k]
    return one < other


@kernel
def keepers(part_of, sizes, places, n_parts):
    """The component that each part keeps ``(n_parts,)``: its largest, of equal ones the foremost; or −1.

    ``part_of``, ``sizes`` and ``places`` (lengths of order 1) are those of the components.
    """
    kept = np.full(n_parts, -1)
    for c in range(len(part_of)):
        best = kept[part_of[c]]
        if best < 0 or _before(c, best, sizes[c], sizes[best], places):
            kept[part_of[c]] = c
    return kept


@kernel
def absorb(indptr, indices, interface, kept, nodes, component_offsets, loose, keeper, places):
    """Part of each node once every loose component has joined a kept one.

    ``kept`` is the part of the nodes that stay, −1 elsewhere; ``loose`` lists components, whose nodes
    are ``nodes[component_offsets[c]:component_offsets[c + 1]]``. All components that touch nodes with
    a part choose at once and join; then the next ring of components. Each chooses the part with which it
    shares the most interface, of equal ones the part whose ``keeper`` comes first by the ``places``. A node
    left at −1 cannot be reached.
    """
    parts = kept.copy()
    waiting = loose.copy()
    shared = np.zeros(len(keeper))
    touched = np.empty(len(keeper), np.int64)
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
                p, best = touched[t], choice[w]
                if best < 0 or _before(keeper[p], keeper[best], shared[p], shared[best], places):
                    choice[w] = p
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
