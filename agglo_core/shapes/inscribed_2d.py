"""Geometry for the largest circle inside a polygon with holes: edge distances, bounds, trapezoids."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper
from agglo_core.compiled.sorting import sort_by_keys
from agglo_core.shapes.box_heap import push

# Edge table, one column per edge ab: rows 0 and 1 are a, 2 and 3 are b - a, 4 and 5 are b, 6 is 1 / |b - a|².
# An axis k = 0, 1 uses a[k] in row k, (b - a)[k] in row 2 + k and b[k] in row 4 + k.
ROWS = 7  # numbers that describe an edge; the next row is for squared distances
DISTANCE, SLOPE, HEIGHT = 8, 9, 11  # rows of planes, value and gradient (two rows); total number of rows
FIRST, LAST = 8, 9  # rows of the vertices a and b, until planes are written there


@helper(allocates=True)
def gather_edges(points, start, stop, faces, face_vertices, x0, y0, edges):
    """Collect the edges of one agglomerate in a table, and return the table and the edge count.

    The table is ``edges`` if that is large enough.

    The origin is (x0, y0), the first axis is the axis of the largest moment. Edges without length are
    dropped.
    """
    if edges.shape[1] < stop - start:
        edges = np.empty((HEIGHT, 2 * (stop - start)))
    # 1. Edge ends relative to the origin, and second moments of the outline as a wire with constant density.
    sxx, sxy, syy = 0.0, 0.0, 0.0
    m = 0
    for h in range(start, stop):
        p, q = face_vertices[faces[h], 0], face_vertices[faces[h], 1]
        ax, ay = points[p, 0] - x0, points[p, 1] - y0
        bx, by = points[q, 0] - x0, points[q, 1] - y0
        square = (bx - ax) ** 2 + (by - ay) ** 2
        if square > 0.0:
            edges[0, m], edges[1, m], edges[4, m], edges[5, m] = ax, ay, bx, by
            edges[FIRST, m], edges[LAST, m] = p, q
            m += 1
            length = np.sqrt(square)  # moments of the edge about the origin, times 3
            sxx += length * (ax * ax + ax * bx + bx * bx)
            syy += length * (ay * ay + ay * by + by * by)
            sxy += length * (ax * ay + bx * by + 0.5 * (ax * by + bx * ay))
    # 2. Rotate to the principal axes, where the mixed moment is 0.
    angle = 0.5 * np.arctan2(2.0 * sxy, sxx - syy)
    cos, sin = np.cos(angle), np.sin(angle)
    for i in range(m):
        for k in (0, 4):
            x, y = edges[k, i], edges[k + 1, i]
            edges[k, i], edges[k + 1, i] = cos * x + sin * y, cos * y - sin * x
        edges[2, i], edges[3, i] = edges[4, i] - edges[0, i], edges[5, i] - edges[1, i]
        edges[6, i] = 1.0 / (edges[2, i] ** 2 + edges[3, i] ** 2)
    return edges, m


@helper
def bounding_box(edges, m):
    """Return centre and half side lengths of the bounding box of the edges."""
    x_low, x_high, y_low, y_high = np.inf, -np.inf, np.inf, -np.inf
    for i in range(m):
        x, y = edges[0, i], edges[1, i]
        x_low, x_high = min(x_low, x, edges[4, i]), max(x_high, x, edges[4, i])
        y_low, y_high = min(y_low, y, edges[5, i]), max(y_high, y, edges[5, i])
    return 0.5 * (x_low + x_high), 0.5 * (y_low + y_high), 0.5 * (x_high - x_low), 0.5 * (y_high - y_low)


@helper
def offset(edges, i, x, y):
    """Return the vector from the nearest point of edge i to (x, y)."""
    # The foot of the perpendicular is a + t (b - a), clamped to the ends.
    wx, wy = x - edges[0, i], y - edges[1, i]
    t = min(max((wx * edges[2, i] + wy * edges[3, i]) * edges[6, i], 0.0), 1.0)
    return wx - t * edges[2, i], wy - t * edges[3, i]


@helper
def nearest_edge(edges, start, stop, x, y):
    """Return the index of the edge nearest to (x, y).

    The squared distances of all edges are written to row ``ROWS``.
    """
    squares = edges[ROWS]
    for j in range(stop - start):
        i = np.uint64(start + j)  # unsigned, without wraparound of negative indices: allows vectorisation
        dx, dy = offset(edges, i, x, y)
        squares[i] = dx * dx + dy * dy
    nearest = np.uint64(start)
    for j in range(stop - start):
        i = np.uint64(start + j)
        if squares[i] < squares[nearest]:
            nearest = i
    return np.int64(nearest)


@helper
def crosses(edges, start, stop, axis, place, to, level):
    """Return True if the path from ``place`` to ``to`` along an axis crosses an odd number of edges.

    Both are coordinates along the axis, ``level`` is the coordinate along the other axis. From infinity this
    is the even-odd rule.
    """
    a, b, u = edges[axis], edges[5 - axis], edges[2 + axis]
    c, v = edges[1 - axis], edges[3 - axis]
    crossings = 0
    for j in range(stop - start):  # without branches
        i = np.uint64(start + j)
        # The line at ``level`` meets the edge at a + (level - c) u / v if the edge ends are on different
        # sides of the line (half-open, so that a vertex counts once). The path crosses the edge if exactly
        # one of its ends lies before that point. Multiplication by v avoids division for edges along the
        # axis.
        reach = (level - c[i]) * u[i]
        up = v[i] > 0.0
        one = ((place - a[i]) * v[i] < reach) == up
        two = ((to - a[i]) * v[i] < reach) == up
        crossings += 1 if ((c[i] > level) != (b[i] > level)) & (one != two) else 0
    return crossings & 1 == 1


@helper
def signed_distance(edges, m, x, y):
    """Return the distance from (x, y) to the outline, negative outside."""
    distance = np.sqrt(edges[ROWS, nearest_edge(edges, np.int64(0), m, x, y)])
    return distance if crosses(edges, np.int64(0), m, np.int64(0), np.inf, x, y) else -distance


@helper
def is_inside(edges, m, start, stop, axis, x0, y0, distance0, tiny, x, y):
    """Return True if (x, y) is inside, given the side of (x0, y0) on the same axis-parallel line.

    The point (x0, y0) has signed distance ``distance0``. ``start`` to ``stop`` are the edges near both
    points. All ``m`` edges are used if (x0, y0) is within ``tiny`` of the boundary.
    """
    place, to, level = (x0, x, y) if axis == 0 else (y0, y, x)
    # A path shorter than the distance to the boundary crosses nothing. From a point on the boundary, whose
    # side is lost in rounding, start at infinity instead, which is outside.
    if abs(to - place) < abs(distance0):
        return distance0 > 0.0
    if abs(distance0) <= tiny:
        start, stop, axis, place, to, level = 0, m, 0, np.inf, x, y
    return (distance0 > tiny) != crosses(edges, start, stop, axis, place, to, level)


@helper
def apart(edges, start, stop, x, y, sx, sy):
    """Return True if no edge meets a box with centre (x, y) and half side lengths sx, sy."""
    meeting = 0
    for j in range(stop - start):
        # Separating axes: a box and an edge are disjoint if they are disjoint along x, along y or along the
        # edge normal.
        i = np.uint64(start + j)
        ux, uy = edges[2, i], edges[3, i]
        wx, wy = 0.5 * (edges[0, i] + edges[4, i]) - x, 0.5 * (edges[1, i] + edges[5, i]) - y
        near = (abs(wx) <= sx + 0.5 * abs(ux)) & (abs(wy) <= sy + 0.5 * abs(uy))
        meeting += 1 if near & (abs(wx * uy - wy * ux) <= sx * abs(uy) + sy * abs(ux)) else 0
    return meeting == 0


@helper(allocates=True)
def list_near_edges(edges, start, stop, limit, top):
    """Copy the edges near a point to columns from ``top`` on, if at most half of all edges are near.

    Near edges have a squared distance of at most ``limit``, as computed by :func:`nearest_edge`. Returns the
    table, enlarged if it was full, and the column range of the list: the copies, or all edges as before if
    more than half are near.
    """
    # 1. Count the near edges.
    count = 0
    for j in range(stop - start):
        count += 1 if edges[ROWS, np.uint64(start + j)] <= limit else 0
    if 2 * count > stop - start:
        return edges, start, stop
    # 2. Enlarge a full table, and copy them.
    if top + count > edges.shape[1]:
        new_table = np.empty((HEIGHT, 2 * (top + count)))
        for k in range(ROWS + 1):
            for i in range(top):
                new_table[k, i] = edges[k, i]
        edges = new_table
    end = top
    for i in range(start, stop):
        if edges[ROWS, i] <= limit:
            for k in range(ROWS):
                edges[k, end] = edges[k, i]
            end += 1
    return edges, top, end


_STEPS = 40  # maximum number of pivots in a linear program, a safeguard; more than ten are rare


@helper
def linearise_distances(edges, start, stop, x, y):
    """Write the distances from (x, y) to the edges, and their gradients, to the edge table."""
    for j in range(stop - start):
        i = np.uint64(start + j)
        wx, wy = x - edges[0, i], y - edges[1, i]
        t = min(max((wx * edges[2, i] + wy * edges[3, i]) * edges[6, i], 0.0), 1.0)
        wx, wy = wx - t * edges[2, i], wy - t * edges[3, i]
        distance = np.sqrt(wx * wx + wy * wy)
        scale = 1.0 / max(distance, 1e-300)
        edges[DISTANCE, i], edges[SLOPE, i], edges[SLOPE + 1, i] = distance, wx * scale, wy * scale


@helper
def majorise_distances(edges, start, stop, x, y, sx, sy):
    """Write an affine upper bound ("plane") of the distance to each edge over a box to the edge table.

    The box has centre (x, y) and half sides sx, sy. A plane is stored as its value at the centre and its
    gradient.
    """
    for j in range(stop - start):
        i = np.uint64(start + j)
        # A convex function lies below the bilinear interpolant of its corner values: a plane plus a term in x
        # y, which has its largest modulus at the corners.
        d00, d10 = _distance(edges, i, x - sx, y - sy), _distance(edges, i, x + sx, y - sy)
        d01, d11 = _distance(edges, i, x - sx, y + sy), _distance(edges, i, x + sx, y + sy)
        edges[SLOPE, i] = 0.25 * (d10 + d11 - d00 - d01) / sx
        edges[SLOPE + 1, i] = 0.25 * (d01 + d11 - d00 - d10) / sy
        edges[DISTANCE, i] = 0.25 * (d00 + d10 + d01 + d11 + abs(d00 + d11 - d10 - d01))


@helper
def _distance(edges, i, x, y):
    """Return the distance from (x, y) to an edge."""
    dx, dy = offset(edges, i, x, y)
    return np.sqrt(dx * dx + dy * dy)


@helper
def convex(edges, m, tiny):
    """Return True if all edge ends lie, within ``tiny``, on the origin's side of every edge line.

    In this case the distances from the origin to these lines and their gradients are written to the table.
    """
    for i in range(m):
        # 1. Unit normal toward the origin, and the distance to the origin.
        scale = np.sqrt(edges[6, i])
        nx, ny = -edges[3, i] * scale, edges[2, i] * scale
        distance = -(nx * edges[0, i] + ny * edges[1, i])
        if distance < 0.0:
            distance, nx, ny = -distance, -nx, -ny
        # 2. The lowest end in that direction must not be beyond the line. Edges may have either orientation
        #    along the outline, so a vertex may be the second end of both its edges.
        least = 0.0
        for j in range(m):
            least = min(least, distance + nx * edges[0, j] + ny * edges[1, j])
            least = min(least, distance + nx * edges[4, j] + ny * edges[5, j])
        if least < -tiny:
            return False
        edges[DISTANCE, i], edges[SLOPE, i], edges[SLOPE + 1, i] = distance, nx, ny
    return True


@helper
def tightest(edges, start, stop, px, py):
    """Return the index of the edge with the lowest plane (affine bound of its distance) at p.

    The values of all planes are written to row ``ROWS``.
    """
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
    """Maximise the minimum of the edges' affine distance bounds over a box, by the dual simplex method.

    The linear program in (p, r): maximise r with r - g_i · p ≤ d_i for each plane (d_i its value at the box
    centre, g_i its gradient), |p_x| ≤ sx and |p_y| ≤ sy. Returns p, relative to the centre, and r. Writes up
    to three edges and their multipliers λ, with sum 1, to ``some`` and ``weight``.

    Starts with the ``nearest`` edge and a box corner. Edges and box sides violated by more than ``tiny``
    enter one by one. The radius decreases monotonically, and the iteration stops early when it is at most
    ``enough``. ``m (3, 3)`` is workspace: the inverse of the three active constraints.
    """
    # 1. The plane of one edge is highest at the corner in gradient direction: both box sides there and the
    #    edge are active. Column k of the inverse is the change in (p, r) per unit of the right-hand side k.
    #    Its last entry is the multiplier λ_k ≥ 0.
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
        # 2. The most violated constraint, an edge or a box side, enters: row (ax, ay, ar).
        entering = tightest(edges, start, stop, px, py)
        ax, ay, ar = -edges[SLOPE, entering], -edges[SLOPE + 1, entering], 1.0
        excess = radius - edges[ROWS, entering]
        if abs(px) - sx > excess:
            entering, ax, ay, ar, excess = -1, 1.0 if px > 0.0 else -1.0, 0.0, 0.0, abs(px) - sx
        if abs(py) - sy > excess:
            entering, ax, ay, ar, excess = -1, 0.0, 1.0 if py > 0.0 else -1.0, 0.0, abs(py) - sy
        if excess <= tiny:
            break
        # 3. Ratio test: the constraint leaves for which all λ stay ≥ 0. Components of the new row below 1e-12
        #    count as rounding.
        leaving, ratio, pivot = -1, np.inf, 1.0
        for k in range(3):
            share = ax * m[0, k] + ay * m[1, k] + ar * m[2, k]
            if share > 1e-12 and m[2, k] < ratio * share:
                leaving, ratio, pivot = k, m[2, k] / share, share
        if leaving < 0:
            break
        # 4. Update the inverse, and move along the column of the new constraint until it is active.
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
    # 5. Active edges and their λ; box sides have weight 0.
    for k in range(3):
        weight[k] = max(m[2, k], 0.0) if some[k] >= 0 else 0.0
        some[k] = max(some[k], 0)
    return px, py, radius


# Average number of edges crossed by a slab, above which trapezoids cost more than boxes
# (benchmarks/pathologies.py, quality of the crescent and of stretched cells).
_CROWD = 24


@helper
def _next_slab(edges, order, begins, active, count, n_begun, x_left):
    """Advance the sweep line to ``x_left``, and update the set of edges that cross it.

    ``active[:count]`` are the edges crossed by the line, ``order`` all edges sorted by their left ends
    ``begins``, of which ``n_begun`` were visited. Returns the numbers of active and visited edges, and the
    ends of the slab: from ``x_left``, or from the start of the next edge if none is active, to the next
    vertex.
    """
    # 1. Keep the edges that continue beyond the line.
    n_active, x_right = 0, np.inf
    for k in range(count):
        i = active[k]
        end = max(edges[0, i], edges[4, i])
        if end > x_left:
            active[n_active], x_right = i, min(x_right, end)
            n_active += 1
    # 2. In a gap between loops, advance to the next edge. Then add all edges that begin here.
    if n_active == 0 and n_begun < len(order):
        x_left = begins[n_begun]
    while n_begun < len(order) and begins[n_begun] <= x_left:
        i = order[n_begun]
        end = max(edges[0, i], edges[4, i])
        if end > x_left:  # vertical edges do not bound trapezoids from above or below
            active[n_active], x_right = i, min(x_right, end)
            n_active += 1
        n_begun += 1
    return n_active, n_begun, x_left, min(x_right, begins[n_begun]) if n_begun < len(order) else x_right


@helper
def _sort_upwards(edges, active, y_left, y_right, count, x_left, x_right):
    """Sort the edges that cross a vertical slab by height.

    The heights are written to ``y_left`` and ``y_right``. Edges do not cross within a slab, so
    the height at its middle decides. Insertion sort, as the order changes little from slab to slab.
    """
    for k in range(count):
        i, place = active[k], k
        slope = edges[3, i] / edges[2, i]
        a, b = edges[1, i] + (x_left - edges[0, i]) * slope, edges[1, i] + (x_right - edges[0, i]) * slope
        while place > 0 and y_left[place - 1] + y_right[place - 1] > a + b:
            active[place], y_left[place], y_right[place] = (
                active[place - 1],
                y_left[place - 1],
                y_right[place - 1],
            )
            place -= 1
        active[place], y_left[place], y_right[place] = i, a, b


@helper(allocates=True)
def slabs(edges, m, best, accuracy, heap, box):
    """Cut the interior into trapezoids, and push a box around each that may contain a larger circle.

    Vertical lines through all vertices cut the inside into trapezoids. The best circle so far is the circle
    of radius ``best`` about the origin, or a circle about the middle of the longest vertical side visited so
    far. A circle counts as larger if its radius is larger by a factor of ``1 + accuracy``. Returns the centre
    and the radius of the best circle, the heap and its size, and whether the heap contains all trapezoids,
    which fails if there are too many.
    """
    # 1. Sort the edges by their left ends.
    order, begins = np.empty(m, np.int64), np.empty(m)
    for i in range(m):
        order[i], begins[i] = i, min(edges[0, i], edges[4, i])
    sort_by_keys(order, begins, np.int64(m))
    active, y_left, y_right = np.empty(m, np.int64), np.empty(m), np.empty(m)
    best_x, best_y, longest, size = 0.0, 0.0, 0.0, np.int64(0)
    count, n_begun, work, x_left = 0, 0, 0, begins[0]
    while work <= _CROWD * m:
        # 2. Next slab, between two consecutive vertices, and the edges that cross it, sorted upward.
        count, n_begun, x_left, x_right = _next_slab(edges, order, begins, active, count, n_begun, x_left)
        if count == 0:
            break
        work += count
        _sort_upwards(edges, active, y_left, y_right, count, x_left, x_right)
        # 3. The inside lies above every second edge (even-odd rule): a trapezoid with heights from a to b at
        #    its left side, and from c to d at its right. The middle of the longest side is a candidate.
        for k in range(0, count - 1, 2):
            a, b, c, d = y_left[k], y_left[k + 1], y_right[k], y_right[k + 1]
            length = max(b - a, d - c)
            if length > longest:
                longest = length
                x, y = (x_left, 0.5 * (a + b)) if b - a >= d - c else (x_right, 0.5 * (c + d))
                radius = signed_distance(edges, m, x, y)
                if radius > best:
                    best, best_x, best_y = radius, x, y
            # 4. No circle about a point in the trapezoid is higher than its longer side. The list contains
            #    all edges.
            if 0.5 * length > best * (1.0 + accuracy):
                low, high = min(a, c), max(b, d)
                box[0, 0], box[0, 1], box[0, 2] = 0.5 * length, 0.5 * (x_left + x_right), 0.5 * (low + high)
                box[0, 3], box[0, 4] = 0.5 * (x_right - x_left), 0.5 * (high - low)
                box[0, 5], box[0, 6], box[0, 7] = 0.0, 0.0, m
                box[0, 8] = 0.0 if x_right - x_left >= high - low else 1.0
                heap = push(heap, size, box)
                size += 1
        x_left = x_right
    return best_x, best_y, best, heap, size, count == 0


@helper
def _append(edges, m, ax, ay, bx, by):
    """Append the edge ab to the table, and return the new edge count."""
    edges[0, m], edges[1, m], edges[4, m], edges[5, m] = ax, ay, bx, by
    edges[2, m], edges[3, m] = bx - ax, by - ay
    edges[6, m] = 1.0 / (edges[2, m] ** 2 + edges[3, m] ** 2)
    return m + 1


@helper
def _walk(edges, seed, links, is_visited, tiny, rough, k):
    """Follow a chain of edges from ``seed``, and append straight edges that approximate it to ``rough``.

    The walk ends where the chain branches or closes. A straight edge grows while the line from its start
    ``a`` to the next vertex passes all vertices in between by less than ``tiny``: its slope relative to the
    first edge must lie between ``low`` and ``high``. ``links`` contains the exclusive or of the two edges at
    a vertex, hence the edge beyond, and the edge count. ``k`` is the number of edges written, and its new
    value is returned.
    """
    i, v = seed, np.int64(edges[LAST, seed])
    ax, ay, bx, by = edges[0, i], edges[1, i], edges[4, i], edges[5, i]
    cx, cy, length = ax, ay, -1.0  # no direction yet
    ex, ey, low, high = 0.0, 0.0, 0.0, 0.0
    while True:
        is_visited[i] = True
        # 1. The edge ab starts a straight edge: it determines the direction, and the slopes that pass b by
        #    less than ``tiny``.
        if length < 0.0:
            length = np.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
            ex, ey = (bx - ax) / length, (by - ay) / length
            low, high = -tiny / length, tiny / length
        # 2. Continue with the other edge at vertex v, unless the outline branches or closes there.
        i ^= links[v, 0]
        if links[v, 1] != 2 or is_visited[i]:
            return _append(rough, k, ax, ay, bx, by)
        forward = np.int64(edges[FIRST, i]) == v
        end = 4 if forward else 0
        v = np.int64(edges[LAST if forward else FIRST, i])
        cx, cy = edges[end, i], edges[end + 1, i]
        # 3. Its far end c, at t along and n across the first edge, is the new end b if it is farther along,
        #    and the slope n / t passes all previous vertices. Restrict the slopes to those that also pass c.
        t, n = ex * (cx - ax) + ey * (cy - ay), ex * (cy - ay) - ey * (cx - ax)
        if t > length and low * t <= n <= high * t:
            length, low, high = t, max(low, (n - tiny) / t), min(high, (n + tiny) / t)
        # 4. Otherwise the straight edge ends at b, and a new straight edge begins there.
        else:
            k = _append(rough, k, ax, ay, bx, by)
            ax, ay, length = bx, by, -1.0
        bx, by = cx, cy


@helper(allocates=True)
def simplify_outline(edges, m, links, tiny):
    """Approximate an outline by fewer edges within ``tiny``, and return their table and number.

    The outline has ``m`` edges. ``links (points, 2)`` is workspace: zeros, before and after.
    """
    for row in (FIRST, LAST):  # edge count at each vertex, and exclusive or of the edge columns
        for i in range(m):
            v = np.int64(edges[row, i])
            links[v, 0] ^= i
            links[v, 1] += 1
    # Loops without branching vertices begin at any edge. At branches, later seeds continue with the remaining
    # edges. A seed is followed only in the direction of its edge.
    is_visited, rough, k = np.zeros(m, np.bool_), np.empty((HEIGHT, 2 * m)), np.int64(0)
    for seed in range(m):
        if not is_visited[seed]:
            k = _walk(edges, seed, links, is_visited, tiny, rough, k)
    for row in (FIRST, LAST):
        for i in range(m):
            v = np.int64(edges[row, i])
            links[v, 0], links[v, 1] = 0, 0
    return rough, k
