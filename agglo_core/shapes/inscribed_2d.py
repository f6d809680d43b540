"""The largest circle inside a polygon with holes: distances to edges, searches in boxes, slabs and chains."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper
from agglo_core.compiled.sorting import sort_by_keys
from agglo_core.shapes.box_heap import push

# Table of edges, a column for each edge ab: rows 0 and 1 are a, 2 and 3 are b - a, 4 and 5 are b, 6 is 1 / |b
# - a|². An axis k = 0, 1 reads a[k] in row k, (b - a)[k] in row 2 + k and b[k] in row 4 + k.
ROWS = 7  # numbers that describe an edge; the next row takes squares of distances
DISTANCE, SLOPE, HEIGHT = 8, 9, 11  # rows of planes, value and gradient (two rows); number of all rows
FIRST, LAST = 8, 9  # rows of the vertices a and b, until planes are written there


@helper(allocates=True)
def gathered(points, start, stop, faces, face_vertices, x0, y0, edges):
    """The table of one agglomerate, in ``edges`` if there is room, and the number of its edges.

    The origin is (x0, y0), the first axis that of the largest moment of the outline. Edges of no length are
    left out.
    """
    if edges.shape[1] < stop - start:
        edges = np.empty((HEIGHT, 2 * (stop - start)))
    # 1. Ends of the edges relative to the origin, and second moments of the outline as a wire of constant
    #    density.
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
    # 2. Rotate by the angle at which the mixed moment is 0, to the principal axes.
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
    # The foot of the perpendicular is a + t (b - a); beyond an end, that end is nearest.
    wx, wy = x - edges[0, i], y - edges[1, i]
    t = min(max((wx * edges[2, i] + wy * edges[3, i]) * edges[6, i], 0.0), 1.0)
    return wx - t * edges[2, i], wy - t * edges[3, i]


@helper
def nearest_edge(edges, start, stop, x, y):
    """The edge nearest to (x, y).

    The squares of all distances are left in row ``ROWS``.
    """
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
    """Return True if the way from ``place`` to ``to`` along an axis crosses an odd number of edges.

    Both are coordinates along the axis, ``other`` is the one along the other axis. From infinity this is the
    even-odd rule.
    """
    a, b, u = edges[axis], edges[5 - axis], edges[2 + axis]
    c, v = edges[1 - axis], edges[3 - axis]
    crossings = 0
    for j in range(stop - start):  # without branches
        i = np.uint64(start + j)
        # The line at ``other`` meets the edge at a + (other - c) u / v if the ends are on different sides of
        # it (half-open, so that a vertex counts once). Is each end of the way before that? The edge is
        # crossed if the answers differ. Multiplied by v, so that edges along the axis divide by nothing.
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
    """Return True if (x, y) is inside, a point that lies along an axis from (x0, y0).

    The latter is at signed distance ``above``; ``start`` to ``stop`` are the edges near both points. All
    ``m`` edges are needed where (x0, y0) is within ``tiny`` of the boundary.
    """
    place, to, other = (x0, x, y) if axis == 0 else (y0, y, x)
    # A way shorter than the distance from the boundary crosses nothing. From a point on the boundary, whose
    # side is rounding, start at infinity instead, which is outside.
    if abs(to - place) < abs(above):
        return above > 0.0
    if abs(above) <= tiny:
        start, stop, axis, place, to, other = 0, m, 0, np.inf, x, y
    return (above > tiny) != crosses(edges, start, stop, axis, place, to, other)


@helper
def apart(edges, start, stop, x, y, sx, sy):
    """Return True if no edge meets a box with centre (x, y) and half sides sx, sy."""
    meeting = 0
    for j in range(stop - start):
        # A box and an edge are disjoint if they are along x, along y or along the normal of the edge.
        i = np.uint64(start + j)
        ux, uy = edges[2, i], edges[3, i]
        wx, wy = 0.5 * (edges[0, i] + edges[4, i]) - x, 0.5 * (edges[1, i] + edges[5, i]) - y
        near = (abs(wx) <= sx + 0.5 * abs(ux)) & (abs(wy) <= sy + 0.5 * abs(uy))
        meeting += 1 if near & (abs(wx * uy - wy * ux) <= sx * abs(uy) + sy * abs(ux)) else 0
    return meeting == 0


@helper(allocates=True)
def shortened(edges, start, stop, limit, top):
    """Copy edges at a squared distance of at most ``limit`` to columns from ``top`` on, if at most half are.

    Squares are those that :func:`nearest_edge` has left. Returns the table, longer if it was full, and the
    range of columns of the list: the copies, or all edges as before if more than half are that near.
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


_STEPS = 40  # exchanges of a linear program; more than ten are rare


