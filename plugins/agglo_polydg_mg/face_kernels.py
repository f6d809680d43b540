"""Kernels of the faces: the largest triangles on them, and their blocks of the matrix.

Polynomials and boxes are those of :mod:`~agglo_polydg_mg.legendre_kernels`.
"""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import kernel
from agglo_polydg_mg.legendre_kernels import legendre_at, roots_up_to, slopes_of

__all__ = ["block_pattern", "face_blocks", "triangle_heights"]

_SHRUNK = 1e-8  # how far into a triangle, in barycentric coordinates, an edge must reach to count


@kernel
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


@kernel
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


@kernel
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
def triangle_heights(points, offsets, faces, face_vertices, face_cells):
    """Height ``(F, 2)`` over each face of the largest triangle in the owner and in the neighbour.

    Its base is the face, its apex a vertex of the cell, and it lies in the cell. Infinite outside the
    domain and for faces of no length; 0 if no vertex is visible from a face.
    """
    heights = np.full((len(face_cells), 2), np.inf)
    most = 0
    for c in range(len(offsets) - 1):
        most = max(most, offsets[c + 1] - offsets[c])
    start, end, queue = np.empty((most, 2)), np.empty((most, 2)), np.empty(most, np.int64)
    for c in range(len(offsets) - 1):
        m = offsets[c + 1] - offsets[c]
        for k in range(m):
            f = faces[offsets[c] + k]
            flip = 0 if face_cells[f, 0] == c else 1
            queue[k] = k
            for x in range(2):
                start[k, x] = points[face_vertices[f, flip], x]
                end[k, x] = points[face_vertices[f, 1 - flip], x]
        convex = _is_convex(start, end, m)
        for k in range(m):
            f = faces[offsets[c] + k]
            if start[k, 0] != end[k, 0] or start[k, 1] != end[k, 1]:
                side = 0 if face_cells[f, 0] == c else 1
                heights[f, side] = _visible_height(start, end, m, k, convex, queue)
    return heights


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


@kernel
def _outer_sum(left, right, n, m, out):
    """Σ_q left[q] right[q]ᵀ over n rows of length m."""
    for i in range(m):
        first = left[0, i]
        for j in range(m):
            out[i, j] = first * right[0, j]
        for q in range(1, n):
            factor = left[q, i]
            for j in range(m):
                out[i, j] += factor * right[q, j]


@kernel
def _add_symmetric(block, half, start, m):
    """Add the sum of a diagonal block of ``half`` and its transpose."""
    for i in range(m):
        for j in range(i):
            value = half[start + i, start + j] + half[start + j, start + i]
            block[i, j] += value
            block[j, i] += value
        block[i, i] += 2.0 * half[start + i, start + i]


@kernel
def _add_across(upper, lower, half, m):
    """Add what ``half`` plus its transpose hold outside of the diagonal blocks."""
    for i in range(m):
        for j in range(m):
            value = half[i, m + j] + half[m + j, i]
            upper[i, j] += value
            lower[j, i] += value


@kernel
def face_blocks(
    points,
    face_vertices,
    face_cells,
    slots,
    inside,
    diagonal,
    boxes,
    scale,
    sigma,
    kappa,
    nodes,
    weights,
    n_blocks,
):
    """Blocks ``(n_blocks, m, m)`` of −{κ∇u·n}[v] − {κ∇v·n}[u] + σ[u][v], and those ``inside`` the cells.

    ``inside (n, m, m)`` go to the places ``diagonal (n,)``; ``slots (F, 2, 2)`` says which block holds
    (owner or neighbour, owner or neighbour); ``kappa (F, 2, 1 or q)`` is the coefficient on both sides,
    ``sigma (F,)`` the penalty without it. Faces of σ = 0 are skipped. Averages and penalty are weighted
    harmonically. With jumps j and r = σ/2 j − g, g the average, each point adds j rᵀ + r jᵀ: only one of
    the two is summed.
    """
    m = inside.shape[1]
    degree = int(np.sqrt(2.0 * m)) - 1  # m = (degree + 1)(degree + 2) / 2
    blocks = np.zeros((n_blocks, m, m))
    roots, (lx, ly, dx, dy) = roots_up_to(degree), np.empty((4, degree + 1))
    jumps, rest, half = np.empty((len(nodes), 2 * m)), np.empty((len(nodes), 2 * m)), np.empty((2 * m, 2 * m))
    for f in range(len(face_cells)):
        if sigma[f] == 0.0:
            continue
        sides = 1 if face_cells[f, 1] < 0 else 2
        a, b = face_vertices[f, 0], face_vertices[f, 1]
        ex, ey = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
        length = np.sqrt(ex * ex + ey * ey)
        for side in range(sides):
            c = face_cells[f, side]
            hx, hy, signed = boxes[c, 2], boxes[c, 3], scale[c] * (1.0 - 2.0 * side)
            nx, ny = ey / (length * hx), -ex / (length * hy)
            for q in range(len(nodes)):
                s = 0.5 * (1.0 + nodes[q])
                x, y = points[a, 0] + s * ex, points[a, 1] + s * ey
                own = kappa[f, 0, min(q, kappa.shape[2] - 1)]
                other = kappa[f, 1, min(q, kappa.shape[2] - 1)]
                mean = own * (other / (own + other)) if sides == 2 else own
                stiff = 0.5 * sides * sigma[f] * mean  # σ/2: twice the mean is the harmonic one of two sides
                share = scale[c] * mean
                legendre_at((x - boxes[c, 0]) / hx, degree, roots, lx)
                legendre_at((y - boxes[c, 1]) / hy, degree, roots, ly)
                slopes_of(lx, degree, roots, dx)
                slopes_of(ly, degree, roots, dy)
                measure = 0.5 * weights[q] * length
                for j in range(degree + 1):
                    for i in range(degree + 1 - j):
                        jump = signed * lx[i] * ly[j]
                        k = side * m + ((i + j) * (i + j + 1)) // 2 + j
                        rest[q, k] = stiff * jump - share * (nx * dx[i] * ly[j] + ny * lx[i] * dy[j])
                        jumps[q, k] = measure * jump
        _outer_sum(jumps, rest, len(nodes), sides * m, half)
        for side in range(sides):
            _add_symmetric(blocks[slots[f, side, side]], half, side * m, m)
        if sides == 2:
            _add_across(blocks[slots[f, 0, 1]], blocks[slots[f, 1, 0]], half, m)
    for c in range(len(diagonal)):
        blocks[diagonal[c]] += inside[c]
    return blocks
