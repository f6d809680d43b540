"""The edges of one agglomerate: distances to them, the even-odd rule, which of them matter in a box.

Edges ab are columns of a table, so that loops over them run in vector registers: ``ROWS`` rows ax, ay, ux,
uy, bx, by, 1/|u|² where u = b − a, one for the squares of distances, or other values, and three for a plane
in place of the distance. Until there are planes, the numbers of the vertices a and b stand there. The end b
stands beside u because the even-odd rule needs it without rounding. A list of edges is a range of columns.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper

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
