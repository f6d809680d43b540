"""Largest inscribed circles of 2-D parts, updated while cells move."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.anneal.state import MEASURE
from agglo_core.compiled.compiling import ONE, helper, kernel

RADIUS, ACROSS, CENTRED, MOMENT = 0, 1, 3, 4
"""Columns per part: radius and centre of its circle, radius of the circle about the centroid, first moments.
"""

# Steps of an ascent; the last step is 0.075 times the first. More steps find larger circles, and take longer
# (benchmarks/roundness.py).
_STEPS = 10
_SHRINK, _START, _BACK = 0.75, 0.35, 0.9
"""Ascent parameters: factor between steps, first step over first radius, and fraction of the best radius
below which the ascent returns to the best point. This fraction of the radius also limits each step.

A smaller factor and more returns take fewer detours, but may stop short of the largest circle
(benchmarks/roundness.py).
"""
_DEEP = 0.5
"""Depth of a cell centroid over the largest radius found, above which it starts a circle search.

A smaller value starts more searches, and misses fewer circles (benchmarks/roundness.py).
"""

_APART = 0.02
"""Squared distance from part centroid to circle centre, over squared radius, above which the centroid also
starts a circle search.

A smaller value starts more searches, and misses fewer circles (benchmarks/roundness.py).
"""


class Circles(NamedTuple):
    """Circles inside the parts ``(k, 6)``, and workspace ``(5, e + 1)`` for the boundary edges of a part."""

    rings: Any
    room: Any


@helper
def outline(p, parts, edges, circles):
    """Write the boundary edges of part p to the workspace columns, and return their number."""
    m, i, lines = np.int64(0), parts.first[p], circles.room
    while i >= 0:
        c = np.uint64(i)
        for h in range(np.uint64(edges.offsets[c]), np.uint64(edges.offsets[c + ONE])):
            j = edges.beside[h]
            if j < 0 or parts.labels[np.uint32(j)] != p:
                for a in range(5):
                    lines[a, m] = edges.lines[h, a]
                m += 1
        i = parts.after[c]
    return m


@helper
def _nearest(x, y, m, lines):
    """Return the squared distance from a point to the nearest edge, and the vector from the edge."""
    best, bx, by = np.inf, 0.0, 0.0
    for k in range(m):
        ex, ey, dx, dy = x - lines[0, k], y - lines[1, k], lines[2, k], lines[3, k]
        t = min(max((ex * dx + ey * dy) * lines[4, k], 0.0), 1.0)
        ex -= t * dx
        ey -= t * dy
        square = ex * ex + ey * ey
        if square < best:
            best, bx, by = square, ex, ey
    return best, bx, by


@helper
def _within(x, y, m, lines):
    """Return True if a point lies inside the edges (odd number of ray crossings)."""
    odd = False
    for k in range(m):
        low = lines[1, k]
        high = low + lines[3, k]
        if (low > y) != (high > y) and x < lines[2, k] * (y - low) / lines[3, k] + lines[0, k]:
            odd = not odd
    return odd


@helper
def _enlarge_circle(x, y, m, lines):
    """Enlarge a circle inside the edges to nearly a local maximum, by steps away from the nearest edge.

    Steps shrink, because at a ridge with several nearest edges constant steps would oscillate.
    """
    square, bx, by = _nearest(x, y, m, lines)
    radius = np.sqrt(square)
    best, at_x, at_y, step = radius, x, y, _START * radius
    for _ in range(_STEPS):
        if not radius > 1e-14 * best:
            break
        # 1. Step straight away from the nearest edge, by less than the radius, so that no edge is crossed.
        length = min(step, _BACK * radius)
        x += length * bx / radius
        y += length * by / radius
        square, bx, by = _nearest(x, y, m, lines)
        radius = np.sqrt(square)
        # 2. Record the best point, and return to it if the step led too far beyond the ridge.
        if radius > best:
            best, at_x, at_y = radius, x, y
        elif radius < _BACK * best:
            x, y = at_x, at_y
            square, bx, by = _nearest(x, y, m, lines)
            radius = np.sqrt(square)
        step *= _SHRINK
    return best, at_x, at_y


@helper
def centre_of(p, parts, circles):
    """Return the centroid of part p."""
    measure = parts.tally[p, MEASURE]
    scale = 1.0 / measure if measure > 0.0 else 0.0
    return circles.rings[p, MOMENT] * scale, circles.rings[p, MOMENT + 1] * scale


@helper
def centred_radius(m, centre, lines):
    """Return the radius of the circle about the centroid, or 0 if the centroid lies outside."""
    if m == 0 or not _within(centre[0], centre[1], m, lines):
        return 0.0
    return np.sqrt(_nearest(centre[0], centre[1], m, lines)[0])


@helper
def circle_inside(p, m, guess, centre, cells, parts, lines):
    """Return a circle inside the ``m`` edges of part p: radius, centre, and radius about its centroid.

    The search starts at the guess, at the centroid, and if both lie outside at the deepest cell centroid.
    """
    best, x, y = -1.0, guess[0], guess[1]
    if m == 0:
        return 0.0, x, y, 0.0
    # 1. From the guess, usually the previous circle.
    if _within(x, y, m, lines):
        best, x, y = _enlarge_circle(x, y, m, lines)
    # 2. From the centroid, unless the circle already surrounds it closely.
    centred = centred_radius(m, centre, lines)
    elsewhere = best < 0.0 or (x - centre[0]) ** 2 + (y - centre[1]) ** 2 > _APART * best * best
    if centred > 0.0 and elsewhere:
        radius, at_x, at_y = _enlarge_circle(centre[0], centre[1], m, lines)
        if radius > best:
            best, x, y = radius, at_x, at_y
    # 3. Both lie outside: start at the cell centroid farthest from the edges.
    if best < 0.0:
        deepest, i = -1.0, parts.first[p]
        while i >= 0:
            square = _nearest(cells.centroids[i, 0], cells.centroids[i, 1], m, lines)[0]
            if square > deepest:
                deepest, x, y = square, cells.centroids[i, 0], cells.centroids[i, 1]
            i = parts.after[i]
        best, x, y = _enlarge_circle(x, y, m, lines)
    return best, x, y, centred


@helper
def touches(i, p, x, y, radius, parts, edges):
    """Return True if an edge between cell i and part p comes within the radius of a point."""
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
def _largest(p, m, centre, cells, parts, lines):
    """Return the largest circle found inside part p from its centroid and from cell centroids deep inside."""
    best = circle_inside(p, m, centre, centre, cells, parts, lines)
    deepest, i = best[0], parts.first[p]
    while i >= 0:
        x, y = cells.centroids[i, 0], cells.centroids[i, 1]
        if np.sqrt(_nearest(x, y, m, lines)[0]) > _DEEP * deepest:
            radius, x, y = _enlarge_circle(x, y, m, lines)
            if radius > best[0]:
                best = radius, x, y, best[3]
            deepest = max(deepest, radius)
        i = parts.after[i]
    return best


@kernel
def circle_state(cells, edges, parts):
    """Return the largest circles found inside all parts."""
    k = len(parts.tally)
    circles = Circles(np.zeros((k, 6)), np.empty((5, len(edges.beside) + 1)))
    # 1. First moments.
    for i in range(len(parts.labels)):
        for a in range(2):
            circles.rings[parts.labels[i], MOMENT + a] += cells.measures[i] * cells.centroids[i, a]
    # 2. Largest circle of each part.
    for p in range(k):
        m = outline(p, parts, edges, circles)
        found = _largest(p, m, centre_of(p, parts, circles), cells, parts, circles.room)
        for a in range(4):
            circles.rings[p, a] = found[a]
    return circles
