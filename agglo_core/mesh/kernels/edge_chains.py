"""Trace edge chains through vertices of degree two, and select the vertices that can be removed."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@helper
def _bend(points, a, b, c):
    """Return the cosine of the angle between ab and bc: 1 if straight, −1 at a reversal."""
    product, first, second = 0.0, 0.0, 0.0
    for k in range(points.shape[1]):
        u, v = points[b, k] - points[a, k], points[c, k] - points[b, k]
        product += u * v
        first += u * u
        second += v * v
    return product / np.sqrt(first * second) if first * second > 0.0 else 1.0


@helper
def _other_end(ends, e, v):
    return ends[e, 1] if ends[e, 0] == v else ends[e, 0]


@helper
def _sharpest_turn(points, ends, at, e, v):
    """Return the vertex with the sharpest turn on a closed chain that leaves v by edge e."""
    # ``at[w]`` are the two edges at w: the edge other than e continues the chain.
    first, best, least = e, v, 2.0
    while True:
        w = _other_end(ends, e, v)
        following = at[w, 1] if at[w, 0] == e else at[w, 0]
        bend = _bend(points, v, w, _other_end(ends, following, w))
        if bend < least:
            best, least = w, bend
        e, v = following, w
        if e == first:
            return best


@helper
def _walk(ends, at, joint, e, v, visited, edges, vertices, n_edges, n_chains):
    """Trace one chain that leaves v along edge e, and return the total number of edges written.

    A chain has one vertex more than edges, so vertices are ``n_chains`` positions ahead. The chain ends at a
    vertex that is no joint, or at its first edge.
    """
    while True:
        visited[e] = True
        edges[n_edges], vertices[n_edges + n_chains] = e, v
        n_edges += 1
        v = _other_end(ends, e, v)
        following = at[v, 1] if at[v, 0] == e else at[v, 0]
        if not joint[v] or visited[following]:
            vertices[n_edges + n_chains] = v
            return n_edges
        e = following


@kernel
def walk_chains(points, ends, joint, at):
    """Trace chains of edges ``ends (E, 2)`` through the vertices ``joint`` of degree two (edges ``at``).

    ``joint (n_points,)`` is a mask, ``at`` has a row per point. Chain c has
    ``edges[offsets[c]:offsets[c + 1]]`` and one vertex more; a closed chain begins and ends at its sharpest
    turn. Returns offsets, edges and vertices; the vertices of chain c begin at ``offsets[c] + c``.
    """
    n = len(ends)
    visited = np.zeros(n, np.bool_)
    edges, vertices = np.empty(n, np.int64), np.empty(2 * n, np.int64)
    offsets = np.zeros(n + 1, np.int64)
    n_edges, n_chains = 0, 0
    # First open chains, from edges with an end that is no joint; the remaining edges form closed chains.
    for is_closed in range(2):
        for e in range(n):
            first, second = ends[e, 0], ends[e, 1]
            if visited[e] or (is_closed == 0 and joint[first] and joint[second]):
                continue
            # An open chain begins at an end that is no joint, a closed chain at its sharpest turn, because
            # thinning keeps this vertex.
            v = second if joint[first] and not joint[second] else first
            if is_closed == 1:
                v = _sharpest_turn(points, ends, at, e, first)
                e = at[v, 0]
            n_edges = _walk(ends, at, joint, e, v, visited, edges, vertices, n_edges, n_chains)
            n_chains += 1
            offsets[n_chains] = n_edges
    return offsets[: n_chains + 1].copy(), edges, vertices[: n + n_chains].copy()


@helper
def _distance(points, p, a, b):
    """Return the squared distance of p from the segment ab, in any dimension."""
    length, dot = 0.0, 0.0
    for k in range(points.shape[1]):
        u = points[b, k] - points[a, k]
        length += u * u
        dot += u * (points[p, k] - points[a, k])
    t = min(max(dot / length, 0.0), 1.0) if length > 0.0 else 0.0
    total = 0.0
    for k in range(points.shape[1]):
        d = points[p, k] - points[a, k] - t * (points[b, k] - points[a, k])
        total += d * d
    return total


@helper
def _farthest_vertex(points, vertices, i, j):
    """Return index and squared distance of the vertex between i and j farthest from the segment."""
    place, most = -1, -1.0
    for k in range(i + 1, j):
        d = _distance(points, vertices[k], vertices[i], vertices[j])
        if d > most:
            place, most = k, d
    return place, most


@helper
def _split(points, vertices, i, j, limit, keep, stack):
    """Mark the vertices to keep between indices i and j by the Douglas-Peucker algorithm.

    The vertex farthest from the segment is kept if its squared distance exceeds ``limit``; both halves are
    then processed. ``stack`` holds the pending intervals.
    """
    stack[0, 0], stack[0, 1], size = i, j, 1
    while size > 0:
        size -= 1
        i, j = stack[size, 0], stack[size, 1]
        k, most = _farthest_vertex(points, vertices, i, j)
        if most > limit:
            keep[k] = True
            stack[size, 0], stack[size, 1] = i, k
            stack[size + 1, 0], stack[size + 1, 1] = k, j
            size += 2


@helper
def _sweep(points, vertices, i, j, limit, keep):
    """Remove marked vertices between i and j that are superfluous for the distance limit."""
    # ``candidate`` is the last marked vertex, between its marked predecessor ``before`` and the next marked
    # vertex k. It is removed if the segment from ``before`` to k stays within the limit of all vertices
    # between.
    before, candidate = i, -1
    for k in range(i + 1, j + 1):
        if keep[k]:
            if candidate >= 0:
                if _farthest_vertex(points, vertices, before, k)[1] <= limit:
                    keep[candidate] = False
                else:
                    before = candidate
            candidate = k


@helper
def _remove_if_superfluous(points, vertices, i, j, position, limit, keep):
    """Remove a vertex of a closed chain if the limit permits it and three vertices remain."""
    before, after, count = position - 1, position + 1, 0
    while not keep[before]:
        before -= 1
    while not keep[after]:
        after += 1
    for k in range(i, j):
        count += keep[k]
    if count > 3 and _farthest_vertex(points, vertices, before, after)[1] <= limit:
        keep[position] = False


@kernel
def thin_chains(points, offsets, vertices, limits, chains, keep):
    """Thin edge chains: mark in ``keep`` vertices such that all others lie within ``limits`` of the result.

    The vertices of chain c are at ``offsets[c] + c`` to ``offsets[c + 1] + c``. A closed chain keeps at least
    three. ``limits (n,)`` are lengths, one per chain; ``keep`` has an entry per position in ``vertices`` and
    is written only for ``chains``.
    """
    longest = 0
    for c in chains:
        longest = max(longest, offsets[c + 1] - offsets[c])
    stack = np.empty((longest + 2, 2), np.int64)
    for c in chains:
        i, j, limit = offsets[c] + c, offsets[c + 1] + c, limits[c] * limits[c]
        # 1. Both ends stay. An open chain is a single piece between them.
        for k in range(i, j + 1):
            keep[k] = False
        keep[i], keep[j] = True, True
        if vertices[i] != vertices[j]:
            _split(points, vertices, i, j, limit, keep, stack)
            _sweep(points, vertices, i, j, limit, keep)
            continue
        if j - i < 3:  # an edge and its reversal
            for k in range(i, j):
                keep[k] = True
            continue
        # 2. A closed chain has three corners: its first vertex, the vertex farthest from it, and the vertex
        #    farthest from the segments between these two. The three pieces between corners are treated like
        #    open chains.
        middle = _farthest_vertex(points, vertices, i, j)[0]
        a, first = _farthest_vertex(points, vertices, i, middle)
        b, second = _farthest_vertex(points, vertices, middle, j)
        third = a if first > second else b
        low, high = min(middle, third), max(middle, third)
        keep[low], keep[high] = True, True
        for start, stop in ((i, low), (low, high), (high, j)):
            _split(points, vertices, start, stop, limit, keep, stack)
            _sweep(points, vertices, start, stop, limit, keep)
        # 3. The third corner was kept to prevent a collapse of the loop; it may be superfluous.
        _remove_if_superfluous(points, vertices, i, j, third, limit, keep)
