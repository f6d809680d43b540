"""Largest circles inside agglomerates: even-odd rule over their edges, best-first branch and bound.

Holes, several loops and pinch vertices need no special case. Works in coordinates relative to the
agglomerate's centroid.
"""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import helper, kernel

__all__ = ["circles"]

_SQRT2 = float(np.sqrt(2.0))
_NEAREST = 12  # contacts looked at when polishing
_BUDGET = 5000  # squares per agglomerate; only needles thinner than 1/200 come near it


@helper
def _gather(points, start, stop, faces, face_vertices, x0, y0, edges):
    """Copy the edges ab of one agglomerate, relative to (x0, y0): rows ax, ay, ux, uy, 1/|u|², by; 1 free.

    The end ``by`` stands beside u = b − a because the even-odd rule needs it without rounding. Edges are
    columns, so that loops over them run in vector registers.
    """
    if edges.shape[1] < stop - start:
        edges = np.empty((7, 2 * (stop - start)))
    m = 0
    for h in range(start, stop):
        p, q = face_vertices[faces[h], 0], face_vertices[faces[h], 1]
        ax, ay = points[p, 0] - x0, points[p, 1] - y0
        bx, by = points[q, 0] - x0, points[q, 1] - y0
        square = (bx - ax) ** 2 + (by - ay) ** 2
        if square > 0.0:
            edges[0, m], edges[1, m], edges[2, m], edges[3, m] = ax, ay, bx - ax, by - ay
            edges[4, m], edges[5, m] = 1.0 / square, by
            m += 1
    return edges, m


@helper
def _offset(edges, i, x, y):
    """Vector to (x, y) from the nearest point of edge i."""
    wx, wy = x - edges[0, i], y - edges[1, i]
    t = min(max((wx * edges[2, i] + wy * edges[3, i]) * edges[4, i], 0.0), 1.0)
    return wx - t * edges[2, i], wy - t * edges[3, i]


@helper
def _distance(edges, m, x, y):
    """Distance from (x, y) to the boundary, negative outside, and the nearest boundary point."""
    ay, ux, uy, by, squares = edges[1], edges[2], edges[3], edges[5], edges[6]
    crossings = 0
    for i in range(m):  # without branches
        wx, wy = x - edges[0, i], y - ay[i]
        crosses = ((ay[i] > y) != (by[i] > y)) & ((wx * uy[i] < wy * ux[i]) == (uy[i] > 0.0))
        crossings += 1 if crosses else 0
        dx, dy = _offset(edges, i, x, y)
        squares[i] = dx * dx + dy * dy
    nearest = 0
    for i in range(m):
        if squares[i] < squares[nearest]:
            nearest = i
    dx, dy = _offset(edges, nearest, x, y)
    best = np.sqrt(squares[nearest])
    return (best if crossings & 1 else -best), x - dx, y - dy


