"""Chains of edges through vertices that only two edges have, and which of their vertices can be left out."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@helper
def _bend(points, a, b, c):
    """Cosine of the turn at b on the way from a to c: 1 on a straight line, −1 where it turns back."""
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
def _sharpest(points, ends, at, e, v):
    """Vertex at which a closed chain, which leaves v by edge e, turns most."""
    # ``at[w]`` are both edges at w: the one that is not e leads on.
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
def _walk(ends, at, joint, e, v, used, edges, vertices, n_edges, n_chains):
    """Write a chain that begins at v with edge e, and return the number of edges written so far.

    A chain has one vertex more than edges, so that vertices are ``n_chains`` ahead. It ends at a vertex that
    is no joint, or back at its first edge.
    """
    while True:
        used[e] = True
        edges[n_edges], vertices[n_edges + n_chains] = e, v
        n_edges += 1
        v = _other_end(ends, e, v)
        following = at[v, 1] if at[v, 0] == e else at[v, 0]
        if not joint[v] or used[following]:
            vertices[n_edges + n_chains] = v
            return n_edges
        e = following


@kernel
def walk_chains(points, ends, joint, at):
    """Chains of edges ``ends (E, 2)`` that go on at the vertices ``joint``, whose two edges are ``at``.

    ``joint (n_points,)`` is a mask, ``at`` has a row for each point.
    Chain c has ``edges[offsets[c]:offsets[c + 1]]`` and one vertex more; a closed one begins and ends where
    it turns most. Returns offsets, edges and vertices, those of chain c from ``offsets[c] + c`` on.
    """
    n = len(ends)
    used = np.zeros(n, np.bool_)
    edges, vertices = np.empty(n, np.int64), np.empty(2 * n, np.int64)
    offsets = np.zeros(n + 1, np.int64)
    n_edges, n_chains = 0, 0
    # Open chains first, from edges with an end that is no joint; what is left are closed ones.
    for closed in range(2):
        for e in range(n):
            first, second = ends[e, 0], ends[e, 1]
            if used[e] or (closed == 0 and joint[first] and joint[second]):
                continue
            # An open chain begins at an end that is no joint, a closed one where it turns most: that vertex
            # is kept when chains are thinned.
            v = second if joint[first] and not joint[second] else first
            if closed == 1:
                v = _sharpest(points, ends, at, e, first)
                e = at[v, 0]
            n_edges = _walk(ends, at, joint, e, v, used, edges, vertices, n_edges, n_chains)
            n_chains += 1
            offsets[n_chains] = n_edges
    return offsets[: n_chains + 1].copy(), edges, vertices[: n + n_chains].copy()


@helper
def _distance(points, p, a, b):
    """Squared distance of p from the segment ab, in any dimension."""
    length, along = 0.0, 0.0
    for k in range(points.shape[1]):
        u = points[b, k] - points[a, k]
        length += u * u
        along += u * (points[p, k] - points[a, k])
    t = min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0
    total = 0.0
    for k in range(points.shape[1]):
        d = points[p, k] - points[a, k] - t * (points[b, k] - points[a, k])
        total += d * d
    return total


@helper
def _farthest(points, vertices, i, j):
    """Place of the vertex between i and j that is farthest from the segment, and its distance squared."""
    place, most = -1, -1.0
    for k in range(i + 1, j):
        d = _distance(points, vertices[k], vertices[i], vertices[j])
        if d > most:
            place, most = k, d
    return place, most


@helper
def _split(points, vertices, i, j, limit, keep, stack):
    """Keep vertices between the places i and j by the rule of Douglas and Peucker.

    The vertex farthest from the segment between both ends is kept if the square of its distance exceeds
    ``limit``, and both halves are looked at in turn; ``stack`` holds those still to come.
    """
    stack[0, 0], stack[0, 1], size = i, j, 1
    while size > 0:
        size -= 1
        i, j = stack[size, 0], stack[size, 1]
        k, most = _farthest(points, vertices, i, j)
        if most > limit:
            keep[k] = True
            stack[size, 0], stack[size, 1] = i, k
            stack[size + 1, 0], stack[size + 1, 1] = k, j
            size += 2


@helper
def _sweep(points, vertices, i, j, limit, keep):
    """Leave out vertices kept between i and j that need not be, as on straight runs that were met midway."""
    # ``own`` is kept for now, between the last one that stays, ``before``, and the next one kept, k: it goes
    # if the segment from ``before`` to k passes all between within the limit.
    before, own = i, -1
    for k in range(i + 1, j + 1):
        if keep[k]:
            if own >= 0:
                if _farthest(points, vertices, before, k)[1] <= limit:
                    keep[own] = False
                else:
                    before = own
            own = k


@helper
def _without(points, vertices, i, j, own, limit, keep):
    """Leave out the vertex at ``own`` of a closed chain if it need not be kept, and three are left."""
    before, after, count = own - 1, own + 1, 0
    while not keep[before]:
        before -= 1
    while not keep[after]:
        after += 1
    for k in range(i, j):
        count += keep[k]
    if count > 3 and _farthest(points, vertices, before, after)[1] <= limit:
        keep[own] = False


@kernel
def thinned(points, offsets, vertices, limits, chains, keep):
    """Mark in ``keep`` the vertices that chains need to stay within ``limits`` of all their vertices.

    The vertices of chain c are those from ``offsets[c] + c`` to ``offsets[c + 1] + c``. A closed one keeps
    three at least. ``limits (n,)`` are lengths, one for each chain; ``keep`` is written for ``chains`` alone,
    and has an entry for each place in ``vertices``.
    """
    longest = 0
    for c in chains:
        longest = max(longest, offsets[c + 1] - offsets[c])
    stack = np.empty((longest + 2, 2), np.int64)
    for c in chains:
        i, j, limit = offsets[c] + c, offsets[c + 1] + c, limits[c] * limits[c]
        # 1. Both ends stay. All of an open chain is between them.
        for k in range(i, j + 1):
            keep[k] = False
        keep[i], keep[j] = True, True
        if vertices[i] != vertices[j]:
            _split(points, vertices, i, j, limit, keep, stack)
            _sweep(points, vertices, i, j, limit, keep)
            continue
        if j - i < 3:  # an edge there and back
            for k in range(i, j):
                keep[k] = True
            continue
        # 2. A closed chain: three corners, the vertex farthest from its first, and that farthest from the
        #    segments to it and back. The three pieces between them are like open chains.
        middle = _farthest(points, vertices, i, j)[0]
        a, first = _farthest(points, vertices, i, middle)
        b, second = _farthest(points, vertices, middle, j)
        third = a if first > second else b
        low, high = min(middle, third), max(middle, third)
        keep[low], keep[high] = True, True
        for start, stop in ((i, low), (low, high), (high, j)):
            _split(points, vertices, start, stop, limit, keep, stack)
            _sweep(points, vertices, start, stop, limit, keep)
        # 3. The third corner was kept in any case, so that the loop does not collapse: it may not be needed.
        _without(points, vertices, i, j, third, limit, keep)
