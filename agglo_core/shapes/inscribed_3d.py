"""Geometry for the largest ball inside a polyhedron: triangle distances, bounds, linear programs."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper

# Triangle table, with LANES triangles abc side by side: ``table`` is one-dimensional, row k of the triangle
# at place i is ``table[i + k * LANES]``, and a block of LANES triangles has all its rows before the next
# block. Each triangle has a frame: u along the first side ab, f perpendicular to it within the plane, toward
# c, and the unit normal n. Rows: 0 to 8 are u, f and n; 9 to 11 the coordinates of a in this frame; 12 is |b
# - a|; 13 and 14 are c relative to a along u and f; 15 and 16 are 1 / |c - a|² and 1 / |c - b|², 17 and 18
# their square roots; 19 is the group of coplanar triangles, -1 if alone; 20 a value (squared distance, or
# plane height) for all triangles; 21 to 24 a plane, its value at a point and its gradient. More lanes fill
# longer vector registers, fewer waste less on the last block (benchmarks/solid_metrics.py, CR).
LANES = 8
# Offsets of rows 19, 20, 21 and 22 within a block, and its length.
GROUP, VALUES, DISTANCE, SLOPE, BLOCK = 19 * LANES, 20 * LANES, 21 * LANES, 22 * LANES, 25 * LANES
ROW = tuple(np.uint64(k * LANES) for k in range(25))  # unsigned, like the indices in hot loops
_SWEEPS = 5  # sweeps of Jacobi's method, with a margin: three already converge


@helper
def _turn(moments, axes, p, q):
    """Apply the Jacobi rotation that annihilates the entry (p, q) of the moment matrix."""
    if abs(moments[p, q]) <= 1e-300:
        return
    # tan of the smaller angle, from t² + 2θt - 1 = 0.
    theta = 0.5 * (moments[q, q] - moments[p, p]) / moments[p, q]
    t = (1.0 if theta >= 0.0 else -1.0) / (abs(theta) + np.sqrt(theta * theta + 1.0))
    cos = 1.0 / np.sqrt(t * t + 1.0)
    sin = t * cos
    # Rotate columns, then rows of the moments, and rows of the axes.
    for k in range(3):
        u, v = moments[k, p], moments[k, q]
        moments[k, p], moments[k, q] = cos * u - sin * v, sin * u + cos * v
    for k in range(3):
        u, v = moments[p, k], moments[q, k]
        moments[p, k], moments[q, k] = cos * u - sin * v, sin * u + cos * v
        u, v = axes[p, k], axes[q, k]
        axes[p, k], axes[q, k] = cos * u - sin * v, sin * u + cos * v


@helper
def _principal_axes(points, corners, m, centre, moments, axes):
    """Write the principal axes of the triangle corners about a centre, as rows.

    ``moments`` receives the diagonal matrix of the sums of squares along the axes, with each corner counted
    once per triangle.
    """
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
    """Write frame and shape of a triangle to the table at offset i, or return False if it is degenerate."""
    # 1. Sides ab and ac, and the normal, whose length is twice the area.
    ax, ay, az = corners[t, 0], corners[t, 1], corners[t, 2]
    ux, uy, uz = corners[t, 3] - ax, corners[t, 4] - ay, corners[t, 5] - az
    vx, vy, vz = corners[t, 6] - ax, corners[t, 7] - ay, corners[t, 8] - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    size, length = np.sqrt(nx * nx + ny * ny + nz * nz), np.sqrt(ux * ux + uy * uy + uz * uz)
    if not size > 0.0:
        return False
    # 2. Frame of the triangle: u, f = n × u, n, and coordinates of a in it.
    nx, ny, nz, ux, uy, uz = nx / size, ny / size, nz / size, ux / length, uy / length, uz / length
    fx, fy, fz = ny * uz - nz * uy, nz * ux - nx * uz, nx * uy - ny * ux
    table[i], table[i + LANES], table[i + 2 * LANES] = ux, uy, uz
    table[i + 3 * LANES], table[i + 4 * LANES], table[i + 5 * LANES] = fx, fy, fz
    table[i + 6 * LANES], table[i + 7 * LANES], table[i + 8 * LANES] = nx, ny, nz
    table[i + 9 * LANES] = ux * ax + uy * ay + uz * az
    table[i + 10 * LANES] = fx * ax + fy * ay + fz * az
    table[i + 11 * LANES] = nx * ax + ny * ay + nz * az
    # 3. The triangle in its plane, from (0, 0) to (|ab|, 0) and (cx, cy), and reciprocal lengths of two
    #    sides.
    cx, cy = ux * vx + uy * vy + uz * vz, fx * vx + fy * vy + fz * vz
    table[i + 12 * LANES], table[i + 13 * LANES], table[i + 14 * LANES] = length, cx, cy
    table[i + 15 * LANES] = 1.0 / (cx * cx + cy * cy)
    table[i + 16 * LANES] = 1.0 / ((cx - length) * (cx - length) + cy * cy)
    table[i + 17 * LANES] = np.sqrt(table[i + 15 * LANES])
    table[i + 18 * LANES] = np.sqrt(table[i + 16 * LANES])
    return True


@helper
def place(at):
    """Return the offset of triangle number ``at`` in the blocked triangle table."""
    return at // LANES * BLOCK + at % LANES


@helper
def _group(table, count, tiny):
    """Write for each triangle its group: the first coplanar triangle on the same side of the solid.

    Planes count as equal if their distances from the origin differ by at most ``tiny`` and the cosine of the
    angle between their normals is at least 1 - 1e-14.
    """
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
    """Fill the last block of the table with copies of its first triangle, and return the block count."""
    blocks = (count + LANES - 1) // LANES
    first = place((blocks - 1) * LANES)
    for at in range(count, blocks * LANES):
        i = place(at)
        for row in range(0, BLOCK, LANES):
            table[i + row] = table[first + row]
    return blocks


@helper(allocates=True)
def gather_triangles(points, triangles, m, centre, moments, axes, corners, table):
    """Collect the triangles of one agglomerate in a table, and return it with triangle and block counts.

    The table is ``table`` if it is large enough. The origin is the centre, the axes are principal axes.
    Degenerate triangles are dropped. The ``corners (m, 9)`` are also written.
    """
    if len(table) < (m + LANES) // LANES * BLOCK:
        table = np.empty(2 * (m + LANES) // LANES * BLOCK)
    # 1. Corners in principal axes, so that boxes around flat agglomerates are flat.
    _principal_axes(points, triangles, m, centre, moments, axes)
    count = 0
    for t in range(m):
        for k in range(3):
            v = triangles[t, k]
            x, y, z = points[v, 0] - centre[0], points[v, 1] - centre[1], points[v, 2] - centre[2]
            for a in range(3):
                corners[count, 3 * k + a] = axes[a, 0] * x + axes[a, 1] * y + axes[a, 2] * z
        count += _describe(corners, count, table, place(count))
    # 2. Groups of coplanar triangles. The tolerance is relative to the root-mean-square corner distance.
    _group(table, count, 1e-9 * np.sqrt((moments[0, 0] + moments[1, 1] + moments[2, 2]) / (3 * m)))
    return table, count, fill(table, count)


@helper(inline=True)
def _own_place(table, i, x, y, z):
    """Return a point's coordinates in a triangle's frame: along the first side, across it, and height."""
    s = x * table[i] + y * table[i + ROW[1]] + z * table[i + ROW[2]] - table[i + ROW[9]]
    t = x * table[i + ROW[3]] + y * table[i + ROW[4]] + z * table[i + ROW[5]] - table[i + ROW[10]]
    h = x * table[i + ROW[6]] + y * table[i + ROW[7]] + z * table[i + ROW[8]] - table[i + ROW[11]]
    return s, t, h


@helper(inline=True)
def _apart(table, i, s, t):
    """Return the in-plane vector to a point from the triangle at offset i, and the distance to its sides.

    See :func:`_beyond`.
    """
    return _beyond(
        table[i + ROW[12]], table[i + ROW[13]], table[i + ROW[14]], table[i + ROW[15]], table[i + ROW[16]],
        table[i + ROW[17]], table[i + ROW[18]], s, t,
    )  # fmt: skip


@helper(inline=True)
def _beyond(length, cx, cy, per_ac_square, per_bc_square, per_ac, per_bc, s, t):
    """Return the in-plane vector from the nearest triangle point, and the distance to the side lines.

    The point has coordinates (s, t) in the triangle frame, and the other numbers are rows 12 to 18 of the
    table. The vector is 0 inside. The distance is the minimum over the side lines, negative outside. Without
    branches, for vector registers.
    """
    # 1. Distances to the lines ab, ac and bc, positive inside: cross products over lengths.
    p, ex = s - length, cx - length
    two, three = s * cy - t * cx, t * ex - p * cy
    margin = min(t, min(two * per_ac, three * per_bc))
    # 2. The shortest of the vectors from the nearest points on ab, ac and bc.
    ds, dt = s - min(max(s, 0.0), length), t
    k = min(max((s * cx + t * cy) * per_ac_square, 0.0), 1.0)
    qs, qt = s - k * cx, t - k * cy
    is_nearer = qs * qs + qt * qt < ds * ds + dt * dt
    ds, dt = qs if is_nearer else ds, qt if is_nearer else dt
    k = min(max((p * ex + t * cy) * per_bc_square, 0.0), 1.0)
    qs, qt = p - k * ex, t - k * cy
    is_nearer = qs * qs + qt * qt < ds * ds + dt * dt
    ds, dt = qs if is_nearer else ds, qt if is_nearer else dt
    within = margin >= 0.0
    return 0.0 if within else ds, 0.0 if within else dt, margin


@helper
def add_at_corners(table, i, weight, x, y, z, sides, sums):
    """Add the weighted distances of box corners from the triangle at offset i of the table to ``sums (8,)``.

    The box has the centre (x, y, z) and the half sides ``sides``.
    """
    # 1. Centre and half sides in the triangle's frame. All numbers are read before the loop, because the
    #    compiler cannot exclude that ``sums`` overlaps the table.
    i = np.uint64(i)
    s, t, h = _own_place(table, i, x, y, z)
    sx, tx, hx = table[i] * sides[0], table[i + ROW[3]] * sides[0], table[i + ROW[6]] * sides[0]
    sy, ty, hy = table[i + ROW[1]] * sides[1], table[i + ROW[4]] * sides[1], table[i + ROW[7]] * sides[1]
    sz, tz, hz = table[i + ROW[2]] * sides[2], table[i + ROW[5]] * sides[2], table[i + ROW[8]] * sides[2]
    length, cx, cy = table[i + ROW[12]], table[i + ROW[13]], table[i + ROW[14]]
    per_ac_square, per_bc_square = table[i + ROW[15]], table[i + ROW[16]]
    per_ac, per_bc = table[i + ROW[17]], table[i + ROW[18]]
    # 2. The corners, in vector registers.
    for corner in range(np.uint64(8)):
        a = 1.0 if corner & np.uint64(1) else -1.0
        b = 1.0 if corner & np.uint64(2) else -1.0
        c = 1.0 if corner & np.uint64(4) else -1.0
        along, across = s + a * sx + b * sy + c * sz, t + a * tx + b * ty + c * tz
        height = h + a * hx + b * hy + c * hz
        ds, dt, _ = _beyond(length, cx, cy, per_ac_square, per_bc_square, per_ac, per_bc, along, across)
        sums[corner] += weight * np.sqrt(ds * ds + dt * dt + height * height)


@helper
def is_clear(table, start, stop, group, x, y, z, limit):
    """Return True if the squared distance of a point from all triangles outside a group is at least a limit.

    The triangles are those in the blocks from ``start`` to ``stop``.
    """
    for block in range(start, stop):
        base, near = np.uint64(block * BLOCK), 0
        for lane in range(np.uint64(LANES)):
            i = base + np.uint64(lane)
            s, t, h = _own_place(table, i, x, y, z)
            ds, dt, _ = _apart(table, i, s, t)
            near += (ds * ds + dt * dt + h * h < limit) & (table[i + ROW[19]] != group)
        if near > 0:
            return False
    return True


@helper
def nearest_triangle(table, start, stop, x, y, z):
    """Return the table offset of the triangle nearest to a point.

    The squared distances of all triangles are written to the table.
    """
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
    """Return the table offset of the first triangle with the lowest stored value."""
    best, least = start * BLOCK, np.inf
    for block in range(start, stop):
        for lane in range(LANES):
            i = block * BLOCK + lane
            if table[i + VALUES] < least:
                best, least = i, table[i + VALUES]
    return best


@helper
def linearise_triangles(table, start, stop, x, y, z, sx, sy, sz):
    """Write affine upper bounds ("planes") of the triangle distances in a box to the table.

    The box has centre (x, y, z) and half sides sx, sy, sz, and R is half its diagonal. For R = 0 the planes
    are tangents: distances and their gradients. Let d be the distance at the centre, and q the nearest point
    of a triangle. In the box the distance is at most the distance to q, which exceeds its tangent by at most
    R² / (2d). If q lies m inside the triangle, and the triangle's plane misses the box, only displacements
    beyond m along the plane, at most R - m, contribute. If q lies deep enough, the tangent is exact. For
    small d, the distance is at most d + R.
    """
    reach = np.sqrt(sx * sx + sy * sy + sz * sz)
    for block in range(start, stop):
        base = np.uint64(block * BLOCK)
        for lane in range(np.uint64(LANES)):
            i = base + np.uint64(lane)
            # 1. Distance d to the nearest point q, and its gradient, the unit vector from q.
            s, t, h = _own_place(table, i, x, y, z)
            ds, dt, margin = _apart(table, i, s, t)
            distance = np.sqrt(ds * ds + dt * dt + h * h)
            scale = 1.0 / max(distance, 1e-300)
            ds, dt, h = ds * scale, dt * scale, h * scale
            gx = ds * table[i] + dt * table[i + ROW[3]] + h * table[i + ROW[6]]
            gy = ds * table[i + ROW[1]] + dt * table[i + ROW[4]] + h * table[i + ROW[7]]
            gz = ds * table[i + ROW[2]] + dt * table[i + ROW[5]] + h * table[i + ROW[8]]
            # 2. The least height of the box over the plane through q perpendicular to the gradient, and the
            #    largest displacement of box points beyond the triangle's rim, as seen along the gradient.
            clearance = distance - abs(gx) * sx - abs(gy) * sy - abs(gz) * sz
            beyond = reach - margin if margin >= 0.0 else reach
            beyond = max(beyond, 0.0)
            # 3. At height h and displacement w, the distance is at most √(h² + w²) ≤ h + w² / (2h). Use the
            #    better of this and the bound R² / (2d), or a constant plane d + R if neither helps.
            along = 0.5 * beyond * beyond / max(clearance, 1e-300) if clearance >= 0.0 else np.inf
            above = min(0.5 * reach * reach * scale, along)
            steep = above <= 2.0 * reach
            table[i + ROW[21]] = distance + (above if steep else reach)
            table[i + ROW[22]] = gx if steep else 0.0
            table[i + ROW[23]] = gy if steep else 0.0
            table[i + ROW[24]] = gz if steep else 0.0


@helper
def lower_planes(table, start, stop, most, some, weight, x, y, z, sides):
    """Lower the affine distance bounds of triangles in large flat faces, and return True if any was lowered.

    The distance to a triangle may be replaced by the distance to its face's plane if the box, seen along the
    normal, lies on the face: if the face's rim, where triangles in other planes begin, is at least R from the
    foot of the centre (x, y, z), with R half the diagonal. Only triangles with positive ``weight`` whose
    planes are at most ``most`` from the centre are considered. The blocks from ``start`` to ``stop`` contain
    all triangles at a distance of at most ``most`` + R from the centre.
    """
    changed, reach = False, sides[0] * sides[0] + sides[1] * sides[1] + sides[2] * sides[2]
    for n in range(4):
        i = some[n]
        if weight[n] <= 0.0 or table[i + GROUP] < 0.0:
            continue
        # 1. The foot of the centre must lie in the triangle, the box on one side of the plane, and the plane
        #    in the table must not be that low already.
        s, t, h = _own_place(table, np.uint64(i), x, y, z)
        nx, ny, nz = table[i + 6 * LANES], table[i + 7 * LANES], table[i + 8 * LANES]
        clearance = abs(h) - abs(nx) * sides[0] - abs(ny) * sides[1] - abs(nz) * sides[2]
        value = abs(h) - min(2.0 * clearance, 0.0)  # also accept a plane that touches the box up to rounding
        margin = _apart(table, np.uint64(i), s, t)[2]
        if margin < 0.0 or abs(h) > most or clearance < -1e-9 * abs(h) or table[i + DISTANCE] <= value:
            continue
        # 2. All triangles in other planes must be at least R from that foot. (``reach`` is R².)
        px, py, pz = x - h * nx, y - h * ny, z - h * nz
        # 3. In the whole box, the distance to the face equals the height over the plane.
        if is_clear(table, start, stop, table[i + GROUP], px, py, pz, reach):
            sign = 1.0 if h >= 0.0 else -1.0
            table[i + DISTANCE], table[i + SLOPE] = value, sign * nx
            table[i + SLOPE + LANES], table[i + SLOPE + 2 * LANES] = sign * ny, sign * nz
            changed = True
    return changed


@helper
def _crossing_sign(corners, t, p, q, x, y):
    """Return ±1 if side pq, projected along z, crosses the ray from (x, y) in direction x, else 0.

    +1 is an upward crossing, −1 a downward crossing.
    """
    # 1. Half-open: a side crosses if one end is at y or below and the other above.
    is_upward = corners[t, p + 1] <= y
    if is_upward == (corners[t, q + 1] <= y):
        return 0
    low, high = (p, q) if is_upward else (q, p)  # equal for both triangles at this side
    # 2. (x, y) must be left of the side, seen from the lower end.
    ux, uy = corners[t, high] - corners[t, low], corners[t, high + 1] - corners[t, low + 1]
    if ux * (y - corners[t, low + 1]) - uy * (x - corners[t, low]) <= 0.0:
        return 0
    return 1 if is_upward else -1


@helper
def inside_triangles(corners, table, m, x, y, z):
    """Return True if a point is inside: if signed surface crossings of an upward ray do not cancel.

    Sides count with one sign for both adjacent triangles, so that a ray through an edge or a corner needs no
    special case. Neither do cavities, loose parts and pinched edges.
    """
    total = 0
    for t in range(m):
        # 1. Winding of the triangle, seen along z, around the point: 0 or ±1, by its orientation.
        winds = _crossing_sign(corners, t, 0, 3, x, y) + _crossing_sign(corners, t, 3, 6, x, y)
        winds += _crossing_sign(corners, t, 6, 0, x, y)
        if winds == 0:
            continue
        # 2. Count the triangle if it is above the point. Its plane decides only if the heights of its corners
        #    do not.
        low = min(corners[t, 2], min(corners[t, 5], corners[t, 8]))
        high = max(corners[t, 2], max(corners[t, 5], corners[t, 8]))
        i = place(t)
        height = _own_place(table, np.uint64(i), x, y, z)[2]
        if z < low or (z <= high and height * table[i + 8 * LANES] < 0.0):
            total += winds
    return total != 0


@helper
def on_inner_side(table, nearest, x, y, z):
    """Return True if a point is on the inner side of the triangle nearest to it, above its interior.

    Such a point is inside. Others may be inside, too: above an edge, or at a crack, where the nearest of two
    coincident triangles is a matter of rounding.
    """
    i = np.uint64(nearest)
    s, t, h = _own_place(table, i, x, y, z)
    return h < 0.0 and _apart(table, i, s, t)[2] > -1e-6 * h


@helper(allocates=True)
def shorter_list(table, start, stop, limit, top):
    """Copy the triangles at a squared distance of at most ``limit`` to the table blocks from ``top`` on.

    The squared distances come from :func:`nearest_triangle`. Returns the table, enlarged if it was full, and
    the block range of the copies. This is the given range, without copies, if more than half of its triangles
    are that near: copies cost more than they save.
    """
    count = 0
    for block in range(start, stop):
        base = np.uint64(block * BLOCK)
        for lane in range(np.uint64(LANES)):
            count += table[base + np.uint64(lane) + ROW[20]] <= limit
    if 2 * count > (stop - start) * LANES:
        return table, start, stop
    # 1. Enlarge a full table.
    if len(table) < (top + stop - start) * BLOCK:
        new_table = np.empty(2 * (top + stop - start) * BLOCK)
        for i in range(top * BLOCK):
            new_table[i] = table[i]
        table = new_table
    # 2. Copy the near triangles.
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


_STEPS = 60  # maximum number of pivots in a linear program, a safeguard; more than fifteen are rare


@helper
def convex_solid(corners, table, m, blocks, tiny):
    """Return True if all corners lie, within ``tiny``, on the inner side of every triangle plane.

    In this case the distances from the origin to these planes and their gradients are written to the table.
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
    """Return the table offset of the triangle with the lowest affine distance bound at p.

    The values of all planes are written to the table.
    """
    for block in range(start, stop):
        base = np.uint64(block * BLOCK)
        for lane in range(np.uint64(LANES)):
            i = base + np.uint64(lane)
            value = table[i + ROW[21]] + px * table[i + ROW[22]]
            table[i + ROW[20]] = value + py * table[i + ROW[23]] + pz * table[i + ROW[24]]
    return lowest(table, start, stop)