@helper
def linearised(edges, start, stop, x, y):
    """Leave distances from (x, y) and their gradients, unit vectors, in the table of edges."""
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
    """Leave planes in the table that are nowhere in the box below the distances, which are convex.

    The value of a plane at the centre (x, y) of the box of half sides sx, sy, and its gradient.
    """
    for j in range(stop - start):
        i = np.uint64(start + j)
        # A convex function lies below the bilinear one with its values at the corners. That is a plane and a
        # term in x y, which is largest in modulus at the corners.
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
    """Return True if both ends of all edges are, within ``tiny``, on the origin's side of each edge's line.

    If so, distances of the origin from these lines and their gradients are left in the table.
    """
    for i in range(m):
        # Unit normal towards the origin, and the distance of the origin.
        scale = np.sqrt(edges[6, i])
        nx, ny = -edges[3, i] * scale, edges[2, i] * scale
        distance = -(nx * edges[0, i] + ny * edges[1, i])
        if distance < 0.0:
            distance, nx, ny = -distance, -nx, -ny
        # The lowest end a in that direction must not be beyond the line.
        # Edges point either way along the outline, so that a vertex may be the second end of both its edges.
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
    """The edge whose plane is lowest at p.

    The values of all planes are left in row ``ROWS``.
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
    """Maximise the lowest of the edges' planes over a box, by the dual simplex method.

    The linear program in (p, r): maximise r with r - g_i · p ≤ d_i for each plane (d_i its value at the
    centre of the box, g_i its gradient), |p_x| ≤ sx and |p_y| ≤ sy. Returns p, relative to the centre, and r;
    writes up to three edges and their multipliers λ, whose sum is 1, to ``some`` and ``weight``.

    Begins with the ``nearest`` edge and a corner of the box; edges and sides of the box that are violated
    by more than ``tiny`` enter one by one. The radius falls from above, and is enough once it is at most
    ``enough``. ``m (3, 3)`` is scratch: the inverse of the three constraints that hold with equality.
    """
    # 1. The plane of one edge is highest at the corner towards its gradient: both sides of the box there and
    #    the edge hold with equality. Column k of the inverse is the change of (p, r) as the right-hand side
    #    of constraint k grows; its last entry is the multiplier λ_k ≥ 0.
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
        # 2. The constraint violated most, an edge or a side of the box, enters: row (ax, ay, ar).
        entering = tightest(edges, start, stop, px, py)
        ax, ay, ar = -edges[SLOPE, entering], -edges[SLOPE + 1, entering], 1.0
        excess = radius - edges[ROWS, entering]
        if abs(px) - sx > excess:
            entering, ax, ay, ar, excess = -1, 1.0 if px > 0.0 else -1.0, 0.0, 0.0, abs(px) - sx
        if abs(py) - sy > excess:
            entering, ax, ay, ar, excess = -1, 0.0, 1.0 if py > 0.0 else -1.0, 0.0, abs(py) - sy
        if excess <= tiny:
            break
        # 3. Ratio test: the one leaves for which all λ stay ≥ 0. Shares of the new row in the old ones below
        #    1e-12 count as rounding.
        leaving, ratio, pivot = -1, np.inf, 1.0
        for k in range(3):
            share = ax * m[0, k] + ay * m[1, k] + ar * m[2, k]
            if share > 1e-12 and m[2, k] < ratio * share:
                leaving, ratio, pivot = k, m[2, k] / share, share
        if leaving < 0:
            break
        # 4. Update the inverse, and move along the column of the new constraint until it holds with equality.
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
    # 5. Edges that hold with equality and their λ; sides of the box have the weight 0.
    for k in range(3):
        weight[k] = max(m[2, k], 0.0) if some[k] >= 0 else 0.0
        some[k] = max(some[k], 0)
    return px, py, radius


_CROWD = 24  # edges beside one another, on average, from which on trapezoids are dearer than boxes


@helper
def _next_slab(edges, order, begins, active, count, begun, left):
    """Move the sweep line to ``left``: edges that end there leave the active ones, those that begin join.

    ``active[:count]`` are the edges that the line crosses, ``order`` all edges by their left ends
    ``begins``, of which ``begun`` have been met. Returns how many are active and how many have begun, and
    the ends of the slab: from ``left``, or where the next edge begins if none is active, to the next vertex.
    """
    # 1. Edges that go on beyond the line.
    kept, right = 0, np.inf
    for k in range(count):
        i = active[k]
        end = max(edges[0, i], edges[4, i])
        if end > left:
            active[kept], right = i, min(right, end)
            kept += 1
    # 2. A gap between loops: go to the next edge. Then take all that begin here.
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
    """Sort the active edges by height, and write their heights at ``left`` and ``right``.

    These are left in ``one`` and ``two``. Edges do not cross within a slab, so the middle of it decides. By
    insertion: the order changes little from slab to slab.
    """
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

    Vertical lines through all vertices cut the inside into trapezoids. The best circle so far is that of
    radius ``best`` about the origin, or one about the middle of the longest vertical side met so far; a
    circle counts as larger if it is so by a factor of ``1 + accuracy``. Returns the centre and the radius
    of the best, the heap and its size, and whether it holds all trapezoids: not if there were too many.
    """
    # 1. Edges by their left ends.
    order, begins = np.empty(m, np.int64), np.empty(m)
    for i in range(m):
        order[i], begins[i] = i, min(edges[0, i], edges[4, i])
    sort_by_keys(order, begins, np.int64(m))
    active, one, two = np.empty(m, np.int64), np.empty(m), np.empty(m)
    best_x, best_y, longest, size = 0.0, 0.0, 0.0, np.int64(0)
    count, begun, work, left = 0, 0, 0, begins[0]
    while work <= _CROWD * m:
        # 2. The next slab, between two neighbouring vertices, and the edges that cross it, upwards.
        count, begun, left, right = _next_slab(edges, order, begins, active, count, begun, left)
        if count == 0:
            break
        work += count
        _sort_upwards(edges, active, one, two, count, left, right)
        # 3. The inside lies above every second edge, by the even-odd rule: a trapezoid of heights from a to b
        #    at its left side, from c to d at its right. The middle of the longest side is a candidate.
        for k in range(0, count - 1, 2):
            a, b, c, d = one[k], one[k + 1], two[k], two[k + 1]
            length = max(b - a, d - c)
            if length > longest:
                longest = length
                x, y = (left, 0.5 * (a + b)) if b - a >= d - c else (right, 0.5 * (c + d))
                radius = signed_distance(edges, m, x, y)
                if radius > best:
                    best, best_x, best_y = radius, x, y
            # 4. No circle about a point of the trapezoid is higher than its longer side. List: all edges.
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
    """Add the edge ab to the table and return how many edges it has now."""
    edges[0, m], edges[1, m], edges[4, m], edges[5, m] = ax, ay, bx, by
    edges[2, m], edges[3, m] = bx - ax, by - ay
    edges[6, m] = 1.0 / (edges[2, m] ** 2 + edges[3, m] ** 2)
    return m + 1


