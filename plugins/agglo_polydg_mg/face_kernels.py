"""Kernels of the faces: the largest triangles on them, and their blocks of the matrix.

Polynomials and boxes are those of :mod:`~agglo_polydg_mg.legendre_kernels`.
"""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_polydg_mg.legendre_kernels import CONSTANT, LANES, along_box, recurrences

__all__ = ["block_pattern", "face_blocks", "largest_triangles"]

_SHRUNK = 1e-8  # how far into a triangle, in barycentric coordinates, an edge must reach to count


@helper
def _reaches(sx, sy, tx, ty, ax, ay, bx, by, vx, vy):
    """Whether the segment st passes through the inside of the triangle abv."""
    twice = (bx - ax) * (vy - ay) - (by - ay) * (vx - ax)
    low, high = 0.0, 1.0
    px, py, ex, ey = ax, ay, bx - ax, by - ay
    for side in range(3):
        if side == 1:
            px, py, ex, ey = bx, by, vx - bx, vy - by
        elif side == 2:
            px, py, ex, ey = vx, vy, ax - vx, ay - vy
        at_s = (ex * (sy - py) - ey * (sx - px)) / twice - _SHRUNK
        at_t = (ex * (ty - py) - ey * (tx - px)) / twice - _SHRUNK
        if at_s <= 0.0 and at_t <= 0.0:
            return False
        if at_s <= 0.0:
            low = max(low, at_s / (at_s - at_t))
        elif at_t <= 0.0:
            high = min(high, at_s / (at_s - at_t))
    return low < high


@helper
def _is_convex(start, end, m):
    """Whether each of the m edges has every vertex on its left."""
    for k in range(m):
        ax, ay = start[k, 0], start[k, 1]
        ex, ey = end[k, 0] - ax, end[k, 1] - ay
        lowest, highest = 0.0, 0.0
        for v in range(m):
            height = ex * (start[v, 1] - ay) - ey * (start[v, 0] - ax)
            lowest, highest = min(lowest, height), max(highest, height)
        if lowest < -1e-10 * highest:
            return False
    return True


@helper
def _visible_height(start, end, m, k, convex, queue):
    """Height of the largest triangle on edge k whose apex is a vertex and which no edge enters.

    ``queue`` orders the edges: one that hides a vertex moves to the front, as it is likely to hide more.
    """
    ax, ay, bx, by = start[k, 0], start[k, 1], end[k, 0], end[k, 1]
    length = np.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
    best = 0.0
    for v in range(m):
        vx, vy = start[v, 0], start[v, 1]
        height = ((bx - ax) * (vy - ay) - (by - ay) * (vx - ax)) / length
        if height <= best * (1.0 + 1e-12) or height <= 1e-12 * length:
            continue
        hidden = False
        if not convex:
            for i in range(m):
                g = queue[i]
                if _reaches(start[g, 0], start[g, 1], end[g, 0], end[g, 1], ax, ay, bx, by, vx, vy):
                    for back in range(i, 0, -1):
                        queue[back] = queue[back - 1]
                    hidden, queue[0] = True, g
                    break
        if not hidden:
            best = height
    return best


@kernel
def largest_triangles(points, offsets, faces, face_vertices, face_cells, first_cell, heights):
    """Write the height over each face of the largest triangle in cells ``first_cell``, ...

    Its base is the face, its apex a vertex of the cell, and it lies in the cell. ``heights (F, 2)`` are for
    owner and neighbour; those of faces of no length are left as they are. 0 if no vertex is visible.
    """
    most = 0
    for c in range(len(offsets) - 1):
        most = max(most, offsets[c + 1] - offsets[c])
    start, end, queue = np.empty((most, 2)), np.empty((most, 2)), np.empty(most, np.int64)
    for c in range(len(offsets) - 1):
        m = offsets[c + 1] - offsets[c]
        for k in range(m):
            f = faces[offsets[c] + k]
            flip = 0 if face_cells[f, 0] == first_cell + c else 1
            queue[k] = k
            for x in range(2):
                start[k, x] = points[face_vertices[f, flip], x]
                end[k, x] = points[face_vertices[f, 1 - flip], x]
        convex = _is_convex(start, end, m)
        for k in range(m):
            f = faces[offsets[c] + k]
            if start[k, 0] != end[k, 0] or start[k, 1] != end[k, 1]:
                side = 0 if face_cells[f, 0] == first_cell + c else 1
                heights[f, side] = _visible_height(start, end, m, k, convex, queue)


