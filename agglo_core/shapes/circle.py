"""Largest inscribed circles of 2-D agglomerates, by the offset curves of their outlines.

Holes, several loops and pinch vertices need no special case.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.compiled.sorting import sort_by_keys

# Edge table, one column per edge from a to b: rows 0 and 1 are a, 2 and 3 are b - a, 4 and 5 are b, 6 is
# 1 / |b - a|², 7 is a value (squared distance, or plane height) for all edges, 8 to 10 are a plane, its value
# at a point and its gradient, 11 and 12 are the direction of the next edge if the vertex b is reflex, else 0,
# and 13 is a sorted coordinate. The agglomerate is on the left of each edge.
_B, _VALUE, _PLANE, _NEXT, _KEY, _ROWS = 4, 7, 8, 11, 13, 14

_GAIN = 1e-5  # relative to the radius: a circle counts as larger if it is larger by more
_SHORT = 1e-6  # relative to the radius: shorter pieces of an offset curve are dropped
_FINEST = 1e-9  # relative to the diameter: smallest gain, and radius that counts as zero
_ROUNDING = 1e-14  # relative to the diameter: error of distances, with a margin
_MANY = 512  # number of edges above which they are sorted (benchmarks/pathologies.py)
_STEPS = 40  # maximum number of pivots in a linear program, a safeguard; more than ten are rare
_PIECES = 128  # of an offset curve, in a stack: each is at most half of the piece below


@helper(allocates=True)
def _outline(points, loop_offsets, first, last, vertices, x0, y0, edges):
    """Collect the edges of loops in a table, and return table, edge count and number of reflex vertices.

    The table is ``edges`` if that is large enough. The origin is (x0, y0). Edges without length are dropped.
    """
    size = loop_offsets[last] - loop_offsets[first]
    if edges.shape[1] < size:
        edges = np.empty((_ROWS, 2 * size))
    m, n_reflex = 0, 0
    for loop in range(first, last):
        # 1. Edges of one loop, from its last vertex on.
        begin, v = m, vertices[loop_offsets[loop + 1] - 1]
        ax, ay = points[v, 0] - x0, points[v, 1] - y0
        for h in range(loop_offsets[loop], loop_offsets[loop + 1]):
            v = vertices[h]
            bx, by = points[v, 0] - x0, points[v, 1] - y0
            ux, uy = bx - ax, by - ay
            square = ux * ux + uy * uy
            if square > 0.0:
                edges[0, m], edges[1, m], edges[2, m], edges[3, m] = ax, ay, ux, uy
                edges[_B, m], edges[_B + 1, m], edges[6, m] = bx, by, 1.0 / square
                m += 1
            ax, ay = bx, by
        # 2. Right turns are reflex vertices.
        for i in range(begin, m):
            j = i + 1 if i + 1 < m else begin
            scale = np.sqrt(edges[6, j]) if edges[3, i] * edges[2, j] > edges[2, i] * edges[3, j] else 0.0
            edges[_NEXT, i], edges[_NEXT + 1, i] = scale * edges[2, j], scale * edges[3, j]
            n_reflex += scale > 0.0
    return edges, m, n_reflex


@helper
def _offset(edges, i, x, y):
    """Return the vector from the nearest point of edge i to (x, y)."""
    # The foot of the perpendicular is a + t (b - a), clamped to the ends.
    wx, wy = x - edges[0, i], y - edges[1, i]
    t = min(max((wx * edges[2, i] + wy * edges[3, i]) * edges[6, i], 0.0), 1.0)
    return wx - t * edges[2, i], wy - t * edges[3, i]


@helper
def _nearest_edge(edges, start, stop, x, y):
    """Return the index of the edge nearest to (x, y), and write the squared distances to the table."""
    squares = edges[_VALUE]
    for j in range(stop - start):
        i = np.uint64(start + j)  # unsigned, without wraparound of negative indices: allows vectorisation
        dx, dy = _offset(edges, i, x, y)
        squares[i] = dx * dx + dy * dy
    return _lowest(squares, start, stop)


@helper
def _lowest(values, start, stop):
    """Return the index of the lowest value."""
    best = np.uint64(start)
    for j in range(stop - start):
        i = np.uint64(start + j)
        if values[i] < values[best]:
            best = i
    return np.int64(best)


@helper
def _is_inside(edges, m, x, y):
    """Return True if (x, y) is inside by the even-odd rule."""
    crossings = 0
    for j in range(m):  # without branches
        # The edge crosses the ray in direction x if its ends are on different sides of the line (half-open,
        # so that a vertex counts once), and if the line meets it beyond x.
        i = np.uint64(j)
        up = edges[3, i] > 0.0
        beyond = ((x - edges[0, i]) * edges[3, i] < (y - edges[1, i]) * edges[2, i]) == up
        crossings += 1 if ((edges[1, i] > y) != (edges[_B + 1, i] > y)) & beyond else 0
    return crossings & 1 == 1


@helper
def _lowest_plane(edges, m, px, py):
    """Return the index of the edge with the lowest plane at p, and write all heights to the table."""
    heights = edges[_VALUE]
    for j in range(m):
        i = np.uint64(j)
        heights[i] = edges[_PLANE, i] + px * edges[_PLANE + 1, i] + py * edges[_PLANE + 2, i]
    return _lowest(heights, np.int64(0), m)


@helper
def _largest_in_box(edges, m, side, tiny, touching, inverse):
    """Maximise the minimum of all planes over a square about the origin, by the dual simplex method.

    The linear program in (p, r): maximise r with r - g_i · p ≤ d_i for each plane (d_i its value at the
    origin, g_i its gradient), |p_x| ≤ side and |p_y| ≤ side. Returns p and r, and writes the edges of the
    active planes to ``touching (3,)``. ``inverse (3, 3)`` is workspace.
    """
    # 1. The lowest plane at the origin is highest at the corner in gradient direction: both box sides there
    #    and this edge are active. Column k of the inverse is the change in (p, r) per unit of the right-hand
    #    side k. Its last entry is the multiplier λ_k ≥ 0.
    nearest = _lowest_plane(edges, m, 0.0, 0.0)
    gx, gy = edges[_PLANE + 1, nearest], edges[_PLANE + 2, nearest]
    for k in range(3):
        inverse[0, k], inverse[1, k], touching[k] = 0.0, 0.0, nearest
    inverse[0, 1], inverse[1, 2] = 1.0 if gx > 0.0 else -1.0, 1.0 if gy > 0.0 else -1.0
    inverse[2, 0], inverse[2, 1], inverse[2, 2] = 1.0, abs(gx), abs(gy)
    px, py = inverse[0, 1] * side, inverse[1, 2] * side
    radius = edges[_PLANE, nearest] + (abs(gx) + abs(gy)) * side
    for _ in range(_STEPS):
        # 2. The most violated constraint, an edge or a box side, enters: row (ax, ay, ar).
        entering = _lowest_plane(edges, m, px, py)
        ax, ay, ar = -edges[_PLANE + 1, entering], -edges[_PLANE + 2, entering], 1.0
        excess, beyond = radius - edges[_VALUE, entering], max(abs(px), abs(py)) - side
        if beyond > excess:
            entering, excess, ar = nearest, beyond, 0.0
            ax, ay = (np.sign(px), 0.0) if abs(px) > abs(py) else (0.0, np.sign(py))
        if excess <= tiny:
            break
        # 3. Ratio test: the constraint leaves for which all λ stay ≥ 0. Components of the new row below 1e-12
        #    count as rounding.
        leaving, ratio, pivot = -1, np.inf, 1.0
        for k in range(3):
            share = ax * inverse[0, k] + ay * inverse[1, k] + ar * inverse[2, k]
            if share > 1e-12 and inverse[2, k] < ratio * share:
                leaving, ratio, pivot = k, inverse[2, k] / share, share
        if leaving < 0:
            break
        # 4. Update the inverse, and move along the column of the new constraint until it is active.
        for row in range(3):
            inverse[row, leaving] /= pivot
        for k in range(3):
            if k != leaving:
                share = ax * inverse[0, k] + ay * inverse[1, k] + ar * inverse[2, k]
                for row in range(3):
                    inverse[row, k] -= share * inverse[row, leaving]
        touching[leaving] = entering
        px -= excess * inverse[0, leaving]
        py -= excess * inverse[1, leaving]
        radius -= excess * inverse[2, leaving]
    return px, py, radius


@helper
def _local_maximum(edges, m, x, y, radius, diameter, touching, inverse):
    """Return the radius at a local maximum that Newton steps reach from an inscribed circle.

    The edges that touch its circle are written to ``touching``.
    """
    for _ in range(_STEPS):
        # 1. Linearise the distances at the centre, and maximise r with r ≤ each tangent.
        for j in range(m):
            i = np.uint64(j)
            dx, dy = _offset(edges, i, x, y)
            distance = np.sqrt(dx * dx + dy * dy)
            scale = 1.0 / max(distance, 1e-300)
            edges[_PLANE, i], edges[_PLANE + 1, i], edges[_PLANE + 2, i] = distance, dx * scale, dy * scale
        px, py, most = _largest_in_box(edges, m, diameter, 1e-14 * radius, touching, inverse)
        if most <= radius * (1.0 + 1e-12):
            break
        # 2. Distances are convex, hence nowhere below their tangents: the step gains what they promise.
        better = np.sqrt(edges[_VALUE, _nearest_edge(edges, np.int64(0), m, x + px, y + py)])
        if better <= radius:
            break
        x, y, radius = x + px, y + py, better
        # 3. Stop if the three distances are as linear as assumed: then the program's maximum is that of r.
        squares = edges[_VALUE]
        largest = max(squares[touching[0]], max(squares[touching[1]], squares[touching[2]]))
        if largest <= most * most * (1.0 + 1e-12):
            break
    return radius


@helper(allocates=True)
def _sorted_edges(edges, m):
    """Return a table sorted by the midpoints along the longer axis, the axis, and the largest half-extent."""
    x_low, x_high, y_low, y_high, reach = np.inf, -np.inf, np.inf, -np.inf, 0.0
    for i in range(m):
        x_low, x_high = min(x_low, edges[0, i]), max(x_high, edges[0, i])
        y_low, y_high = min(y_low, edges[1, i]), max(y_high, edges[1, i])
    axis = 0 if x_high - x_low >= y_high - y_low else 1
    order, keys, table = np.empty(m, np.int64), np.empty(m), np.empty((_ROWS, m))
    for i in range(m):
        order[i], keys[i] = i, edges[axis, i] + 0.5 * edges[2 + axis, i]
        reach = max(reach, 0.5 * abs(edges[2 + axis, i]))
    sort_by_keys(order, keys, np.int64(m))
    for i in range(m):
        table[_KEY, i] = keys[i]
        for row in range(_KEY):
            table[row, i] = edges[row, order[i]]
    return table, axis, reach


@helper
def _first_beyond(edges, m, place):
    """Return the number of edges with a key below ``place``, by bisection."""
    low, high = np.int64(0), m
    while low < high:
        middle = (low + high) >> 1
        low, high = (middle + 1, high) if edges[_KEY, middle] < place else (low, middle)
    return low


@helper
def _near_on_line(edges, f, x, y, ux, uy, t):
    """Return begin and end of the points (x, y) + s u at a distance below t from edge f (an interval of s).

    The points at a distance below t from an edge are a strip and two discs about its ends.
    """
    # 1. Discs, where s and h are coordinates of a and of b along and across the line.
    wx, wy = edges[0, f] - x, edges[1, f] - y
    gx, gy = edges[2, f] * ux + edges[3, f] * uy, ux * edges[3, f] - uy * edges[2, f]
    s, h = wx * ux + wy * uy, ux * wy - uy * wx
    low, high = np.inf, -np.inf
    if abs(h) < t:
        half = np.sqrt(t * t - h * h)
        low, high = s - half, s + half
    if abs(h + gy) < t:
        half = np.sqrt(t * t - (h + gy) * (h + gy))
        low, high = min(low, s + gx - half), max(high, s + gx + half)
    # 2. Strip: the foot of the point lies between a and b, and the height over the edge is below t.
    square, along, across = gx * gx + gy * gy, gx, gy
    along, across = along if along != 0.0 else 1e-300, across if across != 0.0 else 1e-300
    first, second = s + h * gy / along, s + (h * gy + square) / along
    third, fourth = s - (gx * h + t * np.sqrt(square)) / across, s - (gx * h - t * np.sqrt(square)) / across
    begin = max(min(first, second), min(third, fourth))
    end = min(max(first, second), max(third, fourth))
    return (min(low, begin), max(high, end)) if begin < end else (low, high)


@helper
def _between_crossings(edges, m, x, y, ux, uy):
    """Return the last s < 0 and the first s ≥ 0 at which an edge crosses (x, y) + s u, or infinity."""
    low, high = -np.inf, np.inf
    for i in range(m):
        wx, wy = edges[0, i] - x, edges[1, i] - y
        h, rise = ux * wy - uy * wx, ux * edges[3, i] - uy * edges[2, i]
        if (h > 0.0) != (h + rise > 0.0):
            s = wx * ux + wy * uy - h / rise * (edges[2, i] * ux + edges[3, i] * uy)
            low, high = (max(low, s), high) if s < 0.0 else (low, min(high, s))
    return low, high


@helper
def _near_on_arc(edges, f, x, y, t, limit, dx, dy, end_x, end_y, side):
    """Return an end of the arc of points (x, y) + t d, from d on, at a distance below t from edge f.

    ``side`` is 1 counter-clockwise and -1 clockwise. The arc ends at the latest at the direction ``end``. A
    point is near if the squared distance is below ``limit``.
    """
    for _ in range(4):  # converges quadratically; any of the points found is correct
        # The disc of radius t about the nearest point c of f covers the angle arccos(|c - (x, y)| / 2t) on
        # either side of c.
        ox, oy = _offset(edges, f, x + t * dx, y + t * dy)
        if ox * ox + oy * oy >= limit:
            break
        cx, cy, along = t * dx - ox, t * dy - oy, 0.5 / t
        across = side * np.sqrt(max(1.0 / (cx * cx + cy * cy) - along * along, 0.0))
        dx, dy = along * cx - across * cy, along * cy + across * cx
        if side * (end_x * dy - end_y * dx) >= 0.0 or end_x * dx + end_y * dy < 0.0:
            return end_x, end_y
    return dx, dy


@helper
def _edge_nearer(edges, m, axis, reach, touching, x, y, t, limit):
    """Return an edge within the squared distance ``limit`` of (x, y), and its squared distance.

    If there is none, these belong to the nearest edge within ``t``. See :func:`_radii`.
    """
    # 1. Among the edges that touch the best circle.
    f, square = np.int64(0), np.inf
    for k in range(3):
        ox, oy = _offset(edges, touching[k], x, y)
        if ox * ox + oy * oy < square:
            f, square = touching[k], ox * ox + oy * oy
    if square < limit:
        return f, square
    # 2. Among all edges, or in a sorted table among those that reach a strip about the point.
    start, stop = np.int64(0), m
    if reach >= 0.0:
        place = x if axis == 0 else y
        start = _first_beyond(edges, m, place - t - reach)
        stop = max(_first_beyond(edges, m, place + t + reach), start + 1)
    f = _nearest_edge(edges, start, min(stop, m), x, y)
    return f, edges[_VALUE, f]


@helper
def _cut_arc(edges, pieces, size, f, x0, y0, t, limit, dx, dy, near):
    """Split an arc at its middle direction (dx, dy) into the pieces ``size`` and ``size + 1``.

    If the middle is ``near`` the edge f, the pieces leave out the points within ``t`` of the edge.
    """
    ax, ay, bx, by = dx, dy, dx, dy
    first_x, first_y = pieces[size, 0], pieces[size, 1]
    last_x, last_y = pieces[size, 2], pieces[size, 3]
    if near:
        ax, ay = _near_on_arc(edges, f, x0, y0, t, limit, dx, dy, first_x, first_y, 1.0)
        bx, by = _near_on_arc(edges, f, x0, y0, t, limit, dx, dy, last_x, last_y, -1.0)
    pieces[size, 2], pieces[size, 3] = ax, ay
    pieces[size + 1, 0], pieces[size + 1, 1] = bx, by
    pieces[size + 1, 2], pieces[size + 1, 3] = last_x, last_y


@helper
def _radii(edges, m, is_convex, axis, reach, diameter, touching, inverse, pieces):
    """Return the radii of the largest circle inside an outline: anywhere, and about the origin.

    See :func:`circles`. The table is sorted along ``axis`` if ``reach`` is at least 0. ``touching (3,)``
    are the edges that touch the best circle. ``pieces`` is workspace: a stack of pieces of an offset curve,
    with the coordinates of both ends on an edge, or their directions from a vertex.
    """
    radius = 0.0
    touching[0], touching[1], touching[2] = 0, 0, 0
    if _is_inside(edges, m, 0.0, 0.0):
        radius = np.sqrt(edges[_VALUE, _nearest_edge(edges, np.int64(0), m, 0.0, 0.0)])
    centred = radius
    if radius > 0.0:
        radius = _local_maximum(edges, m, 0.0, 0.0, radius, diameter, touching, inverse)
        if is_convex:
            return radius, centred
    tiny = _FINEST * diameter
    for feature in range(2 * m):
        # 1. Offset curve of the edge e, or of its end if that is a reflex vertex.
        e, is_arc = feature >> 1, feature & 1 == 1
        scale = np.sqrt(edges[6, e])
        ux, uy = edges[2, e] * scale, edges[3, e] * scale
        pieces[0, 0], pieces[0, 1], size = 0.0, 1.0 / scale, 1
        if is_arc:
            wx, wy = edges[_NEXT, e], edges[_NEXT + 1, e]
            pieces[0, 0], pieces[0, 1], pieces[0, 2], pieces[0, 3] = -uy, ux, -wy, wx
            size = 0 if wx == 0.0 and wy == 0.0 else 1
        while size > 0:
            # 2. Middle (x, y) of a piece at the distance t, a little more than the best radius.
            size -= 1
            t = radius * (1.0 + _GAIN) + tiny
            limit = (t - _ROUNDING * diameter) ** 2
            x0, y0, dx, dy, at = edges[_B, e], edges[_B + 1, e], 0.0, 0.0, 0.0
            if is_arc:
                dx, dy = pieces[size, 1] - pieces[size, 3], pieces[size, 2] - pieces[size, 0]
                length = np.sqrt(dx * dx + dy * dy)  # of the chord on the unit circle
                dx, dy = dx / length, dy / length
                x, y, is_short = x0 + t * dx, y0 + t * dy, not length > _SHORT
            else:
                x0, y0 = edges[0, e] - t * uy, edges[1, e] + t * ux
                at, length = 0.5 * (pieces[size, 0] + pieces[size, 1]), pieces[size, 1] - pieces[size, 0]
                x, y, is_short = x0 + at * ux, y0 + at * uy, not length > _SHORT * t
            if is_short:
                continue
            # 3. Find an edge f nearer than t.
            f, square = _edge_nearer(edges, m, axis, reach, touching, x, y, t, limit)
            # 4. If there is none, the circle about (x, y) is larger. A point outside, beyond a gap narrower
            #    than the rounding or where cells overlap, excludes the points up to the next edge.
            if square >= limit and _is_inside(edges, m, x, y):
                distance = np.sqrt(square)
                radius = _local_maximum(edges, m, x, y, distance, diameter, touching, inverse)
                size += 1  # examine the piece again
                continue
            # 5. The points of the piece within t of f are not centres of larger circles: keep the rest.
            if is_arc:
                if square >= limit and length <= 1.7:
                    continue
                _cut_arc(edges, pieces, size, f, x0, y0, t, limit, dx, dy, square < limit)
            else:
                if square < limit:
                    low, high = _near_on_line(edges, f, x0, y0, ux, uy, t)
                else:
                    low, high = _between_crossings(edges, m, x, y, ux, uy)
                    low, high = at + min(low, -t), at + max(high, t)
                pieces[size + 1, 0], pieces[size + 1, 1] = max(high, at), pieces[size, 1]
                pieces[size, 1] = min(low, at)
            size += 2
    return radius, centred


@kernel
def circles(points, cell_loops, loop_offsets, vertices, centroids, diameters):
    """Return the radii (n, 2) of the largest circle inside each agglomerate: anywhere, about the centroid.

    Agglomerate c is on the left of the loops from ``cell_loops[c]`` to ``cell_loops[c + 1]``, with vertices
    ``vertices[loop_offsets[loop]:loop_offsets[loop + 1]]``. About a centroid outside the radius is 0.

    Newton steps move the circle about the centroid to a local maximum of the radius r, where it touches three
    edges, or two on opposite sides. In a convex agglomerate that is the maximum. Otherwise consider the
    circles of radius t = (1 + 1e-5) r that touch an edge, or a reflex vertex: their centres are on the offset
    curve of the outline at the distance t, on a line per edge and on an arc per vertex. If another edge is
    nearer than t to the middle of such a piece, it is nearer than t to an interval around it. What remains is
    examined in the same way, until pieces are shorter than 1e-6 t. If no edge is nearer, a circle larger than
    r is found, moved to a local maximum, and r increases. A piece excluded for one t is excluded for any
    larger t, as a circle contains the smaller circles that touch it from inside. So each piece is visited
    once, and in the end no radius exceeds r by more than 1e-5 r (or 1e-9 diameters).

    Most pieces are excluded by the three edges that touch the best circle, without a search for the nearest
    edge. In outlines with more than 512 edges the search is limited to edges nearby along one axis.
    """
    radii, touching, inverse = np.zeros((len(diameters), 2)), np.zeros(3, np.int64), np.empty((3, 3))
    edges, pieces = np.empty((_ROWS, 64)), np.empty((_PIECES, 4))
    for c in range(len(radii)):
        x0, y0, first, last = centroids[c, 0], centroids[c, 1], cell_loops[c], cell_loops[c + 1]
        edges, m, n_reflex = _outline(points, loop_offsets, first, last, vertices, x0, y0, edges)
        is_convex, table, axis, reach = last - first == 1 and n_reflex == 0, edges, 0, -1.0
        if m > _MANY and not is_convex:
            table, axis, reach = _sorted_edges(edges, m)
        radii[c, 0], radii[c, 1] = _radii(
            table, m, is_convex, axis, reach, diameters[c], touching, inverse, pieces
        )
    return radii
