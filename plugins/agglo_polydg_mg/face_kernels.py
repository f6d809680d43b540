"""Kernels of the discretisation: moments, largest triangles on faces, and the blocks of the faces.

Polynomials are products L_i(x̂) L_j(ŷ) of orthonormal Legendre polynomials on the bounding box of a
cell, a box being its centre and half sides (cx, cy, hx, hy). They are numbered by total degree:
(0,0), (1,0), (0,1), (2,0), (1,1), (0,2), …
"""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import kernel

__all__ = ["boundary_moments", "face_blocks", "point_moments", "triangle_heights"]

_SHRUNK = 1e-8  # how far into a triangle, in barycentric coordinates, an edge must reach to count


@kernel
def _legendre(x, degree, out):
    """Orthonormal Legendre polynomials 0..degree at x."""
    before, value = 0.0, 1.0
    for k in range(degree + 1):
        out[k] = value * np.sqrt(k + 0.5)
        before, value = value, ((2 * k + 1) * x * value - k * before) / (k + 1)


@kernel
def _slopes(values, degree, out):
    """Derivatives of the polynomials ``values``: P'_{k+1} = P'_{k-1} + (2k + 1) P_k, normalised."""
    out[0] = 0.0
    for k in range(degree):
        below = out[k - 1] / np.sqrt(k - 0.5) if k > 0 else 0.0
        out[k + 1] = (below + 2.0 * np.sqrt(k + 0.5) * values[k]) * np.sqrt(k + 1.5)


@kernel
def boundary_moments(points, offsets, faces, face_vertices, face_cells, boxes, nodes, weights, degree):
    """Integrals ``(n, m)`` of the polynomials of a degree over each cell, by the divergence theorem.

    L_i has the antiderivative (P_{i+1} − P_{i−1}) / (2i + 1) times its normalisation; ``nodes`` must
    integrate degree + 1 on [−1, 1].
    """
    n = len(offsets) - 1
    moments = np.zeros((n, (degree + 1) * (degree + 2) // 2))
    lx, ly, primitive = np.empty(degree + 2), np.empty(degree + 2), np.empty(degree + 1)
    for c in range(n):
        cx, cy, hx, hy = boxes[c, 0], boxes[c, 1], boxes[c, 2], boxes[c, 3]
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            flip = 0 if face_cells[f, 0] == c else 1
            a, b = face_vertices[f, flip], face_vertices[f, 1 - flip]
            ax, ay = (points[a, 0] - cx) / hx, (points[a, 1] - cy) / hy
            bx, by = (points[b, 0] - cx) / hx, (points[b, 1] - cy) / hy
            rise = 0.5 * (by - ay) * hx * hy
            for q in range(len(nodes)):
                s = 0.5 * (1.0 + nodes[q])
                _legendre(ax + s * (bx - ax), degree + 1, lx)
                _legendre(ay + s * (by - ay), degree, ly)
                for i in range(degree + 1):
                    below = lx[i - 1] / np.sqrt(i - 0.5) if i > 0 else 0.0
                    primitive[i] = (lx[i + 1] / np.sqrt(i + 1.5) - below) / (2.0 * np.sqrt(i + 0.5))
                k = 0
                for total in range(degree + 1):
                    for j in range(total + 1):
                        moments[c, k] += rise * weights[q] * primitive[total - j] * ly[j]
                        k += 1
    return moments


@kernel
def point_moments(points, values, offsets, boxes, degree):
    """Sums ``(n, m)`` of values times polynomials over each cell's points ``offsets[c]:offsets[c + 1]``."""
    n = len(offsets) - 1
    moments = np.zeros((n, (degree + 1) * (degree + 2) // 2))
    lx, ly = np.empty(degree + 1), np.empty(degree + 1)
    for c in range(n):
        for q in range(offsets[c], offsets[c + 1]):
            _legendre((points[q, 0] - boxes[c, 0]) / boxes[c, 2], degree, lx)
            _legendre((points[q, 1] - boxes[c, 1]) / boxes[c, 3], degree, ly)
            k = 0
            for total in range(degree + 1):
                for j in range(total + 1):
                    moments[c, k] += values[q] * lx[total - j] * ly[j]
                    k += 1
    return moments


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
def face_blocks(
    points, face_vertices, face_cells, slots, boxes, scale, sigma, kappa, nodes, weights, degree, n_blocks
):
    """Blocks ``(n_blocks, m, m)`` of −{κ∇u·n}[v] − {κ∇v·n}[u] + σ[u][v], summed over the faces.

    ``slots (F, 2, 2)`` says which block holds (owner or neighbour, owner or neighbour); ``kappa (F, 2,
    1 or q)`` is the coefficient on both sides, ``sigma (F,)`` the penalty without it. Faces of σ = 0
    are skipped. Averages and penalty are weighted harmonically. With jumps j and r = σ/2 j − g, g the
    average, each point adds j rᵀ + r jᵀ: only one of the two is summed.
    """
    m = (degree + 1) * (degree + 2) // 2
    blocks = np.zeros((n_blocks, m, m))
    lx, ly, dx, dy = np.empty((4, degree + 1))
    jump, flux, half = np.empty(2 * m), np.empty(2 * m), np.empty((2 * m, 2 * m))
    for f in range(len(face_cells)):
        if sigma[f] == 0.0:
            continue
        sides = 1 if face_cells[f, 1] < 0 else 2
        a, b = face_vertices[f, 0], face_vertices[f, 1]
        ex, ey = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
        length = np.sqrt(ex * ex + ey * ey)
        for i in range(sides * m):
            for j in range(sides * m):
                half[i, j] = 0.0
        for q in range(len(nodes)):
            s = 0.5 * (1.0 + nodes[q])
            x, y = points[a, 0] + s * ex, points[a, 1] + s * ey
            own = kappa[f, 0, min(q, kappa.shape[2] - 1)]
            other = kappa[f, 1, min(q, kappa.shape[2] - 1)]
            mean = own * (other / (own + other)) if sides == 2 else own
            weight = 0.5 * weights[q] * length
            for side in range(sides):
                c = face_cells[f, side]
                hx, hy, sign = boxes[c, 2], boxes[c, 3], 1.0 - 2.0 * side
                _legendre((x - boxes[c, 0]) / hx, degree, lx)
                _legendre((y - boxes[c, 1]) / hy, degree, ly)
                _slopes(lx, degree, dx)
                _slopes(ly, degree, dy)
                nx, ny = ey / (length * hx), -ex / (length * hy)
                k = side * m
                for total in range(degree + 1):
                    for j in range(total + 1):
                        i = total - j
                        jump[k] = scale[c] * sign * lx[i] * ly[j]
                        flux[k] = scale[c] * mean * (nx * dx[i] * ly[j] + ny * lx[i] * dy[j])
                        k += 1
            stiff = 0.5 * sides * sigma[f] * mean  # σ/2: twice the mean is the harmonic one of two sides
            for k in range(sides * m):
                flux[k] = stiff * jump[k] - flux[k]
            for i in range(sides * m):
                left = weight * jump[i]
                for j in range(sides * m):
                    half[i, j] += left * flux[j]
        for s in range(sides):
            for t in range(sides):
                slot = slots[f, s, t]
                for i in range(m):
                    for j in range(m):
                        blocks[slot, i, j] += half[s * m + i, t * m + j] + half[t * m + j, s * m + i]
    return blocks
