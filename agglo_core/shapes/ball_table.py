"""The table of the triangles around one agglomerate in space.

A triangle abc lies in the frame of its own whose origin is a and whose first axis points to b; a point has
three coordinates there, the third its distance from the plane. Triangles stand in blocks of ``LANES``, and
row k of a block holds number k of each, so that loops over a block run in vector registers: three axes and
what is taken off along them, the length of ab, c in the plane, 1/|ac|², 1/|bc|², their roots, and a number
that triangles in one plane share, -1 for those alone in theirs; then one for the squares of distances, or
other values, and four for a plane in place of the distance, its value and gradient. A list of triangles is
a range of blocks; the last is filled up with copies of a triangle.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper

LANES = 8
GROUP, VALUES, DISTANCE, SLOPE, BLOCK = 19 * LANES, 20 * LANES, 21 * LANES, 22 * LANES, 25 * LANES
ROW = tuple(np.uint64(k * LANES) for k in range(25))  # unsigned, as indices of hot loops are
_SWEEPS = 5  # of Jacobi's method; a third already leaves nothing to see


@helper
def _turn(moments, axes, p, q):
    """One rotation of Jacobi's method: the moment of axes p and q becomes 0."""
    if abs(moments[p, q]) <= 1e-300:
        return
    theta = 0.5 * (moments[q, q] - moments[p, p]) / moments[p, q]
    t = (1.0 if theta >= 0.0 else -1.0) / (abs(theta) + np.sqrt(theta * theta + 1.0))
    cos = 1.0 / np.sqrt(t * t + 1.0)
    sin = t * cos
    for k in range(3):
        one, two = moments[k, p], moments[k, q]
        moments[k, p], moments[k, q] = cos * one - sin * two, sin * one + cos * two
    for k in range(3):
        one, two = moments[p, k], moments[q, k]
        moments[p, k], moments[q, k] = cos * one - sin * two, sin * one + cos * two
        one, two = axes[p, k], axes[q, k]
        axes[p, k], axes[q, k] = cos * one - sin * two, sin * one + cos * two


@helper
def _principal_axes(points, corners, m, centre, moments, axes):
    """Write the principal axes of the corners of triangles about a centre, as rows."""
    for p in range(3):
        for q in range(3):
            moments[p, q], axes[p, q] = 0.0, 1.0 if p == q else 0.0
    for t in range(m):
        for k in range(3):
            v = corners[t, k]
            for p in range(3):
                for q in range(3):
                    moments[p, q] += (points[v, p] - centre[p]) * (points[v, q] - centre[q])
    for _ in range(_SWEEPS):
        _turn(moments, axes, 0, 1)
        _turn(moments, axes, 0, 2)
        _turn(moments, axes, 1, 2)


@helper
def _describe(corners, t, table, i):
    """Write a triangle with these corners to the place i of the table; False if it has no area."""
    ax, ay, az = corners[t, 0], corners[t, 1], corners[t, 2]
    ux, uy, uz = corners[t, 3] - ax, corners[t, 4] - ay, corners[t, 5] - az
    vx, vy, vz = corners[t, 6] - ax, corners[t, 7] - ay, corners[t, 8] - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    size, length = np.sqrt(nx * nx + ny * ny + nz * nz), np.sqrt(ux * ux + uy * uy + uz * uz)
    if not size > 0.0:
        return False
    nx, ny, nz, ux, uy, uz = nx / size, ny / size, nz / size, ux / length, uy / length, uz / length
    fx, fy, fz = ny * uz - nz * uy, nz * ux - nx * uz, nx * uy - ny * ux
    table[i], table[i + LANES], table[i + 2 * LANES] = ux, uy, uz
    table[i + 3 * LANES], table[i + 4 * LANES], table[i + 5 * LANES] = fx, fy, fz
    table[i + 6 * LANES], table[i + 7 * LANES], table[i + 8 * LANES] = nx, ny, nz
    table[i + 9 * LANES] = ux * ax + uy * ay + uz * az
    table[i + 10 * LANES] = fx * ax + fy * ay + fz * az
    table[i + 11 * LANES] = nx * ax + ny * ay + nz * az
    cx, cy = ux * vx + uy * vy + uz * vz, fx * vx + fy * vy + fz * vz
    table[i + 12 * LANES], table[i + 13 * LANES], table[i + 14 * LANES] = length, cx, cy
    table[i + 15 * LANES] = 1.0 / (cx * cx + cy * cy)
    table[i + 16 * LANES] = 1.0 / ((cx - length) * (cx - length) + cy * cy)
    table[i + 17 * LANES] = np.sqrt(table[i + 15 * LANES])
    table[i + 18 * LANES] = np.sqrt(table[i + 16 * LANES])
    return True


@helper
def place(at):
    """Where triangle number ``at`` of a list from the first block on stands."""
    return at // LANES * BLOCK + at % LANES


@helper
def _group(table, count, tiny):
    """Write which triangles lie in one plane, on the same side of the solid."""
    for t in range(count):
        i = place(t)
        table[i + GROUP] = -1.0
        for u in range(t):
            j = place(u)
            if abs(table[i + 11 * LANES] - table[j + 11 * LANES]) > tiny:
                continue
            dot = table[i + 6 * LANES] * table[j + 6 * LANES] + table[i + 7 * LANES] * table[j + 7 * LANES]
            if dot + table[i + 8 * LANES] * table[j + 8 * LANES] < 1.0 - 1e-14:
                continue
            if table[j + GROUP] < 0.0:
                table[j + GROUP] = u
            table[i + GROUP] = table[j + GROUP]
            break


@helper
def fill(table, count):
    """Fill the last block up with copies of its first triangle; the number of blocks."""
    blocks = (count + LANES - 1) // LANES
    first = place((blocks - 1) * LANES)
    for at in range(count, blocks * LANES):
        i = place(at)
        for row in range(0, BLOCK, LANES):
            table[i + row] = table[first + row]
    return blocks


@helper(allocates=True)
def gathered_triangles(points, triangles, m, centre, moments, axes, corners, table):
    """The table of one agglomerate, in ``table`` if there is room, how many triangles it has, and blocks.

    The origin is the centre, the axes are principal ones. Triangles of no area are left out. Their
    ``corners (m, 9)`` are written, too.
    """
    if len(table) < (m + LANES) // LANES * BLOCK:
        table = np.empty(2 * (m + LANES) // LANES * BLOCK)
    _principal_axes(points, triangles, m, centre, moments, axes)
    count = 0
    for t in range(m):
        for k in range(3):
            v = triangles[t, k]
            x, y, z = points[v, 0] - centre[0], points[v, 1] - centre[1], points[v, 2] - centre[2]
            for a in range(3):
                corners[count, 3 * k + a] = axes[a, 0] * x + axes[a, 1] * y + axes[a, 2] * z
        count += _describe(corners, count, table, place(count))
    _group(table, count, 1e-9 * np.sqrt((moments[0, 0] + moments[1, 1] + moments[2, 2]) / (3 * m)))
    return table, count, fill(table, count)