@helper
def _polished(edges, m, x, y, radius, trio, weight):
    """Centre and radius after a few Newton steps towards the circle that touches three edges.

    With distances linearised at (x, y) the best step is a linear program; by duality its value is the
    least Σ λ_i d_i over contacts whose gradients satisfy Σ λ_i g_i = 0, λ >= 0, Σ λ = 1. The last three
    contacts and their λ are left in ``trio`` and ``weight``.
    """
    d, gx, gy = np.empty(_NEAREST + 1), np.empty(_NEAREST + 1), np.empty(_NEAREST + 1)
    edge = np.empty(_NEAREST + 1, np.int64)
    for _ in range(3):
        n = 0
        for i in range(m):  # the nearest contacts, by insertion
            dx, dy = _offset(edges, i, x, y)
            length = np.sqrt(dx * dx + dy * dy)
            if length == 0.0:
                return x, y, radius
            j = n
            while j > 0 and d[j - 1] > length:
                d[j], gx[j], gy[j], edge[j] = d[j - 1], gx[j - 1], gy[j - 1], edge[j - 1]
                j -= 1
            if j < _NEAREST:
                d[j], gx[j], gy[j], edge[j] = length, dx / length, dy / length, i
                n = min(n + 1, _NEAREST)
        least, sx, sy = np.inf, 0.0, 0.0
        for i in range(n):
            for j in range(i):
                third = gx[i] * gy[j] - gy[i] * gx[j]
                for k in range(j):
                    first = gx[j] * gy[k] - gy[j] * gx[k]
                    second = gx[k] * gy[i] - gy[k] * gx[i]
                    total = first + second + third
                    if total == 0.0 or min(first / total, second / total, third / total) < 1e-9:
                        continue
                    value = (first * d[i] + second * d[j] + third * d[k]) / total
                    if value < least:
                        least = value
                        trio[0], trio[1], trio[2] = edge[i], edge[j], edge[k]
                        weight[0], weight[1], weight[2] = first / total, second / total, third / total
                        sx = ((value - d[i]) * gy[j] - (value - d[j]) * gy[i]) / third
                        sy = ((value - d[j]) * gx[i] - (value - d[i]) * gx[j]) / third
        if least == np.inf:
            return x, y, radius
        better = _distance(edges, m, x + sx, y + sy)[0]
        if better <= radius:
            return x, y, radius
        x, y, radius = x + sx, y + sy, better
    return x, y, radius


@helper
def _ceiling(edges, trio, weight, x, y, s):
    """Largest weighted average of the distances to three edges over a square: no circle there is larger."""
    highest = 0.0
    for corner in range(4):  # the average is convex: largest at a corner
        cx, cy = x + (s if corner & 1 else -s), y + (s if corner & 2 else -s)
        average = 0.0
        for n in range(3):
            dx, dy = _offset(edges, trio[n], cx, cy)
            average += weight[n] * np.sqrt(dx * dx + dy * dy)
        highest = max(highest, average)
    return highest


@helper
def _move(source, i, target, j):
    """Copy a row number by number: slices take numba a second longer to compile."""
    for k in range(4):
        target[j, k] = source[i, k]


@helper
def _pop(heap, size):
    """Take the first square (x, y, half side) off the heap of ``size``; its largest bound is on top."""
    x, y, s = heap[0, 1], heap[0, 2], heap[0, 3]
    i, j = 0, 1
    while j < size - 1:  # the last entry takes the first place and sinks
        if j + 1 < size - 1 and heap[j + 1, 0] > heap[j, 0]:
            j += 1
        if heap[j, 0] <= heap[size - 1, 0]:
            break
        _move(heap, j, heap, i)
        i, j = j, 2 * j + 1
    _move(heap, size - 1, heap, i)
    return x, y, s


