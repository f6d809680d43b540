"""Outlines of very many edges, with fewer: chains of edges that are nearly straight become one edge."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper
from agglo_core.shapes.circle_edges import FIRST, HEIGHT, LAST


@helper
def _append(edges, m, ax, ay, bx, by):
    """Add the edge ab to the table; returns how many edges it has now."""
    edges[0, m], edges[1, m], edges[4, m], edges[5, m] = ax, ay, bx, by
    edges[2, m], edges[3, m] = bx - ax, by - ay
    edges[6, m] = 1.0 / (edges[2, m] ** 2 + edges[3, m] ** 2)
    return m + 1


@helper
def _walk(edges, seed, links, done, tiny, rough, k):
    """Add straight edges for the chain that begins with ``seed`` to ``rough``, until it branches or closes.

    A straight edge goes on as long as there is one from its start ``a`` to the next vertex that passes all
    between by less than ``tiny``: its slope against the first edge has to be from ``low`` to ``high``.
    """
    i, v = seed, np.int64(edges[LAST, seed])
    ax, ay, bx, by = edges[0, i], edges[1, i], edges[4, i], edges[5, i]
    cx, cy, along = ax, ay, -1.0  # nothing yet
    ex, ey, low, high = 0.0, 0.0, 0.0, 0.0
    while True:
        done[i] = True
        if along < 0.0:  # the edge ab is the first of a straight one
            along = np.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
            ex, ey = (bx - ax) / along, (by - ay) / along
            low, high = -tiny / along, tiny / along
        i ^= links[v, 0]
        if links[v, 1] != 2 or done[i]:
            return _append(rough, k, ax, ay, bx, by)
        forward = np.int64(edges[FIRST, i]) == v
        end = 4 if forward else 0
        v = np.int64(edges[LAST if forward else FIRST, i])
        cx, cy = edges[end, i], edges[end + 1, i]
        t, n = ex * (cx - ax) + ey * (cy - ay), ex * (cy - ay) - ey * (cx - ax)
        if t > along and low * t <= n <= high * t:
            along, low, high = t, max(low, (n - tiny) / t), min(high, (n + tiny) / t)
        else:
            k = _append(rough, k, ax, ay, bx, by)
            ax, ay, along = bx, by, -1.0
        bx, by = cx, cy


@helper(allocates=True)
def simplified(edges, m, links, tiny):
    """A table of fewer edges that pass the ``m`` of an outline by less than ``tiny``, and their number.

    ``links (points, 2)`` is a work array: zeros, before and after.
    """
    for row in (FIRST, LAST):  # how many edges meet at each vertex, and the exclusive or of their columns
        for i in range(m):
            v = np.int64(edges[row, i])
            links[v, 0] ^= i
            links[v, 1] += 1
    done, rough, k = np.zeros(m, np.bool_), np.empty((HEIGHT, 2 * m)), np.int64(0)
    for seed in range(m):
        if not done[seed]:
            k = _walk(edges, seed, links, done, tiny, rough, k)
    for row in (FIRST, LAST):
        for i in range(m):
            v = np.int64(edges[row, i])
            links[v, 0], links[v, 1] = 0, 0
    return rough, k
