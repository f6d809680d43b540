"""The largest circles inside parts of the plane, followed while cells move."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.anneal.state import MEASURE
from agglo_core.compiled.compiling import ONE, helper, kernel

RADIUS, ACROSS, CENTRED, MOMENT = 0, 1, 3, 4
"""Columns of a part: radius of its circle, its centre, that of the circle about the centroid, moments."""

_STEPS = 10  # of an ascent, the last one 0.075 times the first
_SHRINK, _START, _BACK = 0.75, 0.35, 0.9
"""Of an ascent: factor between steps, the first step over the first radius, and the share of the best radius
below which it goes back to the best point; no step exceeds this share of the radius either."""
_DEEP = 0.5
"""Depth of a centroid, over the largest radius found, above which a circle is sought from it."""

_APART = 0.02
"""Squared distance of the centroid over squared radius above which a circle is sought from it, too."""


class Circles(NamedTuple):
    """Circles of the parts ``(k, 6)``, and a work array ``(5, e + 1)`` for the edges around one."""

    rings: Any
    room: Any


@helper
def outline(p, parts, edges, circles):
    """Write the edges around part p to the columns of the work array and return how many there are."""
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
    """Square of the distance from a point to the nearest edge, and the vector from there to the point."""
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
    """Return whether a point lies inside the edges: a ray from it crosses an odd number of them."""
    odd = False
    for k in range(m):
        low = room[1, k]
        high = low + room[3, k]
        if (low > y) != (high > y) and x < room[2, k] * (y - low) / room[3, k] + room[0, k]:
            odd = not odd
    return odd


@helper
def _ascended(x, y, m, room):
    """Circle inside the edges, locally nearly the largest, by steps away from the nearest edge.

    At a ridge, where several edges are equally near, steps that do not shrink would go to and fro.
    """
    square, bx, by = _nearest(x, y, m, room)
    radius = np.sqrt(square)
    best, at_x, at_y, step = radius, x, y, _START * radius
    for _ in range(_STEPS):
        if not radius > 1e-14 * best:
            break
        # 1. A step straight away from the nearest edge; less than the radius, so that no edge is crossed.
        length = min(step, _BACK * radius)
        x += length * bx / radius
        y += length * by / radius
        square, bx, by = _nearest(x, y, m, room)
        radius = np.sqrt(square)
        # 2. Note the best point; go back to it if the step led too far beyond the ridge.
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
    """Circle inside the ``m`` edges of part p: radius, centre, and radius of the one about its centroid.

    It is sought from the guess, the centroid, and if neither lies inside the deepest centroid of a cell.
    """
    best, x, y = -1.0, guess[0], guess[1]
    if m == 0:
        return 0.0, x, y, 0.0
    # 1. From the guess, mostly the circle that the part had.
    if _within(x, y, m, room):
        best, x, y = _ascended(x, y, m, room)
    # 2. From the centroid, unless the circle found is about it already.
    centred = centred_radius(m, centre, room)
    elsewhere = best < 0.0 or (x - centre[0]) ** 2 + (y - centre[1]) ** 2 > _APART * best * best
    if centred > 0.0 and elsewhere:
        radius, at_x, at_y = _ascended(centre[0], centre[1], m, room)
        if radius > best:
            best, x, y = radius, at_x, at_y
    # 3. Both lie outside: from the centroid of a cell farthest from the edges.
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
    """Return whether an edge of cell i with part p comes within the radius of a point."""
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
    """Circle inside part p, sought from its centroid and from all deep centroids of its cells."""
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