@kernel
def block_pattern(offsets, faces, face_cells):
    """Blocks of cells that share a face, and of each cell with itself, as compressed rows.

    Row offsets ``(n + 1,)``, sorted columns, the places ``(n,)`` of the diagonal and ``(F, 2, 2)`` of the
    faces (row of owner or neighbour, column of owner or neighbour). Cells are visited in their order, so
    rows fill from left to right.
    """
    n = len(offsets) - 1
    indptr, last, slots = (
        np.zeros(n + 1, np.int64),
        np.full(n, -1),
        np.zeros((len(face_cells), 2, 2), np.int64),
    )
    for c in range(n):
        indptr[c + 1] += 1
        last[c] = c
        for h in range(offsets[c], offsets[c + 1]):
            row = face_cells[faces[h], 0] + face_cells[faces[h], 1] - c
            if row >= 0 and last[row] != c:
                indptr[row + 1] += 1
                last[row] = c
    for c in range(n):
        indptr[c + 1] += indptr[c]
    indices, diagonal, free = np.empty(indptr[n], np.int64), np.empty(n, np.int64), indptr[:n].copy()
    for c in range(n):
        diagonal[c] = free[c]
        indices[free[c]] = c
        free[c] += 1
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            side = 0 if face_cells[f, 0] == c else 1
            slots[f, side, side] = diagonal[c]
            row = face_cells[f, 1 - side]
            if row < 0:
                continue
            if free[row] == indptr[row] or indices[free[row] - 1] != c:
                indices[free[row]] = c
                free[row] += 1
            slots[f, 1 - side, side] = free[row] - 1
    return indptr, indices, diagonal, slots


@helper
def _along(start, step, s, table, values, slopes):
    """Legendre polynomials ``(degree + 1, LANES)`` and their slopes at start + s step, a point to a lane."""
    for lane in range(LANES):
        values[0, lane], slopes[0, lane] = CONSTANT, 0.0
        values[1, lane] = table[0, 0] * (start[lane] + s * step[lane]) * CONSTANT
        slopes[1, lane] = table[3, 0] * CONSTANT
    for k in range(1, table.shape[1]):
        a, b, c, d = table[0, k], table[1, k], table[2, k], table[3, k]
        for lane in range(LANES):
            x = start[lane] + s * step[lane]
            values[k + 1, lane] = a * x * values[k, lane] - b * values[k - 1, lane]
        for lane in range(LANES):
            slopes[k + 1, lane] = c * slopes[k - 1, lane] + d * values[k, lane]


@helper
def _sum_points(jumps, rest, sums):
    """The lower halves of Σ_q j rᵀ + r jᵀ in each lane, j = jumps[q] and r = rest[q]."""
    for i in range(jumps.shape[1]):
        for j in range(i + 1):
            for lane in range(LANES):
                sums[i, j, lane] = jumps[0, i, lane] * rest[0, j, lane] + rest[0, i, lane] * jumps[0, j, lane]
            for q in range(1, len(jumps)):
                for lane in range(LANES):
                    first = jumps[q, i, lane] * rest[q, j, lane]
                    sums[i, j, lane] += first + rest[q, i, lane] * jumps[q, j, lane]


@helper
def _scatter(sums, lane, m, f, face_cells, mine, slots, blocks):
    """Add what a lane holds of face f to its blocks in the rows of cells that are ``mine``."""
    owner, neighbour = face_cells[f, 0], face_cells[f, 1]
    for side in range(2):
        if face_cells[f, side] < 0 or not mine[face_cells[f, side]]:
            continue
        own, start = slots[f, side, side], side * m
        for i in range(m):
            for j in range(i):
                value = sums[start + i, start + j, lane]
                blocks[own, i, j] += value
                blocks[own, j, i] += value
            blocks[own, i, i] += sums[start + i, start + i, lane]
    if neighbour < 0:
        return
    lower, upper = slots[f, 1, 0], slots[f, 0, 1]
    if mine[neighbour]:
        for i in range(m):
            for j in range(m):
                blocks[lower, i, j] += sums[m + i, j, lane]
    if mine[owner]:
        for i in range(m):
            for j in range(m):
                blocks[upper, j, i] += sums[m + i, j, lane]


