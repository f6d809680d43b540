"""The largest circle inside a polygon with holes: distances to edges, searches in boxes, slabs and chains."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper
from agglo_core.compiled.sorting import sort_by_keys
from agglo_core.shapes.box_heap import push

ROWS = 7  # numbers that describe an edge; the next row takes squares of distances
DISTANCE, SLOPE, HEIGHT = 8, 9, 11  # rows of planes, value and gradient; all rows
FIRST, LAST = 8, 9  # rows of the vertices a and b, until planes are written there


@helper(allocates=True)
def gathered(points, start, stop, faces, face_vertices, x0, y0, edges):
    """The table of one agglomerate, in ``edges`` if there is room, and the number of its edges.

    The origin is (x0, y0), the first axis the longest one of the outline. Edges of no length are left out.
    """
    if edges.shape[1] < stop - start:
        edges = np.empty((HEIGHT, 2 * (stop - start)))
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
    """Centre and half sides of a box around the edges."""
    x_low, x_high, y_low, y_high = np.inf, -np.inf, np.inf, -np.inf
    for i in range(m):
        x, y = edges[0, i], edges[1, i]
        x_low, x_high = min(x_low, x, edges[4, i]), max(x_high, x, edges[4, i])
        y_low, y_high = min(y_low, y, edges[5, i]), max(y_high, y, edges[5, i])
    return 0.5 * (x_low + x_high), 0.5 * (y_low + y_high), 0.5 * (x_high - x_low), 0.5 * (y_high - y_low)


@helper
def offset(edges, i, x, y):
    """Vector to (x, y) from the nearest point of edge i."""
    wx, wy = x - edges[0, i], y - edges[1, i]
    t = min(max((wx * edges[2, i] + wy * edges[3, i]) * edges[6, i], 0.0), 1.0)
    return wx - t * edges[2, i], wy - t * edges[3, i]


@helper
def nearest_edge(edges, start, stop, x, y):
    """The edge nearest to (x, y); the squares of all distances are left in the last row."""
    squares = edges[ROWS]
    for j in range(stop - start):
        i = np.uint64(start + j)  # no negative index has to be thought of: four at a time
        dx, dy = offset(edges, i, x, y)
        squares[i] = dx * dx + dy * dy
    nearest = np.uint64(start)
    for j in range(stop - start):
        i = np.uint64(start + j)
        if squares[i] < squares[nearest]:
            nearest = i
    return np.int64(nearest)


@helper
def crosses(edges, start, stop, axis, place, to, other):
    """Whether the way from coordinate ``place`` to ``to`` along an axis crosses an odd number of edges.

    ``other`` is the coordinate along the other axis. From infinity this is the even-odd rule.
    """
    a, b, u = edges[axis], edges[5 - axis], edges[2 + axis]
    c, v = edges[1 - axis], edges[3 - axis]
    crossings = 0
    for j in range(stop - start):  # without branches
        i = np.uint64(start + j)
        reach = (other - c[i]) * u[i]
        up = v[i] > 0.0
        one = ((place - a[i]) * v[i] < reach) == up
        two = ((to - a[i]) * v[i] < reach) == up
        crossings += 1 if ((c[i] > other) != (b[i] > other)) & (one != two) else 0
    return crossings & 1 == 1


@helper
def signed_distance(edges, m, x, y):
    """Distance from (x, y) to the boundary, negative outside."""
    distance = np.sqrt(edges[ROWS, nearest_edge(edges, np.int64(0), m, x, y)])
    return distance if crosses(edges, np.int64(0), m, np.int64(0), np.inf, x, y) else -distance


@helper
def is_inside(edges, m, start, stop, axis, x0, y0, above, tiny, x, y):
    """Whether (x, y) is inside, which lies from (x0, y0), at signed distance ``above``, along an axis.

    ``start`` to ``stop`` are the edges near both; all ``m`` are asked where (x0, y0) is on the boundary.
    """
    place, to, other = (x0, x, y) if axis == 0 else (y0, y, x)
    if abs(to - place) < abs(above):
        return above > 0.0
    if abs(above) <= tiny:
        start, stop, axis, place, to, other = 0, m, 0, np.inf, x, y
    return (above > tiny) != crosses(edges, start, stop, axis, place, to, other)


@helper
def apart(edges, start, stop, x, y, sx, sy):
    """Whether no edge meets a box."""
    meeting = 0
    for j in range(stop - start):
        i = np.uint64(start + j)
        ux, uy = edges[2, i], edges[3, i]
        wx, wy = 0.5 * (edges[0, i] + edges[4, i]) - x, 0.5 * (edges[1, i] + edges[5, i]) - y
        near = (abs(wx) <= sx + 0.5 * abs(ux)) & (abs(wy) <= sy + 0.5 * abs(uy))
        meeting += 1 if near & (abs(wx * uy - wy * ux) <= sx * abs(uy) + sy * abs(ux)) else 0
    return meeting == 0


@helper(allocates=True)
def shortened(edges, start, stop, limit, top):
    """Copy the edges whose square is at most ``limit`` to column ``top`` and on, if half of them are left.

    Returns the edges, longer if need be, and the first and last column of the list that holds.
    """
    count = 0
    for j in range(stop - start):
        count += 1 if edges[ROWS, np.uint64(start + j)] <= limit else 0
    if 2 * count > stop - start:
        return edges, start, stop
    if top + count > edges.shape[1]:
        grown = np.empty((HEIGHT, 2 * (top + count)))
        for k in range(ROWS + 1):
            for i in range(top):
                grown[k, i] = edges[k, i]
        edges = grown
    end = top
    for i in range(start, stop):
        if edges[ROWS, i] <= limit:
            for k in range(ROWS):
                edges[k, end] = edges[k, i]
            end += 1
    return edges, top, end


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


_CROWD = 24  # edges beside one another, on average, from which on trapezoids are dearer than boxes


@helper
def _next_slab(edges, order, begins, active, count, begun, left):
    """Let edges that end at ``left`` leave the active ones, those that begin there join.

    Returns how many are active and how many have begun, and where the slab lies: from ``left``, or where
    the next edge begins if none is active, to the next vertex.
    """
    kept, right = 0, np.inf
    for k in range(count):
        i = active[k]
        end = max(edges[0, i], edges[4, i])
        if end > left:
            active[kept], right = i, min(right, end)
            kept += 1
    if kept == 0 and begun < len(order):
        left = begins[begun]
    while begun < len(order) and begins[begun] <= left:
        i = order[begun]
        end = max(edges[0, i], edges[4, i])
        if end > left:  # a vertical edge bounds no trapezoid from above or below
            active[kept], right = i, min(right, end)
            kept += 1
        begun += 1
    return kept, begun, left, min(right, begins[begun]) if begun < len(order) else right


@helper
def _sort_upwards(edges, active, one, two, count, left, right):
    """Sort the active edges by height; theirs at ``left`` and ``right`` are left in ``one`` and ``two``."""
    for k in range(count):
        i, place = active[k], k
        slope = edges[3, i] / edges[2, i]
        a, b = edges[1, i] + (left - edges[0, i]) * slope, edges[1, i] + (right - edges[0, i]) * slope
        while place > 0 and one[place - 1] + two[place - 1] > a + b:
            active[place], one[place], two[place] = active[place - 1], one[place - 1], two[place - 1]
            place -= 1
        active[place], one[place], two[place] = i, a, b


@helper(allocates=True)
def slabs(edges, m, best, accuracy, heap, box):
    """Push the box around each trapezoid in which there may be a larger circle than the best so far.

    That is one of radius ``best`` about the origin, or about the middle of one of the longest vertical lines
    looked at; one is larger if it is so by a factor of ``1 + accuracy``. Returns the centre and the radius
    of the best, the heap and its size, and whether it holds all trapezoids: not if there were too many.
    """
    order, begins = np.empty(m, np.int64), np.empty(m)
    for i in range(m):
        order[i], begins[i] = i, min(edges[0, i], edges[4, i])
    sort_by_keys(order, begins, np.int64(m))
    active, one, two = np.empty(m, np.int64), np.empty(m), np.empty(m)
    best_x, best_y, longest, size = 0.0, 0.0, 0.0, np.int64(0)
    count, begun, work, left = 0, 0, 0, begins[0]
    while work <= _CROWD * m:
        count, begun, left, right = _next_slab(edges, order, begins, active, count, begun, left)
        if count == 0:
            break
        work += count
        _sort_upwards(edges, active, one, two, count, left, right)
        for k in range(0, count - 1, 2):
            a, b, c, d = one[k], one[k + 1], two[k], two[k + 1]
            length = max(b - a, d - c)
            if length > longest:
                longest = length
                x, y = (left, 0.5 * (a + b)) if b - a >= d - c else (right, 0.5 * (c + d))
                radius = signed_distance(edges, m, x, y)
                if radius > best:
                    best, best_x, best_y = radius, x, y
            if 0.5 * length > best * (1.0 + accuracy):
                low, high = min(a, c), max(b, d)
                box[0, 0], box[0, 1], box[0, 2] = 0.5 * length, 0.5 * (left + right), 0.5 * (low + high)
                box[0, 3], box[0, 4] = 0.5 * (right - left), 0.5 * (high - low)
                box[0, 5], box[0, 6], box[0, 7] = 0.0, 0.0, m
                box[0, 8] = 0.0 if right - left >= high - low else 1.0
                heap = push(heap, size, box)
                size += 1
        left = right
    return best_x, best_y, best, heap, size, count == 0


@helper
def _append(edges, m, ax, ay, bx, by):
    """Add the edge ab to the table; returns how many edges it has now."""
    edges[0, m], edges[1, m], edges[4, m], edges[5, m] = ax, ay, bx, by
    edges[2, m], edges[3, m] = bx - ax, by - ay
    edges[6, m] = 1.0 / (edges[2, m] ** 2 + edges[3, m] ** 2)
    return m + 1


@helper
def _walk(edges, seed, links, done, tiny, rough, k):
    """Add straight edges for the chain that begins with ``seed`` to ``rough``, until it branches or closes.

    A straight edge goes on as long as there is one from its start ``a`` to the next vertex that passes all
    between by less than ``tiny``: its slope against the first edge has to be from ``low`` to ``high``.
    """
    i, v = seed, np.int64(edges[LAST, seed])
    ax, ay, bx, by = edges[0, i], edges[1, i], edges[4, i], edges[5, i]
    cx, cy, along = ax, ay, -1.0  # nothing yet
    ex, ey, low, high = 0.0, 0.0, 0.0, 0.0
    while True:
        done[i] = True
        if along < 0.0:  # the edge ab is the first of a straight one
            along = np.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
            ex, ey = (bx - ax) / along, (by - ay) / along
            low, high = -tiny / along, tiny / along
        i ^= links[v, 0]
        if links[v, 1] != 2 or done[i]:
            return _append(rough, k, ax, ay, bx, by)
        forward = np.int64(edges[FIRST, i]) == v
        end = 4 if forward else 0
        v = np.int64(edges[LAST if forward else FIRST, i])
        cx, cy = edges[end, i], edges[end + 1, i]
        t, n = ex * (cx - ax) + ey * (cy - ay), ex * (cy - ay) - ey * (cx - ax)
        if t > along and low * t <= n <= high * t:
            along, low, high = t, max(low, (n - tiny) / t), min(high, (n + tiny) / t)
        else:
            k = _append(rough, k, ax, ay, bx, by)
            ax, ay, along = bx, by, -1.0
        bx, by = cx, cy


@helper(allocates=True)
def simplified(edges, m, links, tiny):
    """A table of fewer edges that pass the ``m`` of an outline by less than ``tiny``, and their number.

    ``links (points, 2)`` is a work array: zeros, before and after.
    """
    for row in (FIRST, LAST):  # how many edges meet at each vertex, and the exclusive or of their columns
        for i in range(m):
            v = np.int64(edges[row, i])
            links[v, 0] ^= i
            links[v, 1] += 1
    done, rough, k = np.zeros(m, np.bool_), np.empty((HEIGHT, 2 * m)), np.int64(0)
    for seed in range(m):
        if not done[seed]:
            k = _walk(edges, seed, links, done, tiny, rough, k)
    for row in (FIRST, LAST):
        for i in range(m):
            v = np.int64(edges[row, i])
            links[v, 0], links[v, 1] = 0, 0
    return rough, k
