"""Distances to the triangles around one agglomerate in space, inside or outside, which of them matter.

They stand in the table of :mod:`agglo_core.shapes.ball_table`.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper
from agglo_core.shapes.ball_table import BLOCK, DISTANCE, GROUP, LANES, ROW, SLOPE, VALUES, fill, place


@helper(inline=True)
def _own_place(table, i, x, y, z):
    """Coordinates of a point in the frame of a triangle."""
    s = x * table[i] + y * table[i + ROW[1]] + z * table[i + ROW[2]] - table[i + ROW[9]]
    t = x * table[i + ROW[3]] + y * table[i + ROW[4]] + z * table[i + ROW[5]] - table[i + ROW[10]]
    h = x * table[i + ROW[6]] + y * table[i + ROW[7]] + z * table[i + ROW[8]] - table[i + ROW[11]]
    return s, t, h


@helper(inline=True)
def _apart(table, i, s, t):
    """Vector within the plane from the nearest point of a triangle, 0 inside; least distance from its sides.

    The latter is negative outside, and then no distance.
    """
    length, cx, cy = table[i + ROW[12]], table[i + ROW[13]], table[i + ROW[14]]
    p, ex = s - length, cx - length
    two, three = s * cy - t * cx, t * ex - p * cy
    margin = min(t, min(two * table[i + ROW[17]], three * table[i + ROW[18]]))
    ds, dt = s - min(max(s, 0.0), length), t
    k = min(max((s * cx + t * cy) * table[i + ROW[15]], 0.0), 1.0)
    qs, qt = s - k * cx, t - k * cy
    nearer = qs * qs + qt * qt < ds * ds + dt * dt
    ds, dt = qs if nearer else ds, qt if nearer else dt
    k = min(max((p * ex + t * cy) * table[i + ROW[16]], 0.0), 1.0)
    qs, qt = p - k * ex, t - k * cy
    nearer = qs * qs + qt * qt < ds * ds + dt * dt
    ds, dt = qs if nearer else ds, qt if nearer else dt
    within = margin >= 0.0
    return 0.0 if within else ds, 0.0 if within else dt, margin


@helper
def distance_to(table, i, x, y, z):
    """Distance of a point from the triangle at place i."""
    i = np.uint64(i)
    s, t, h = _own_place(table, i, x, y, z)
    ds, dt, _ = _apart(table, i, s, t)
    return np.sqrt(ds * ds + dt * dt + h * h)


@helper
def nearest_triangle(table, start, stop, x, y, z):
    """The triangle nearest to a point; squares of all distances are left in the table."""
    for block in range(start, stop):
        base = np.uint64(block * BLOCK)
        for lane in range(np.uint64(LANES)):
            i = base + np.uint64(lane)
            s, t, h = _own_place(table, i, x, y, z)
            ds, dt, _ = _apart(table, i, s, t)
            table[i + ROW[20]] = ds * ds + dt * dt + h * h
    return lowest(table, start, stop)


@helper
def lowest(table, start, stop):
    """The triangle with the lowest value."""
    best, least = start * BLOCK, np.inf
    for block in range(start, stop):
        for lane in range(LANES):
            i = block * BLOCK + lane
            if table[i + VALUES] < least:
                best, least = i, table[i + VALUES]
    return best


@helper
def linearised_triangles(table, start, stop, x, y, z, sx, sy, sz):
    """Leave distances from a point and their gradients in the table; or planes that are above them in a box.

    The box has its centre at the point and these half sides, R is half its diagonal. Let d be the distance
    at the centre, q the nearest point of a triangle. In the box the distance is at most that from q, which
    is at most R² / (2d) above its tangent. If q is m inside the triangle, and the plane of that misses the
    box, all but R - m of a way along the plane costs nothing; if q is in deep enough, the tangent is exact.
    Where d is small, the distance is at most d + R.
    """
    reach = np.sqrt(sx * sx + sy * sy + sz * sz)
    for block in range(start, stop):
        base = np.uint64(block * BLOCK)
        for lane in range(np.uint64(LANES)):
            i = base + np.uint64(lane)
            s, t, h = _own_place(table, i, x, y, z)
            ds, dt, margin = _apart(table, i, s, t)
            distance = np.sqrt(ds * ds + dt * dt + h * h)
            scale = 1.0 / max(distance, 1e-300)
            ds, dt, h = ds * scale, dt * scale, h * scale
            gx = ds * table[i] + dt * table[i + ROW[3]] + h * table[i + ROW[6]]
            gy = ds * table[i + ROW[1]] + dt * table[i + ROW[4]] + h * table[i + ROW[7]]
            gz = ds * table[i + ROW[2]] + dt * table[i + ROW[5]] + h * table[i + ROW[8]]
            over = distance - abs(gx) * sx - abs(gy) * sy - abs(gz) * sz
            beyond = reach - margin if margin >= 0.0 else reach
            beyond = max(beyond, 0.0)
            along = 0.5 * beyond * beyond / max(over, 1e-300) if over >= 0.0 else np.inf
            above = min(0.5 * reach * reach * scale, along)
            steep = above <= 2.0 * reach
            table[i + ROW[21]] = distance + (above if steep else reach)
            table[i + ROW[22]] = gx if steep else 0.0
            table[i + ROW[23]] = gy if steep else 0.0
            table[i + ROW[24]] = gz if steep else 0.0


@helper
def flattened(table, blocks, some, weight, x, y, z, sides):
    """Lower the planes of triangles that are part of a large flat face to the plane of that; whether any.

    So it is if all that is seen of a box along the normal falls on triangles in that plane: if the face's
    rim, where triangles of other planes begin, is further from the foot of the centre than any point.
    """
    changed, reach = False, sides[0] * sides[0] + sides[1] * sides[1] + sides[2] * sides[2]
    for n in range(4):
        i = some[n]
        if weight[n] <= 0.0 or table[i + GROUP] < 0.0:
            continue
        s, t, h = _own_place(table, np.uint64(i), x, y, z)
        nx, ny, nz = table[i + 6 * LANES], table[i + 7 * LANES], table[i + 8 * LANES]
        over = abs(h) - abs(nx) * sides[0] - abs(ny) * sides[1] - abs(nz) * sides[2]
        value = abs(h) - min(2.0 * over, 0.0)  # a plane that just touches the box, but for rounding, serves
        margin = _apart(table, np.uint64(i), s, t)[2]
        if margin < 0.0 or over < -1e-9 * abs(h) or table[i + DISTANCE] <= value:
            continue
        px, py, pz, free = x - h * nx, y - h * ny, z - h * nz, True
        for block in range(blocks):
            for lane in range(LANES):
                j = block * BLOCK + lane
                if table[j + GROUP] != table[i + GROUP]:
                    free &= distance_to(table, j, px, py, pz) ** 2 >= reach
            if not free:
                break
        if free:
            sign = 1.0 if h >= 0.0 else -1.0
            table[i + DISTANCE], table[i + SLOPE] = value, sign * nx
            table[i + SLOPE + LANES], table[i + SLOPE + 2 * LANES] = sign * ny, sign * nz
            changed = True
    return changed


@helper
def _crossing(corners, t, p, q, x, y):
    """+1 or -1 if side pq, as seen along z, crosses the ray from (x, y) to larger x upwards or downwards."""
    up = corners[t, p + 1] <= y
    if up == (corners[t, q + 1] <= y):
        return 0
    low, high = (p, q) if up else (q, p)  # the same for both triangles beside the side
    ux, uy = corners[t, high] - corners[t, low], corners[t, high + 1] - corners[t, low + 1]
    if ux * (y - corners[t, low + 1]) - uy * (x - corners[t, low]) <= 0.0:
        return 0
    return 1 if up else -1


@helper
def inside_triangles(corners, table, m, x, y, z):
    """Whether the ray from a point along z leaves the triangles once more than it enters.

    Sides count for the two triangles beside them by one and the same sign, so that a ray that meets an edge
    or a corner is no special case; nor are cavities, loose parts and pinched edges.
    """
    total = 0
    for t in range(m):
        winds = _crossing(corners, t, 0, 3, x, y) + _crossing(corners, t, 3, 6, x, y)
        winds += _crossing(corners, t, 6, 0, x, y)
        if winds == 0:
            continue
        low = min(corners[t, 2], min(corners[t, 5], corners[t, 8]))
        high = max(corners[t, 2], max(corners[t, 5], corners[t, 8]))
        i = place(t)
        height = _own_place(table, np.uint64(i), x, y, z)[2]
        if z < low or (z <= high and height * table[i + 8 * LANES] < 0.0):
            total += winds
    return total != 0


@helper(allocates=True)
def shorter_list(table, start, stop, limit, top):
    """Copy the triangles whose square of the distance is at most ``limit`` to the blocks from ``top`` on.

    Returns the table, longer if it was full, and the range of the copies.
    """
    if len(table) < (top + stop - start) * BLOCK:
        grown = np.empty(2 * (top + stop - start) * BLOCK)
        for i in range(top * BLOCK):
            grown[i] = table[i]
        table = grown
    count = top * LANES
    for block in range(start, stop):
        for lane in range(LANES):
            i = block * BLOCK + lane
            if table[i + VALUES] <= limit:
                j = place(count)
                for row in range(0, VALUES + 1, LANES):
                    table[j + row] = table[i + row]
                count += 1
    return table, top, fill(table, count)
