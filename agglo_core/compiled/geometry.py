"""Diameters of blocks of cells: largest distances between cell vertices, exact or bounded."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel

# Vertex count up to which all pairs are compared directly, because a search for fewer pairs would cost more
# (benchmarks/partition.py, row h* 2, 4, 8).
_FEW = 12
MANY = 64
"""Vertex count above which vertices are sorted to find the farthest pair. Below it all pairs are compared, in
quadratic time (benchmarks/pathologies.py, h of the hub)."""


@helper
def distinct_vertices(b, cells, vertex_offsets, vertices, points, stamp, unique, centre):
    """Write the distinct vertices of ``cells`` to ``unique`` and return their number.

    ``stamp`` marks visited vertices with b, a value not used before. The ``centre`` of their box is also
    written, unless there are few vertices.
    """
    # 1. Collect the vertices.
    m = 0
    for i in range(len(cells)):
        for h in range(np.uint64(vertex_offsets[cells[i]]), np.uint64(vertex_offsets[cells[i] + 1])):
            v = np.uint32(vertices[h])
            if stamp[v] != b:
                stamp[v], unique[m] = b, v
                m += 1
    # 2. Centre of the bounding box.
    for k in range(len(centre) if m > _FEW else 0):
        low, high = np.inf, -np.inf
        for i in range(m):
            x = points[unique[i], k]
            low, high = min(low, x), max(high, x)
        centre[k] = 0.5 * (low + high)
    return m


@helper
def _farthest(m, unique, x, points):
    """Return the largest squared distance from ``x`` to the vertices ``unique[:m]``, and the vertex there."""
    best, q = -1.0, unique[0]
    for i in range(m):
        s = 0.0
        for k in range(len(x)):
            s += (points[unique[i], k] - x[k]) ** 2
        if s > best:
            best, q = s, unique[i]
    return best, q


@helper
def sort_along_x(m, unique, points):
    """Sort the vertices ``unique[:m]`` by first coordinate, then by vertex number (Shell sort)."""
    # Insertion sort with decreasing gaps, each about 5/11 of the previous. The last gap is 1.
    gap = m // 2
    while gap > 0:
        for i in range(gap, m):
            v, j = unique[i], i
            x = points[v, 0]
            while j >= gap:
                u = unique[j - gap]
                place = points[u, 0]
                if place < x or (place == x and u <= v):
                    break
                unique[j] = u
                j -= gap
            unique[j] = v
        gap = gap // 2 if gap < 5 else (5 * gap - 1) // 11


@helper
def widest_of_many(m, unique, centre, points, reach, widest):
    """Return the largest squared distance between two of ``unique[:m]``, at least ``widest``.

    Let r be the largest distance from the centre c, with square ``reach``. For a pair p, q at distance w or
    more, q lies within √(4r² − w²) of the mirror image 2c − p (parallelogram law). On round shapes hardly any
    vertex does. The vertices are sorted along x, and q is searched among the vertices near the image in x.
    """
    sort_along_x(m, unique, points)
    last = m - 1
    for i in range(m):
        # 1. Coordinates along x of the image and of the ball around it, which shrinks as the bound increases.
        image = 2.0 * centre[0] - points[unique[i], 0]
        around = np.sqrt(max(4.0 * reach - widest, 0.0) + 1e-12 * reach)
        # 2. As images move left, so does the right end of the ball: vertices beyond it are never needed
        #    again.
        while last >= 0 and points[unique[last], 0] > image + around:
            last -= 1
        # 3. Earlier vertices in the order with x in the ball: each pair is visited once.
        j = min(last, i - 1)
        while j >= 0 and points[unique[j], 0] >= image - around:
            s = 0.0
            for k in range(len(centre)):
                s += (points[unique[i], k] - points[unique[j], k]) ** 2
            widest = max(widest, s)
            j -= 1
    return widest


@helper
def largest_distance(m, unique, centre, points):
    """Return the largest distance between two of ``unique[:m]``, which is reordered.

    A farthest pair must lie outside the ball with radius (lower bound) − (largest distance to the centre).
    Only these few vertices are compared.
    """
    n_outer, widest = m, 0.0
    if m > _FEW:
        # 1. Lower bound w: the vertex farthest from the centre, at distance r, then the vertex farthest from
        #    it, and so on while the distance increases.
        reach, p = _farthest(m, unique, centre, points)
        for _ in range(3):
            best, q = _farthest(m, unique, points[p], points)
            if best <= widest:
                break
            widest, p = best, q
        # 2. Vertices nearer to the centre than w − r have no vertex farther than w. Move the others to the
        #    front.
        inner = np.sqrt(widest) - np.sqrt(reach)
        inner = inner * inner * (1.0 - 1e-12) if inner > 0.0 else 0.0
        n_outer = 0
        for i in range(m):
            s = 0.0
            for k in range(len(centre)):
                s += (points[unique[i], k] - centre[k]) ** 2
            if s >= inner:
                unique[n_outer], unique[i] = unique[i], unique[n_outer]
                n_outer += 1
        # 3. Many vertices remain: sorted search. Few: all pairs.
        if n_outer > MANY:
            return np.sqrt(widest_of_many(n_outer, unique, centre, points, reach, widest))
    for i in range(1, n_outer):
        widest = max(widest, _farthest(i, unique, points[unique[i]], points)[0])
    return np.sqrt(widest)


@helper
def _cell_diameter(i, vertex_offsets, vertices, points):
    """Return the diameter of a cell with few vertices."""
    last, widest = points.shape[1] - 1, 0.0
    third = last - 1.0  # 0 in 2-D; a loop over the dimensions takes twice the time
    start, stop = np.uint64(vertex_offsets[i]), np.uint64(vertex_offsets[i + ONE])
    for h in range(start, stop):
        v = np.uint32(vertices[h])
        x, y, z = points[v, 0], points[v, 1], points[v, last]
        for g in range(start, h):
            u = np.uint32(vertices[g])
            a, b, c = points[u, 0] - x, points[u, 1] - y, third * (points[u, last] - z)
            widest = max(widest, a * a + b * b + c * c)
    return np.sqrt(widest)


@kernel
def block_diameters(block_offsets, cells, vertex_offsets, vertices, points):
    """Return the exact diameter of each block b: of the cells ``cells[offsets[b]:offsets[b + 1]]``."""
    result = np.zeros(len(block_offsets) - 1)
    stamp = np.full(len(points), -1, np.int64)
    unique, centre = np.empty(len(points), np.int64), np.empty(points.shape[1])
    for b in range(len(result)):
        block = cells[block_offsets[b] : block_offsets[b + 1]]
        # A single cell with few vertices: compare its own pairs, without a list.
        if len(block) == 1 and vertex_offsets[block[0] + 1] - vertex_offsets[block[0]] <= _FEW:
            result[b] = _cell_diameter(np.uint64(block[0]), vertex_offsets, vertices, points)
            continue
        m = distinct_vertices(b, block, vertex_offsets, vertices, points, stamp, unique, centre)
        result[b] = largest_distance(m, unique, centre, points)
    return result


@helper
def octagon(cells, vertex_offsets, vertices, points, enough, centre):
    """Return lower and upper bounds of the diameter in 2-D, from extents along axes and diagonals.

    One of the four directions is within 22.5 degrees of the farthest pair. Both bounds are infinite as soon
    as the lower bound exceeds ``enough``. Otherwise the ``centre`` of the box is written.
    """
    x0, y0, u0, v0 = np.inf, np.inf, np.inf, np.inf
    x1, y1, u1, v1 = -np.inf, -np.inf, -np.inf, -np.inf
    for k in range(len(cells)):
        i = np.uint64(cells[k])
        for h in range(np.uint64(vertex_offsets[i]), np.uint64(vertex_offsets[i + ONE])):
            v = np.uint32(vertices[h])
            x, y = points[v, 0], points[v, 1]
            x0, x1, y0, y1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y)
            u0, u1, v0, v1 = min(u0, x + y), max(u1, x + y), min(v0, x - y), max(v1, x - y)
        # Already too wide: skip the rest.
        if max(x1 - x0, y1 - y0) > enough:
            return np.inf, np.inf
    centre[0], centre[1] = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    # The coordinates x ± y are √2 times lengths along the diagonals.
    lower = max(max(x1 - x0, y1 - y0), np.sqrt(0.5) * max(u1 - u0, v1 - v0))
    return lower, lower / np.cos(np.pi / 8.0)


@helper
def box(cells, vertex_offsets, vertices, points, low, high):
    """Return lower and upper bounds of the diameter: longest side and diagonal of the bounding box."""
    lower, upper = 0.0, 0.0
    for k in range(len(low)):
        low[k], high[k] = np.inf, -np.inf
        for i in range(len(cells)):
            for h in range(vertex_offsets[cells[i]], vertex_offsets[cells[i] + 1]):
                low[k], high[k] = min(low[k], points[vertices[h], k]), max(high[k], points[vertices[h], k])
        lower = max(lower, high[k] - low[k])
        upper += (high[k] - low[k]) ** 2
    return lower, np.sqrt(upper)


@kernel
def compare_diameters(block_offsets, cells, vertex_offsets, vertices, points, limits):
    """Return block diameters, or bounds that compare in the same way to each of the ascending ``limits``.

    The value is exact near a limit, elsewhere a lower bound, or infinite above the last limit. This is many
    times faster than ``block_diameters``, as most blocks of a recursion are much larger than its targets.
    """
    result = np.zeros(len(block_offsets) - 1)
    stamp = np.full(len(points), -1, np.int64)
    unique, centre = np.empty(len(points), np.int64), np.empty(points.shape[1])
    low, high = np.empty(points.shape[1]), np.empty(points.shape[1])
    enough = limits[-1] * (1.0 + 1e-12)
    for b in range(len(result)):
        block = cells[block_offsets[b] : block_offsets[b + 1]]
        # 1. Lower and upper bounds.
        if points.shape[1] == 2:
            lower, upper = octagon(block, vertex_offsets, vertices, points, enough, centre)
        else:
            lower, upper = box(block, vertex_offsets, vertices, points, low, high)
        result[b] = lower
        # 2. Measure only if a limit lies between them, up to rounding.
        for k in range(len(limits)):
            if lower <= limits[k] * (1.0 + 1e-12) and upper >= limits[k] * (1.0 - 1e-12):
                m = distinct_vertices(b, block, vertex_offsets, vertices, points, stamp, unique, centre)
                result[b] = largest_distance(m, unique, centre, points)
                break
    return result