@helper
def _walk(edges, seed, links, done, tiny, rough, k):
    """Add straight edges for the chain that begins with ``seed`` to ``rough``, until it branches or closes.

    A straight edge goes on as long as there is one from its start ``a`` to the next vertex that passes all
    between by less than ``tiny``: its slope against the first edge has to be from ``low`` to ``high``.
    ``links`` holds the exclusive or of the two edges at a vertex, hence the one beyond, and how many there
    are; ``k`` counts the edges written, and its new value is returned.
    """
    i, v = seed, np.int64(edges[LAST, seed])
    ax, ay, bx, by = edges[0, i], edges[1, i], edges[4, i], edges[5, i]
    cx, cy, along = ax, ay, -1.0  # nothing yet
    ex, ey, low, high = 0.0, 0.0, 0.0, 0.0
    while True:
        done[i] = True
        # 1. The edge ab is the first of a straight one: it gives the direction, and the slopes that pass b by
        #    less than ``tiny``.
        if along < 0.0:
            along = np.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
            ex, ey = (bx - ax) / along, (by - ay) / along
            low, high = -tiny / along, tiny / along
        # 2. Go on to the other edge at the vertex v, unless the outline branches there or is closed.
        i ^= links[v, 0]
        if links[v, 1] != 2 or done[i]:
            return _append(rough, k, ax, ay, bx, by)
        forward = np.int64(edges[FIRST, i]) == v
        end = 4 if forward else 0
        v = np.int64(edges[LAST if forward else FIRST, i])
        cx, cy = edges[end, i], edges[end + 1, i]
        # 3. Its far end c, at t along and n across the first edge, is the new end b if it lies further on and
        #    the slope n / t passes all vertices before. Narrow the slopes to those that pass c, too.
        t, n = ex * (cx - ax) + ey * (cy - ay), ex * (cy - ay) - ey * (cx - ax)
        if t > along and low * t <= n <= high * t:
            along, low, high = t, max(low, (n - tiny) / t), min(high, (n + tiny) / t)
        # 4. Otherwise the straight edge ends at b, and a new one begins there.
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
    # Loops without a vertex of more than two edges begin at any edge; where chains branch, later seeds take
    # up what is left. A seed is followed in the direction of its edge alone.
    done, rough, k = np.zeros(m, np.bool_), np.empty((HEIGHT, 2 * m)), np.int64(0)
    for seed in range(m):
        if not done[seed]:
            k = _walk(edges, seed, links, done, tiny, rough, k)
    for row in (FIRST, LAST):
        for i in range(m):
            v = np.int64(edges[row, i])
            links[v, 0], links[v, 1] = 0, 0
    return rough, k