@helper
def _begin(table, first, sides, inverse, centre):
    """Start the dual simplex method with the first triangle and a box corner as active constraints.

    The corner lies in gradient direction, where the triangle's plane is highest. Writes the inverse of the
    four constraints, and this corner as the centre. Returns the radius.
    """
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
    """Return the product of a constraint row with column k of the inverse constraint matrix."""
    return row[0] * inverse[0, k] + row[1] * inverse[1, k] + row[2] * inverse[2, k] + row[3] * inverse[3, k]


@helper
def _exchange(inverse, row):
    """Replace one of the four active constraints by ``row``, and update the inverse constraint matrix.

    Returns the index of the replaced constraint, or -1 if none may leave.
    """
    # 1. Ratio test: the multipliers, row 3 of the inverse, stay ≥ 0. Components below 1e-12 count as
    #    rounding.
    leaving, ratio, pivot = -1, np.inf, 1.0
    for k in range(4):
        share = _share(inverse, row, k)
        if share > 1e-12 and inverse[3, k] < ratio * share:
            leaving, ratio, pivot = k, inverse[3, k] / share, share
    if leaving < 0:
        return leaving
    # 2. Column operations that make the product of the new row with the inverse a unit row.
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
    """Maximise the minimum of the triangles' affine distance bounds over a box (dual simplex method).

    The linear program in (p, r): maximise r with r - g_i · p ≤ d_i for each plane (d_i its value at the box
    centre, g_i its gradient) and |p_k| ≤ sides[k]. Returns r. Writes p, relative to the box centre, to
    ``centre``, and up to four triangles and their multipliers λ, with sum 1, to ``some`` and ``weight``.

    Starts with the ``first`` triangle and a box corner. Triangles and box sides violated by more than
    ``tiny`` enter one by one. The radius decreases monotonically, and the iteration stops early when it is at
    most ``enough``. ``inverse (4, 4)`` and ``row (4,)`` are workspace: the inverse of the four active
    constraints.
    """
    radius = _begin(table, first, sides, inverse, centre)
    some[0], some[1], some[2], some[3] = first, -1, -1, -1
    for _ in range(_STEPS):
        if radius <= enough:
            break
        # 1. The most violated constraint, a plane or a box side, enters.
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
        # 2. One of the four constraints leaves, and (p, r) moves along the column of the new constraint until
        #    it is active.
        leaving = _exchange(inverse, row)
        if leaving < 0:
            break
        some[leaving] = entering
        for k in range(3):
            centre[k] -= excess * inverse[k, leaving]
        radius -= excess * inverse[3, leaving]
    # 3. Active triangles and their λ; box sides have weight 0.
    for k in range(4):
        weight[k] = max(inverse[3, k], 0.0) if some[k] >= 0 else 0.0
        some[k] = max(some[k], 0)
    return radius
