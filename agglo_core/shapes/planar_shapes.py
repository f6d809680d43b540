"""Convex hulls, narrowest enclosing rectangles, and star-shapedness kernels of 2-D agglomerates."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel

_TIE = 1e-9  # relative to a width: two widths this close count as equal, well above rounding
_SHORT = 1e-8  # relative to the extent: shorter edges are rounding


@helper
def _turn(points, a, b, c):
    """Return twice the signed area of the triangle abc, positive for a left turn at b."""
    ux, uy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    return ux * (points[c, 1] - points[a, 1]) - uy * (points[c, 0] - points[a, 0])


@helper
def _sort(points, vertices, start, stop):
    """Sort ``vertices[start:stop]`` by x, then y (Shell sort: short to compile, fast for short lists)."""
    # 1. Largest gap of the sequence 1, 4, 13, ….
    gap = 1
    while 3 * gap < stop - start:
        gap = 3 * gap + 1
    # 2. Insertion sort with decreasing gaps.
    while gap > 0:
        for i in range(start + gap, stop):
            v, j = vertices[i], i
            x, y = points[v, 0], points[v, 1]
            while j - gap >= start:
                w = vertices[j - gap]
                if points[w, 0] < x or (points[w, 0] == x and points[w, 1] <= y):
                    break
                vertices[j] = w
                j -= gap
            vertices[j] = v
        gap //= 3


@helper
def one_hull(points, order, start, stop, hull, top):
    """Append the convex hull of ``order[start:stop]`` to ``hull[:top]``, and return its end offset.

    Sorts the list in place. Andrew's monotone chain: counter-clockwise, without collinear vertices.
    """
    _sort(points, order, start, stop)
    base, last = top, stop - 1
    floor = base + 1  # entries below are final
    # Traverse the lower chain forward, then the upper chain backward: a vertex is removed if the path does
    # not turn left at it. The lower chain is final when the upper chain begins.
    for step in range(2 * (last - start) + 1):
        if step == last - start + 1:
            floor = top
        v = order[start + step] if start + step <= last else order[2 * last - start - step]
        while top > floor and _turn(points, hull[top - 2], hull[top - 1], v) <= 0.0:
            top -= 1
        hull[top] = v
        top += 1
    return top - 1  # back at the first vertex


@kernel
def convex_hulls(points, offsets, vertices):
    """Return areas of the cells' convex hulls, and the hulls as CSR (offsets, vertices), counter-clockwise.

    Cell c has ``vertices[offsets[c]:offsets[c + 1]]``, in any order, possibly repeated.
    """
    n = len(offsets) - 1
    area = np.zeros(n)
    hull_offsets = np.zeros(n + 1, np.int64)
    hull = np.empty(len(vertices) + 1, np.int64)
    order = np.empty(len(vertices), np.int64)
    for h in range(len(vertices)):
        order[h] = vertices[h]
    top = 0
    for c in range(n):
        base = top
        top = one_hull(points, order, offsets[c], offsets[c + 1], hull, base)
        hull_offsets[c + 1] = top
        # Area of the triangle fan from the first vertex.
        for i in range(base + 1, top - 1):
            area[c] += 0.5 * _turn(points, hull[base], hull[i], hull[i + 1])
    return area, hull_offsets, hull[:top].copy()


@helper
def _furthest(points, hull, start, m, at, ux, uy):
    """Return the first hull index from ``at`` on whose next edge does not advance along (ux, uy).

    Indices continue beyond m, around the hull with m vertices from ``start`` on.
    """
    while True:
        p, q = hull[start + at % m], hull[start + (at + 1) % m]
        if ux * (points[q, 0] - points[p, 0]) + uy * (points[q, 1] - points[p, 1]) <= 0.0:
            return at
        at += 1


@helper
def narrowest(points, hull, start, m):
    """Return width and side ratio of the narrowest rectangle around a convex hull (rotating calipers).

    The hull is ``hull[start:start + m]``, counter-clockwise. Among equally narrow rectangles, up to rounding,
    the largest ratio of short to long side counts.
    """
    # 1. Extent along x or y, about the first vertex, as a scale for edges that are too short.
    right_end, top, left_end = 1, 1, 1
    width, best, reach = np.inf, 0.0, 0.0
    for i in range(m):
        reach = max(reach, abs(points[hull[start + i], 0] - points[hull[start], 0]))
        reach = max(reach, abs(points[hull[start + i], 1] - points[hull[start], 1]))
    # 2. One side of the rectangle lies on an edge ab. As the edge rotates, the farthest vertices along,
    #    across and against it only advance: O(m) time for all edges.
    for i in range(m):
        a, b = hull[start + i], hull[start + (i + 1) % m]
        ux, uy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
        if max(abs(ux), abs(uy)) <= _SHORT * reach:  # direction lost in rounding
            continue
        right_end = _furthest(points, hull, start, m, max(right_end, i + 1), ux, uy)
        top = _furthest(points, hull, start, m, max(top, right_end), -uy, ux)
        left_end = _furthest(points, hull, start, m, max(left_end, top), -ux, -uy)
        # 3. ``height`` is the width across ab times |ab|, like the extent along ab in the ratio below.
        p, q = hull[start + left_end % m], hull[start + right_end % m]
        height = _turn(points, a, b, hull[start + top % m])
        value = height / (ux * (points[q, 0] - points[p, 0]) + uy * (points[q, 1] - points[p, 1]))
        narrow = height / np.sqrt(ux * ux + uy * uy)
        if narrow < width * (1.0 - _TIE) or (narrow <= width * (1.0 + _TIE) and value > best):
            best = value
            width = min(width, narrow)
    return width, best


@kernel
def box_ratios(points, offsets, hull):
    """Return the ratio of short to long side of the narrowest rectangle around each hull.

    One side of the rectangle lies on a hull edge. Among equally narrow rectangles the shortest counts.
    """
    ratio = np.empty(len(offsets) - 1)
    for c in range(len(ratio)):
        ratio[c] = narrowest(points, hull, offsets[c], offsets[c + 1] - offsets[c])[1]
    return ratio


@helper
def _clip(source, m, target, ax, ay, ux, uy):
    """Copy the part of a convex polygon left of a line, and return its corner count.

    The polygon is ``source[:m]``, the line passes through a along u.
    """
    # ``last_height`` and ``height`` are heights over the line at p and the next vertex q, times |u|. A side
    # that crosses the line contributes the intersection, a vertex not below the line itself (Sutherland and
    # Hodgman).
    k = 0
    px, py = source[m - 1, 0], source[m - 1, 1]
    last_height = ux * (py - ay) - uy * (px - ax)
    for i in range(m):
        qx, qy = source[i, 0], source[i, 1]
        height = ux * (qy - ay) - uy * (qx - ax)
        if (last_height < 0.0) != (height < 0.0):
            t = last_height / (last_height - height)
            target[k, 0], target[k, 1] = px + t * (qx - px), py + t * (qy - py)
            k += 1
        if height >= 0.0:
            target[k, 0], target[k, 1] = qx, qy
            k += 1
        px, py, last_height = qx, qy, height
    return k


@kernel
def kernel_areas(points, cell_loops, loop_offsets, vertices, hull_offsets, hull):
    """Return the area of each cell's kernel: the points from which the whole cell is visible.

    The area is 0 for cells with several loops.

    Cell c has the loops from ``cell_loops[c]`` to ``cell_loops[c + 1]``, counter-clockwise, with vertices
    ``vertices[loop_offsets[loop]:loop_offsets[loop + 1]]``, and the convex hull
    ``hull[hull_offsets[c]:hull_offsets[c + 1]]``.

    The kernel lies left of every edge. Within the hull, only edges at reflex vertices can cut. If a point in
    the cell does not see the whole cell, a reflex vertex blocks the view, and the point lies right of one of
    its edges. A point in the hull outside the cell lies in a pocket. The pocket's vertex farthest from its
    lid is reflex, and the point lies right of one of its edges.
    """
    area = np.zeros(len(cell_loops) - 1)
    capacity = 8
    for loop in range(len(loop_offsets) - 1):
        capacity = max(capacity, 2 * (loop_offsets[loop + 1] - loop_offsets[loop]) + 2)
    polygon, clipped = np.empty((capacity, 2)), np.empty((capacity, 2))
    for c in range(len(area)):
        if cell_loops[c + 1] - cell_loops[c] != 1:
            continue
        # 1. Start with the hull, relative to a vertex.
        start, stop = loop_offsets[cell_loops[c]], loop_offsets[cell_loops[c] + 1]
        x0, y0 = points[vertices[start], 0], points[vertices[start], 1]
        m = hull_offsets[c + 1] - hull_offsets[c]
        for i in range(m):
            v = hull[hull_offsets[c] + i]
            polygon[i, 0], polygon[i, 1] = points[v, 0] - x0, points[v, 1] - y0
        # 2. Clip at each edge ab with a reflex vertex at either end. ``reflex`` refers to b, ``was`` to a.
        #    Fewer than three corners mean an empty kernel.
        a, b = vertices[stop - 2], vertices[stop - 1]
        reflex = _turn(points, a, b, vertices[start]) < 0.0
        for i in range(start, stop):
            a, b = b, vertices[i]
            was, reflex = reflex, _turn(points, a, b, vertices[i + 1 if i + 1 < stop else start]) < 0.0
            if was or reflex:
                ax, ay = points[a, 0], points[a, 1]
                m = _clip(polygon, m, clipped, ax - x0, ay - y0, points[b, 0] - ax, points[b, 1] - ay)
                polygon, clipped = clipped, polygon
                if m < 3:
                    break
        # 3. Area of the remaining polygon, by a fan.
        for i in range(1, m - 1):
            area[c] += 0.5 * _turn(polygon, 0, i, i + 1)
    return area