@kernel
def face_blocks(
    points, face_vertices, face_cells, faces, mine, slots, boxes, scale, sigma, kappa, nodes, weights, blocks,
):  # fmt: skip
    """Add −{κ∇u·n}[v] − {κ∇v·n}[u] + σ[u][v] of ``faces (k,)`` to the blocks of cells that are ``mine``.

    A block ``(m, m)`` is that of the cell of its row; ``slots (F, 2, 2)`` says which one holds (owner or
    neighbour, owner or neighbour). ``kappa (F, 2, 1 or q)`` is the coefficient on both sides, ``sigma (F,)``
    the penalty without it. Faces of σ = 0 are skipped. Averages and penalty are weighted harmonically. With
    jumps j and r = σ/2 j − g, g the average, each point adds j rᵀ + r jᵀ. Faces go ``LANES`` at a time.
    """
    m, rules = blocks.shape[1], len(nodes)
    degree = int(np.sqrt(2.0 * m)) - 1  # m = (degree + 1)(degree + 2) / 2
    table = recurrences(degree)
    jumps, rest = np.empty((rules, 2 * m, LANES)), np.empty((rules, 2 * m, LANES))
    sums = np.empty((2 * m, 2 * m, LANES))
    lx, dx, ly, dy = (
        np.empty((degree + 1, LANES)), np.empty((degree + 1, LANES)),
        np.empty((degree + 1, LANES)), np.empty((degree + 1, LANES)),
    )  # fmt: skip
    chosen, frame, shares = np.empty(LANES, np.int64), np.empty((8, LANES)), np.zeros((2, LANES))
    x, y, along_x, along_y, nx, ny = frame[0], frame[1], frame[2], frame[3], frame[4], frame[5]
    signed, length, mean, stiff = frame[6], frame[7], shares[0], shares[1]
    following = 0
    while following < len(faces):
        count = 0
        while count < LANES and following < len(faces):
            if sigma[faces[following]] != 0.0:
                chosen[count] = faces[following]
                count += 1
            following += 1
        for side in range(2):
            frame[:] = 0.0
            for lane in range(count):
                f = chosen[lane]
                c, a, b = face_cells[f, side], face_vertices[f, 0], face_vertices[f, 1]
                ex, ey = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
                length[lane] = np.sqrt(ex * ex + ey * ey)
                if c < 0:
                    continue
                wide, high = 1.0 / boxes[c, 2], 1.0 / boxes[c, 3]
                ex, ey = along_box(ex, ey, boxes[c])
                px, py = along_box(points[a, 0] - boxes[c, 0], points[a, 1] - boxes[c, 1], boxes[c])
                x[lane], y[lane] = px * wide, py * high
                along_x[lane], along_y[lane] = ex * wide, ey * high
                nx[lane] = scale[c] * ey * wide / length[lane]
                ny[lane] = -scale[c] * ex * high / length[lane]
                signed[lane] = scale[c] * (1.0 - 2.0 * side)
            for q in range(rules):
                s, at = 0.5 * (1.0 + nodes[q]), min(q, kappa.shape[2] - 1)
                for lane in range(count):
                    own, other = kappa[chosen[lane], 0, at], kappa[chosen[lane], 1, at]
                    inner = face_cells[chosen[lane], 1] >= 0
                    mean[lane] = own * (other / (own + other)) if inner else own
                    stiff[lane] = (1.0 if inner else 0.5) * sigma[chosen[lane]] * mean[lane]
                _along(x, along_x, s, table, lx, dx)
                _along(y, along_y, s, table, ly, dy)
                k, half = side * m, 0.5 * weights[q]
                for total in range(degree + 1):
                    for j in range(total + 1):
                        i = total - j
                        for lane in range(LANES):
                            value = signed[lane] * lx[i, lane] * ly[j, lane]
                            slope = (
                                nx[lane] * dx[i, lane] * ly[j, lane] + ny[lane] * lx[i, lane] * dy[j, lane]
                            )
                            rest[q, k, lane] = stiff[lane] * value - mean[lane] * slope
                            jumps[q, k, lane] = half * length[lane] * value
                        k += 1
        _sum_points(jumps, rest, sums)
        for lane in range(count):
            _scatter(sums, lane, m, chosen[lane], face_cells, mine, slots, blocks)
