"""The largest circles inside parts of the plane, followed while cells move."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.kernels.anneal_state import MEASURE
from agglo_core.kernels.compiling import ONE, helper, kernel

__all__ = [
    "ACROSS",
    "CENTRED",
    "MOMENT",
    "RADIUS",
    "Circles",
    "Edges",
    "cell_edges",
    "centre_of",
    "centred_radius",
    "circle_inside",
    "circle_state",
    "outline",
    "touches",
]

RADIUS, ACROSS, CENTRED, MOMENT = 0, 1, 3, 4
"""Columns of a part: radius of its circle, its centre, that of the circle about the centroid, moments."""

_STEPS = 10
_SHRINK, _START, _BACK = 0.75, 0.35, 0.9
_DEEP = 0.5
"""From centroids at least so deep, by the largest radius found, a circle is sought."""


class Edges(NamedTuple):
    """Edges of each cell (CSR): the cell beyond or −1, and the edge ``(e, 5)``: a corner, a vector, 1/length²."""

    offsets: Any
    beside: Any
    lines: Any


class Circles(NamedTuple):
    """Circles of the parts ``(k, 6)``; room for the edges around one."""

    rings: Any
    room: Any


@helper
def _shared_ends(i, j, cells):
    """The two vertices that cells i and j share which are farthest apart; −1 if there are no two."""
    one, other, most = np.int32(-1), np.int32(-1), 0.0
    begin, end = cells.offsets[j], cells.offsets[j + 1]
    for g in range(cells.offsets[i], cells.offsets[i + 1]):
        u = cells.vertices[g]
        for a in range(begin, end):
            if cells.vertices[a] != u:
                continue
            for f in range(cells.offsets[i], g):
                v = cells.vertices[f]
                for b in range(begin, end):
                    if cells.vertices[b] == v:
                        square = (cells.points[u, 0] - cells.points[v, 0]) ** 2
                        square += (cells.points[u, 1] - cells.points[v, 1]) ** 2
                        if square > most:
                            most, one, other = square, u, v
    return one, other


@helper
def _write_line(row, u, v, points, lines):
    """Write the edge between two vertices; returns its length."""
    x, y = points[v, 0] - points[u, 0], points[v, 1] - points[u, 1]
    square = x * x + y * y
    lines[row, 0], lines[row, 1], lines[row, 2], lines[row, 3] = points[u, 0], points[u, 1], x, y
    lines[row, 4] = 1.0 / square if square > 0.0 else 0.0
    return np.sqrt(square)


@helper
def _outer_edges(i, m, ring, cells, pairs, lines, beside, kept):
    """Write the edges of a cell on the boundary: those of its corners, as seen around, that no cell shares."""
    start, count = cells.offsets[i], cells.offsets[i + 1] - cells.offsets[i]
    for a in range(count):  # by angle about the centroid
        v = cells.vertices[start + a]
        angle = np.arctan2(cells.points[v, 1] - cells.centroids[i, 1], cells.points[v, 0] - cells.centroids[i, 0])
        b = a
        while b > 0 and ring[b - 1] > angle:
            ring[b], pairs[b, 2] = ring[b - 1], pairs[b - 1, 2]
            b -= 1
        ring[b], pairs[b, 2] = angle, v
    length, first = 0.0, m - kept
    for a in range(count):
        u, v = np.int32(pairs[a, 2]), np.int32(pairs[(a + 1) % count, 2])
        inner = False
        for b in range(first, m):
            inner |= (pairs[b - first, 0] == u and pairs[b - first, 1] == v) or (
                pairs[b - first, 0] == v and pairs[b - first, 1] == u
            )
        if not inner:
            length += _write_line(m, u, v, cells.points, lines)
            beside[m] = -1
            m += 1
    return m, length


@kernel
def cell_edges(cells, boundary):
    """Edges of the cells, in the plane, and by which share of its length the outline of the worst differs.

    Neighbours share the edge between the two vertices farthest apart that both have: exact unless their
    interface is bent. The boundary of a cell is made of its corners in their order about its centroid.
    """
    n, most = len(boundary), 1
    for i in range(n):
        most = max(most, cells.indptr[i + 1] - cells.indptr[i], cells.offsets[i + 1] - cells.offsets[i])
    room = len(cells.indices) + len(cells.vertices)
    offsets, beside, lines = np.zeros(n + 1, np.int64), np.empty(room, np.int32), np.empty((room, 5))
    pairs, ring = np.empty((most, 3), np.int64), np.empty(most)
    m, off, whole = 0, 0.0, 0.0
    for i in range(n):
        length, kept = 0.0, 0
        for h in range(cells.indptr[i], cells.indptr[i + 1]):
            j = cells.indices[h]
            u, v = _shared_ends(i, j, cells)
            if u >= 0:
                length += _write_line(m, u, v, cells.points, lines)
                pairs[kept, 0], pairs[kept, 1], beside[m] = u, v, j
                kept += 1
                m += 1
        if boundary[i] > 0.0:
            m, outer = _outer_edges(i, m, ring, cells, pairs, lines, beside, kept)
            length += outer
        off += abs(length - cells.surfaces[i])
        whole += cells.surfaces[i]
        offsets[i + 1] = m
    return Edges(offsets, beside[:m].copy(), lines[:m].copy()), off / whole if whole > 0.0 else 1.0


@helper
def outline(p, parts, edges, circles):
    """Write the edges around part p to the room; how many there are."""
    m, i, room = np.int64(0), parts.first[p], circles.room
    while i >= 0:
        c = np.uint64(i)
        for h in range(np.uint64(edges.offsets[c]), np.uint64(edges.offsets[c + ONE])):
            j = edges.beside[h]
            if j < 0 or parts.labels[np.uint32(j)] != p:
                for a in range(5):
                    room[a, m] = edges.lines[h, a]
                m += 1
        i = parts.after[c]
    return m


@helper
def _nearest(x, y, m, room):
    """Square of the distance to the nearest edge, and the vector from there."""
    best, bx, by = np.inf, 0.0, 0.0
    for k in range(m):
        ex, ey, dx, dy = x - room[0, k], y - room[1, k], room[2, k], room[3, k]
        along = min(max((ex * dx + ey * dy) * room[4, k], 0.0), 1.0)
        ex -= along * dx
        ey -= along * dy
        square = ex * ex + ey * ey
        if square < best:
            best, bx, by = square, ex, ey
    return best, bx, by


@helper
def _within(x, y, m, room):
    """Whether a point lies inside the edges: whether a ray crosses an odd number of them."""
    odd = False
    for k in range(m):
        low = room[1, k]
        high = low + room[3, k]
        if (low > y) != (high > y) and x < room[2, k] * (y - low) / room[3, k] + room[0, k]:
            odd = not odd
    return odd


@helper
def _ascended(x, y, m, room):
    """A circle inside the edges that is locally the largest: steps away from the nearest edge, ever shorter."""
    square, bx, by = _nearest(x, y, m, room)
    radius = np.sqrt(square)
    best, at_x, at_y, step = radius, x, y, _START * radius
    for _ in range(_STEPS):
        if not radius > 1e-14 * best:
            break
        length = min(step, _BACK * radius)
        x += length * bx / radius
        y += length * by / radius
        square, bx, by = _nearest(x, y, m, room)
        radius = np.sqrt(square)
        if radius > best:
            best, at_x, at_y = radius, x, y
        elif radius < _BACK * best:
            x, y = at_x, at_y
            square, bx, by = _nearest(x, y, m, room)
            radius = np.sqrt(square)
        step *= _SHRINK
    return best, at_x, at_y


@helper
def centre_of(p, parts, circles):
    """Centroid of part p."""
    measure = parts.tally[p, MEASURE]
    scale = 1.0 / measure if measure > 0.0 else 0.0
    return circles.rings[p, MOMENT] * scale, circles.rings[p, MOMENT + 1] * scale


@helper
def centred_radius(m, centre, room):
    """Radius of the circle about the centroid, 0 if that lies outside."""
    if m == 0 or not _within(centre[0], centre[1], m, room):
        return 0.0
    return np.sqrt(_nearest(centre[0], centre[1], m, room)[0])


@helper
def circle_inside(p, m, guess, centre, cells, parts, room):
    """Circle inside the ``m`` edges of part p: radius, centre, and the radius of that about its centroid.

    It is sought from the guess, the centroid, and if neither lies inside the deepest centroid of a cell.
    """
    best, x, y = -1.0, guess[0], guess[1]
    if m == 0:
        return 0.0, x, y, 0.0
    if _within(x, y, m, room):
        best, x, y = _ascended(x, y, m, room)
    centred = centred_radius(m, centre, room)
    if centred > 0.0:
        if best < 0.0 or (x - centre[0]) ** 2 + (y - centre[1]) ** 2 > 0.02 * best * best:
            radius, at_x, at_y = _ascended(centre[0], centre[1], m, room)
            if radius > best:
                best, x, y = radius, at_x, at_y
    if best < 0.0:
        deepest, i = -1.0, parts.first[p]
        while i >= 0:
            square = _nearest(cells.centroids[i, 0], cells.centroids[i, 1], m, room)[0]
            if square > deepest:
                deepest, x, y = square, cells.centroids[i, 0], cells.centroids[i, 1]
            i = parts.after[i]
        best, x, y = _ascended(x, y, m, room)
    return best, x, y, centred


@helper
def touches(i, p, x, y, radius, parts, edges):
    """Whether an edge of cell i with part p comes within the radius of a point."""
    for h in range(edges.offsets[i], edges.offsets[i + 1]):
        j = edges.beside[h]
        if j < 0 or parts.labels[j] != p:
            continue
        ex, ey, dx, dy = x - edges.lines[h, 0], y - edges.lines[h, 1], edges.lines[h, 2], edges.lines[h, 3]
        along = min(max((ex * dx + ey * dy) * edges.lines[h, 4], 0.0), 1.0)
        ex -= along * dx
        ey -= along * dy
        if ex * ex + ey * ey < radius * radius:
            return True
    return False


@helper
def _largest(p, m, centre, cells, parts, room):
    """The circle inside part p, sought from its centroid and from all deep centroids of its cells."""
    best = circle_inside(p, m, centre, centre, cells, parts, room)
    deepest, i = best[0], parts.first[p]
    while i >= 0:
        x, y = cells.centroids[i, 0], cells.centroids[i, 1]
        if np.sqrt(_nearest(x, y, m, room)[0]) > _DEEP * deepest:
            radius, x, y = _ascended(x, y, m, room)
            if radius > best[0]:
                best = radius, x, y, best[3]
            deepest = max(deepest, radius)
        i = parts.after[i]
    return best


@kernel
def circle_state(cells, edges, parts):
    """Circles of all parts."""
    k = len(parts.tally)
    circles = Circles(np.zeros((k, 6)), np.empty((5, len(edges.beside) + 1)))
    for i in range(len(parts.labels)):
        for a in range(2):
            circles.rings[parts.labels[i], MOMENT + a] += cells.measures[i] * cells.centroids[i, a]
    for p in range(k):
        m = outline(p, parts, edges, circles)
        found = _largest(p, m, centre_of(p, parts, circles), cells, parts, circles.room)
        for a in range(4):
            circles.rings[p, a] = found[a]
    return circles
