"""The largest ball in a box, with planes in place of distances: a linear program.

Unknown are the centre p, relative to that of the box, and the radius r, to be as large as possible while
r <= d_i + g_i·p for every triangle and p stays in the box: few steps of the dual simplex method. Tangents of
the distances at the centre make it a step of Newton's method, planes above the distances a bound, signed
distances from planes the exact answer in a convex solid. The dual variables λ >= 0, Σ λ = 1 over the
triangles and the others of the sides of the box, tell what decides.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper
from agglo_core.shapes.ball_table import BLOCK, DISTANCE, LANES, ROW, SLOPE, VALUES
from agglo_core.shapes.ball_triangles import lowest

_STEPS = 60  # exchanges; more than fifteen are rare


@helper
def convex_solid(corners, table, m, blocks, tiny):
    """Whether all corners are, but for ``tiny``, inside the plane of each triangle.

    If so, distances from these planes and their gradients are left in the table.
    """
    for block in range(blocks):
        for lane in range(LANES):
            i = block * BLOCK + lane
            nx, ny, nz = table[i + 6 * LANES], table[i + 7 * LANES], table[i + 8 * LANES]
            distance = table[i + 11 * LANES]
            for t in range(m):
                for k in (0, 3, 6):
                    if nx * corners[t, k] + ny * corners[t, k + 1] + nz * corners[t, k + 2] > distance + tiny:
                        return False
            table[i + DISTANCE] = distance
            table[i + SLOPE], table[i + SLOPE + LANES], table[i + SLOPE + 2 * LANES] = -nx, -ny, -nz
    return True


@helper
def lowest_plane(table, start, stop, px, py, pz):
    """The triangle whose plane is lowest at p; values of all are left in the table."""
    for block in range(start, stop):
        base = np.uint64(block * BLOCK)
        for lane in range(np.uint64(LANES)):
            i = base + np.uint64(lane)
            value = table[i + ROW[21]] + px * table[i + ROW[22]]
            table[i + ROW[20]] = value + py * table[i + ROW[23]] + pz * table[i + ROW[24]]
    return lowest(table, start, stop)


@helper
def _begin(table, first, sides, inverse, centre):
    """The first triangle and a corner of the box hold with equality: inverse and centre; the radius."""
    radius = table[first + DISTANCE]
    for row in range(4):
        for k in range(4):
            inverse[row, k] = 0.0
    inverse[3, 0] = 1.0
    for k in range(3):
        slope = table[first + SLOPE + k * LANES]
        inverse[k, k + 1] = 1.0 if slope > 0.0 else -1.0
        inverse[3, k + 1] = abs(slope)
        centre[k] = inverse[k, k + 1] * sides[k]
        radius += abs(slope) * sides[k]
    return radius


@helper
def _share(inverse, row, k):
    """Product of a constraint with a column of the inverse."""
    return row[0] * inverse[0, k] + row[1] * inverse[1, k] + row[2] * inverse[2, k] + row[3] * inverse[3, k]


@helper
def _exchange(inverse, row):
    """Let the constraint ``row`` hold in place of one of the four: which one, or -1 if none may go."""
    leaving, ratio, pivot = -1, np.inf, 1.0
    for k in range(4):
        share = _share(inverse, row, k)
        if share > 1e-12 and inverse[3, k] < ratio * share:
            leaving, ratio, pivot = k, inverse[3, k] / share, share
    if leaving < 0:
        return leaving
    for i in range(4):
        inverse[i, leaving] /= pivot
    for k in range(4):
        if k != leaving:
            share = _share(inverse, row, k)
            for i in range(4):
                inverse[i, k] -= share * inverse[i, leaving]
    return leaving


@helper
def ball_in_box(table, start, stop, first, sides, enough, tiny, centre, some, weight, inverse, row):
    """Radius; writes the centre relative to that of the box, and up to four triangles and their λ.

    Begins with the ``first`` triangle and a corner of the box; triangles and sides of the box that are
    violated by more than ``tiny`` enter one by one. The radius falls from above, and is enough once it is
    at most ``enough``. ``inverse (4, 4)`` and ``row (4,)`` are scratch: the inverse of the four
    constraints that hold with equality.
    """
    radius = _begin(table, first, sides, inverse, centre)
    some[0], some[1], some[2], some[3] = first, -1, -1, -1
    for _ in range(_STEPS):
        if radius <= enough:
            break
        entering = lowest_plane(table, start, stop, centre[0], centre[1], centre[2])
        excess = radius - table[entering + VALUES]
        for k in range(3):
            row[k] = -table[entering + SLOPE + k * LANES]
        row[3] = 1.0
        for k in range(3):
            if abs(centre[k]) - sides[k] > excess:
                entering, excess = -1, abs(centre[k]) - sides[k]
                row[0], row[1], row[2], row[3] = 0.0, 0.0, 0.0, 0.0
                row[k] = 1.0 if centre[k] > 0.0 else -1.0
        if excess <= tiny:
            break
        leaving = _exchange(inverse, row)
        if leaving < 0:
            break
        some[leaving] = entering
        for k in range(3):
            centre[k] -= excess * inverse[k, leaving]
        radius -= excess * inverse[3, leaving]
    for k in range(4):
        weight[k] = max(inverse[3, k], 0.0) if some[k] >= 0 else 0.0
        some[k] = max(some[k], 0)
    return radius