@helper
def _push(heap, size, bound, x, y, s):
    """Put a square on the heap of ``size``, in a longer copy if it is full."""
    if size == len(heap):
        grown = np.empty((2 * size, 4))
        for i in range(size):
            _move(heap, i, grown, i)
        heap = grown
    i = size
    while i > 0 and heap[(i - 1) // 2, 0] < bound:
        _move(heap, (i - 1) // 2, heap, i)
        i = (i - 1) // 2
    heap[i, 0], heap[i, 1], heap[i, 2], heap[i, 3] = bound, x, y, s
    return heap


@helper
def _bounding_square(edges, m):
    """Centre and half side of a square around the edges."""
    x_low, x_high, y_low, y_high = np.inf, -np.inf, np.inf, -np.inf
    for i in range(m):
        x, y = edges[0, i], edges[1, i]
        x_low, x_high = min(x_low, x, x + edges[2, i]), max(x_high, x, x + edges[2, i])
        y_low, y_high = min(y_low, y, y + edges[3, i]), max(y_high, y, y + edges[3, i])
    return 0.5 * (x_low + x_high), 0.5 * (y_low + y_high), 0.5 * max(x_high - x_low, y_high - y_low)


@helper
def _largest(edges, m, diameter, best, heap):
    """Radius of the largest circle, at least ``best`` (that about the origin); and the heap to reuse."""
    best_x, best_y = 0.0, 0.0
    trio, weight = np.zeros(3, np.int64), np.zeros(3)
    x0, y0, s = _bounding_square(edges, m)
    parts, size, opened, polish, polished = 1, 0, 0, 4, 0.0
    while opened < _BUDGET:
        slack = min(1e-4 * diameter, max(1e-3 * best, 1e-5 * diameter))
        for part in range(parts):
            x, y = x0, y0
            if parts == 4:
                x += s if part & 1 else -s
                y += s if part & 2 else -s
            d, qx, qy = _distance(edges, m, x, y)
            if d > best:
                best, best_x, best_y = d, x, y
            bound = d + s * _SQRT2
            if weight[0] > 0.0 and bound > best + slack:
                bound = min(bound, _ceiling(edges, trio, weight, x, y, s))
            if d > 0.0 and bound > best + slack:
                _, px, py = _distance(edges, m, 2.0 * x - qx, 2.0 * y - qy)
                mx, my = 0.5 * (qx + px), 0.5 * (qy + py)
                square = 0.25 * ((qx - px) ** 2 + (qy - py) ** 2)
                reach = np.sqrt((x - mx) ** 2 + (y - my) ** 2) + s * _SQRT2
                bound = min(bound, np.sqrt(reach * reach + square))
                if square > best * best:
                    d, _, _ = _distance(edges, m, mx, my)
                    if d > best:
                        best, best_x, best_y = d, mx, my
            if bound > best + slack:
                heap = _push(heap, size, bound, x, y, s)
                size += 1
        if size == 0 or heap[0, 0] <= best + slack:
            break
        x0, y0, s = _pop(heap, size)
        s *= 0.5
        size -= 1
        parts = 4
        opened += 1
        if opened == polish:
            polish *= 2
            if best > polished:
                best_x, best_y, best = _polished(edges, m, best_x, best_y, best, trio, weight)
                polished = best
    if best > polished:
        best = _polished(edges, m, best_x, best_y, best, trio, weight)[2]
    return best, heap


@kernel
def circles(points, offsets, faces, face_vertices, centroids, diameters, anywhere):
    """Radius of the largest circle inside each agglomerate: anywhere, or about the centroid (else 0).

    Anywhere: squares are quartered, best bound first, until no bound exceeds the best radius by 1e-4
    diameters (or by 1e-3 of the radius if that is less, down to 1e-5 diameters); a few Newton steps
    then make the radius exact where three edges touch the circle. Let c be the centre of a square, s
    its half side, q1 the boundary point nearest to c, at distance d. In that square no radius exceeds
    d + s√2; nor, with m the middle of q1 and any other boundary point q2, √(r² + |q1 − q2|²/4) where
    r = |c − m| + s√2. Taking q2 nearest to the mirror image of q1 in c, the second bound decides long
    strips, where the first would open every square along the axis.

    A third bound comes from three edges and weights λ (λ >= 0, Σ λ = 1): no radius in the square exceeds
    the largest Σ λ_i d_i there. With those of a polished circle it is exact at the circle's centre and
    O(s²) above nearby, so that squares around the largest circle are discarded early.
    """
    radius = np.zeros(len(offsets) - 1)
    edges = np.empty((7, 64))
    heap = np.empty((256, 4))  # bound, x, y, half side
    for c in range(len(radius)):
        x0, y0 = centroids[c, 0], centroids[c, 1]
        edges, m = _gather(points, offsets[c], offsets[c + 1], faces, face_vertices, x0, y0, edges)
        radius[c] = max(_distance(edges, m, 0.0, 0.0)[0], 0.0)
        if anywhere:
            radius[c], heap = _largest(edges, m, diameters[c], radius[c], heap)
    return radius
