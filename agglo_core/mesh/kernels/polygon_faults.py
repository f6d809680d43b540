"""Detect invalid polygons: repeated or touching vertices, zero area, crossing edges."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.compiled.compiling import helper, kernel
from agglo_core.threads import over_ranges

# Faults: repeated vertex, zero area, crossing edges, edge that folds back onto the previous edge.
OK, REPEATED, ZERO, CROSSED, FOLDED = 0, 1, 2, 3, 4
_BENT, _BENT_ZERO = 5, 6  # non-convex, still to be examined, with and without area
# vertices whose points are fetched together (16 KiB), so that cache misses overlap (benchmarks/building.py)
_ROOM = 1024


@helper
def _crosses(points, a, b, c, d):
    """Return True if segments ab and cd cross, overlap or touch."""
    # Coordinates relative to a.
    ax, ay = points[a, 0], points[a, 1]
    bx, by = points[b, 0] - ax, points[b, 1] - ay
    cx, cy = points[c, 0] - ax, points[c, 1] - ay
    dx, dy = points[d, 0] - ax, points[d, 1] - ay
    # Segments with disjoint boxes do not meet; for nearly collinear segments the signs below are rounding
    # errors.
    if min(cx, dx) > max(bx, 0.0) or max(cx, dx) < min(bx, 0.0):
        return False
    if min(cy, dy) > max(by, 0.0) or max(cy, dy) < min(by, 0.0):
        return False
    # Sides of ab that contain c and d, and sides of cd that contain a and b.
    s1 = bx * cy - by * cx
    s2 = bx * dy - by * dx
    t1 = (dx - cx) * (0.0 - cy) - (dy - cy) * (0.0 - cx)
    t2 = (dx - cx) * (by - cy) - (dy - cy) * (bx - cx)
    if s1 == 0.0 and s2 == 0.0:  # collinear: compare the intervals
        bb = bx * bx + by * by
        pc, pd = cx * bx + cy * by, dx * bx + dy * by
        return min(pc, pd) < bb and max(pc, pd) > 0.0 and bb > 0.0
    return (s1 <= 0.0 <= s2 or s2 <= 0.0 <= s1) and (t1 <= 0.0 <= t2 or t2 <= 0.0 <= t1)


@helper
def _is_convex(points, vertices, start, stop):
    """Return True if all turns of a polygon have the same direction and its boundary winds once.

    Such a boundary cannot cross itself.
    """
    # Turns at v from edge pv to vw; a straight turn must not fold back. In a single winding the x-direction
    # changes its sign twice (vertical edges count by their y-direction).
    sign, previous, flips = 0.0, 0.0, 0
    p, v = vertices[stop - 2], vertices[stop - 1]
    for i in range(start, stop):
        w = vertices[i]
        ux, uy = points[v, 0] - points[p, 0], points[v, 1] - points[p, 1]
        vx, vy = points[w, 0] - points[v, 0], points[w, 1] - points[v, 1]
        turn = ux * vy - uy * vx
        if turn == 0.0:
            if ux * vx + uy * vy < 0.0:
                return False
        elif sign * turn < 0.0:
            return False
        else:
            sign = turn
        step = vx if vx != 0.0 else vy
        flips += previous * step < 0.0
        previous = step
        p, v = v, w
    return flips <= 2


@helper
def _loop_fault(points, loop):
    """Return the fault of a non-convex polygon as a code: repeated vertex, fold, crossing edges, or none."""
    m = len(loop)
    # 1. Repeated vertices.
    for i in range(m):
        for j in range(i + 1, m):
            if loop[i] == loop[j]:
                return REPEATED
    # 2. Edges that reverse the previous edge.
    for i in range(m):
        a, b, c = loop[i - 1], loop[i], loop[(i + 1) % m]
        ux, uy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
        vx, vy = points[c, 0] - points[b, 0], points[c, 1] - points[b, 1]
        if ux * vy - uy * vx == 0.0 and ux * vx + uy * vy < 0.0:
            return FOLDED
    # 3. Crossings among all pairs of edges without a common vertex.
    for i in range(m):
        a, b = loop[i - 1], loop[i]
        for j in range(i + 1, m - 1 if i == 0 else m):  # edges (i-1, i) and (j, j+1)
            d, e = loop[j], loop[(j + 1) % m]
            if d != a and d != b and e != a and e != b and _crosses(points, a, b, d, e):
                return CROSSED
    return OK


@kernel
def plain_faults(points, offsets, vertices, weak):
    """Return signed area and fault code per polygon, without a full test of non-convex ones.

    Non-convex polygons are only marked as such.

    Polygon c has ``vertices[offsets[c]:offsets[c + 1]]``. If ``weak``, it may touch itself, and convexity is
    not tested.
    """
    n, most = len(offsets) - 1, 0
    for c in range(n):
        most = max(most, offsets[c + 1] - offsets[c])
    area, fault = np.empty(n), np.zeros(n, np.uint8)
    corners, first, last = np.empty((max(_ROOM, most), 2)), 0, 0
    for c in range(n):
        # 1. Fetch the corners of as many cells as fit.
        start, stop = offsets[c], offsets[c + 1]
        if c == last:
            first = last
            while last < n and offsets[last + 1] - offsets[first] <= len(corners):
                last += 1
            for h in range(offsets[first], offsets[last]):
                k, v = np.uint64(h - offsets[first]), np.uint64(vertices[h])
                corners[k, 0], corners[k, 1] = points[v, 0], points[v, 1]
        # 2. Area and largest squared distance, relative to the first vertex, and edges without length.
        base = start - offsets[first]
        x0, y0, twice, extent, dx, dy = corners[base, 0], corners[base, 1], 0.0, 0.0, 0.0, 0.0
        for i in range(1, stop - start):
            ex, ey = corners[base + i, 0] - x0, corners[base + i, 1] - y0
            twice += dx * ey - dy * ex
            extent = max(extent, ex * ex + ey * ey)
            dx, dy = ex, ey
            if vertices[start + i] == vertices[start + i - 1]:
                fault[c] = REPEATED
        if vertices[start] == vertices[stop - 1]:
            fault[c] = REPEATED
        area[c] = 0.5 * twice
        # 3. Triangles are convex. An area below 1e-15 of the squared extent is a rounding error.
        if fault[c] == OK:
            non_convex = stop - start > 3 and not weak and not _is_convex(points, vertices, start, stop)
            if abs(area[c]) > 1e-15 * extent:
                fault[c] = _BENT if non_convex else OK
            else:
                fault[c] = _BENT_ZERO if non_convex else ZERO
    return area, fault


@kernel
def loop_faults(points, offsets, vertices, cells):
    """Return the fault code per non-convex polygon in ``cells``."""
    fault = np.empty(len(cells), np.int64)
    for k in range(len(cells)):
        fault[k] = _loop_fault(points, vertices[offsets[cells[k]] : offsets[cells[k] + 1]])
    return fault


def check_polygons(points: Float, offsets: Int, vertices: Int, weak: bool) -> tuple[Float, Int]:
    """Return signed area and fault code per polygon.

    Polygons have three or more vertices. If ``weak``, they may touch themselves.
    """
    results = over_ranges(
        lambda start, stop: plain_faults(points, offsets[start : stop + 1], vertices, weak), len(offsets) - 1
    )
    area, fault = results[0] if len(results) == 1 else map(np.concatenate, zip(*results, strict=True))
    non_convex = np.flatnonzero(fault >= _BENT)
    if len(non_convex):  # compiled only if necessary
        faults = loop_faults(points, offsets, vertices, frozen_int(non_convex))
        harmless = (faults == OK) | (faults == FOLDED)
        fault[non_convex] = np.where(harmless & (fault[non_convex] == _BENT_ZERO), ZERO, faults)
    return area, fault
