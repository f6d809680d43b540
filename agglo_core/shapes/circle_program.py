"""The largest circle in a box, with planes in place of distances: a linear program.

Unknown are the centre p, relative to that of the box, and the radius r, to be as large as possible while
r <= d_i + g_i·p for every edge and p stays in the box: few steps of the dual simplex method. Tangents of the
distances at the centre make it a step of Newton's method, planes above the distances a bound, signed
distances from lines the exact answer in a convex outline. The dual variables λ >= 0, Σ λ = 1 over the edges
and the others of the sides of the box, tell what decides.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper
from agglo_core.shapes.circle_edges import DISTANCE, ROWS, SLOPE, offset

_STEPS = 40  # exchanges; more than ten are rare


@helper
def linearised(edges, start, stop, x, y):
    """Leave distances from (x, y) and their gradients in the table of edges."""
    for j in range(stop - start):
        i = np.uint64(start + j)
        wx, wy = x - edges[0, i], y - edges[1, i]
        t = min(max((wx * edges[2, i] + wy * edges[3, i]) * edges[6, i], 0.0), 1.0)
        wx, wy = wx - t * edges[2, i], wy - t * edges[3, i]
        distance = np.sqrt(wx * wx + wy * wy)
        scale = 1.0 / max(distance, 1e-300)
        edges[DISTANCE, i], edges[SLOPE, i], edges[SLOPE + 1, i] = distance, wx * scale, wy * scale


@helper
def majorised(edges, start, stop, x, y, sx, sy):
    """Leave planes in the table that are nowhere in the box below the distances, which are convex."""
    for j in range(stop - start):
        i = np.uint64(start + j)
        one, two = _distance(edges, i, x - sx, y - sy), _distance(edges, i, x + sx, y - sy)
        three, four = _distance(edges, i, x - sx, y + sy), _distance(edges, i, x + sx, y + sy)
        edges[SLOPE, i] = 0.25 * (two + four - one - three) / sx
        edges[SLOPE + 1, i] = 0.25 * (three + four - one - two) / sy
        edges[DISTANCE, i] = 0.25 * (one + two + three + four + abs(one + four - two - three))


@helper
def _distance(edges, i, x, y):
    """Distance from (x, y) to an edge."""
    dx, dy = offset(edges, i, x, y)
    return np.sqrt(dx * dx + dy * dy)


@helper
def convex(edges, m, tiny):
    """Whether all ends of edges are, but for ``tiny``, where the origin is of each edge's line.

    If so, distances from these lines and their gradients are left in the table.
    """
    for i in range(m):
        scale = np.sqrt(edges[6, i])
        nx, ny = -edges[3, i] * scale, edges[2, i] * scale
        distance = -(nx * edges[0, i] + ny * edges[1, i])
        if distance < 0.0:
            distance, nx, ny = -distance, -nx, -ny
        least = 0.0
        for j in range(m):
            least = min(least, distance + nx * edges[0, j] + ny * edges[1, j])
        if least < -tiny:
            return False
        edges[DISTANCE, i], edges[SLOPE, i], edges[SLOPE + 1, i] = distance, nx, ny
    return True


@helper
def tightest(edges, start, stop, px, py):
    """The edge whose linearised distance from p is least."""
    values = edges[ROWS]
    for j in range(stop - start):
        i = np.uint64(start + j)
        values[i] = edges[DISTANCE, i] + px * edges[SLOPE, i] + py * edges[SLOPE + 1, i]
    best = np.uint64(start)
    for j in range(stop - start):
        i = np.uint64(start + j)
        if values[i] < values[best]:
            best = i
    return np.int64(best)


@helper
def largest_in_box(edges, start, stop, nearest, sx, sy, enough, tiny, some, weight, m):
    """Centre relative to that of the box, and radius; up to three edges and their λ in ``some``, ``weight``.

    Begins with the ``nearest`` edge and a corner of the box; edges and sides of the box that are violated
    by more than ``tiny`` enter one by one. The radius falls from above, and is enough once it is at most
    ``enough``. ``m (3, 3)`` is scratch: the inverse of the three constraints that hold with equality.
    """
    gx, gy = edges[SLOPE, nearest], edges[SLOPE + 1, nearest]
    m[0, 0], m[0, 1], m[0, 2] = 0.0, 1.0 if gx > 0.0 else -1.0, 0.0
    m[1, 0], m[1, 1], m[1, 2] = 0.0, 0.0, 1.0 if gy > 0.0 else -1.0
    m[2, 0], m[2, 1], m[2, 2] = 1.0, abs(gx), abs(gy)
    px, py = m[0, 1] * sx, m[1, 2] * sy
    radius = edges[DISTANCE, nearest] + m[2, 1] * sx + m[2, 2] * sy
    some[0], some[1], some[2] = nearest, -1, -1
    for _ in range(_STEPS):
        if radius <= enough:
            break
        entering = tightest(edges, start, stop, px, py)
        ax, ay, ar = -edges[SLOPE, entering], -edges[SLOPE + 1, entering], 1.0
        excess = radius - edges[ROWS, entering]
        if abs(px) - sx > excess:
            entering, ax, ay, ar, excess = -1, 1.0 if px > 0.0 else -1.0, 0.0, 0.0, abs(px) - sx
        if abs(py) - sy > excess:
            entering, ax, ay, ar, excess = -1, 0.0, 1.0 if py > 0.0 else -1.0, 0.0, abs(py) - sy
        if excess <= tiny:
            break
        leaving, ratio, pivot = -1, np.inf, 1.0
        for k in range(3):
            share = ax * m[0, k] + ay * m[1, k] + ar * m[2, k]
            if share > 1e-12 and m[2, k] < ratio * share:
                leaving, ratio, pivot = k, m[2, k] / share, share
        if leaving < 0:
            break
        for row in range(3):
            m[row, leaving] /= pivot
        for k in range(3):
            if k != leaving:
                share = ax * m[0, k] + ay * m[1, k] + ar * m[2, k]
                for row in range(3):
                    m[row, k] -= share * m[row, leaving]
        some[leaving] = entering
        px -= excess * m[0, leaving]
        py -= excess * m[1, leaving]
        radius -= excess * m[2, leaving]
    for k in range(3):
        weight[k] = max(m[2, k], 0.0) if some[k] >= 0 else 0.0
        some[k] = max(some[k], 0)
    return px, py, radius
