"""Kernels of the faces: their blocks of the matrix, made at once or kept for κ = 1 and scaled.

Polynomials and boxes are those of :mod:`~agglo_polydg_mg.space.legendre_kernels`.
"""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_polydg_mg.space.legendre_kernels import CONSTANT, LANES, along_box, recurrences


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


@helper
def _choose(following, faces, sigma, chosen):
    """The next faces of σ > 0 to ``chosen``, at most ``LANES``: how many, and where the following start."""
    count = 0
    while count < LANES and following < len(faces):
        if sigma[faces[following]] != 0.0:
            chosen[count] = faces[following]
            count += 1
        following += 1
    return count, following


@helper(allocates=True)
def _rooms(rules, m, degree):
    """Where :func:`_add_up` computes, for polynomials and for frames of faces."""
    return np.empty((2, rules, 2 * m, LANES)), np.empty((4, degree + 1, LANES)), np.empty((8, LANES))


@helper
def _add_up(
    points, face_vertices, face_cells, chosen, count, boxes, scale, means, stiffs, nodes, weights, table,
    rooms, sums,
):  # fmt: skip
    """Σ_q j rᵀ + r jᵀ of ``chosen`` faces to the lower halves ``sums (2 m, 2 m, LANES)``.

    j are the jumps of the polynomials of both cells, r = stiff j − mean g with the sum g of their normal
    derivatives; ``means`` and ``stiffs (q, LANES)`` are given at each point.
    """
    traces, lines, frame = rooms
    jumps, rest, degree, m = traces[0], traces[1], table.shape[1], traces.shape[2] // 2
    lx, dx, ly, dy = lines[0], lines[1], lines[2], lines[3]
    x, y, along_x, along_y = frame[0], frame[1], frame[2], frame[3]
    nx, ny, signed, length = frame[4], frame[5], frame[6], frame[7]
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
        for q in range(len(nodes)):
            s, mean, stiff = 0.5 * (1.0 + nodes[q]), means[q], stiffs[q]
            _along(x, along_x, s, table, lx, dx)
            _along(y, along_y, s, table, ly, dy)
            k, half = side * m, 0.5 * weights[q]
            for total in range(degree + 1):
                for j in range(total + 1):
                    i = total - j
                    for lane in range(LANES):
                        value = signed[lane] * lx[i, lane] * ly[j, lane]
                        slope = nx[lane] * dx[i, lane] * ly[j, lane] + ny[lane] * lx[i, lane] * dy[j, lane]
                        rest[q, k, lane] = stiff[lane] * value - mean[lane] * slope
                        jumps[q, k, lane] = half * length[lane] * value
                    k += 1
    _sum_points(jumps, rest, sums)


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
    table, rooms, sums = recurrences(degree), _rooms(rules, m, degree), np.empty((2 * m, 2 * m, LANES))
    chosen, means, stiffs = np.empty(LANES, np.int64), np.zeros((rules, LANES)), np.zeros((rules, LANES))
    count, following = _choose(0, faces, sigma, chosen)
    while count > 0:
        for q in range(rules):
            at = min(q, kappa.shape[2] - 1)
            for lane in range(count):
                own, other = kappa[chosen[lane], 0, at], kappa[chosen[lane], 1, at]
                inner = face_cells[chosen[lane], 1] >= 0
                means[q, lane] = own * (other / (own + other)) if inner else own
                stiffs[q, lane] = (1.0 if inner else 0.5) * sigma[chosen[lane]] * means[q, lane]
        _add_up(
            points, face_vertices, face_cells, chosen, count, boxes, scale, means, stiffs, nodes, weights,
            table, rooms, sums,
        )  # fmt: skip
        for lane in range(count):
            _scatter(sums, lane, m, chosen[lane], face_cells, mine, slots, blocks)
        count, following = _choose(following, faces, sigma, chosen)


@kernel
def unit_faces(
    points, face_vertices, face_cells, first, lengths, boxes, scale, nodes, weights, degree, units
):  # fmt: skip
    """Write what faces ``first``, ... add to the blocks of their cells where the harmonic mean of κ is 1.

    The lower halves, row by row, of the block of both cells: of the jumps, σ being 1, to ``units[k, 0]``, of
    the averages to ``units[k, 1]``. Faces of ``lengths`` 0 are left as they are.
    """
    m, rules = (degree + 1) * (degree + 2) // 2, len(nodes)
    table, rooms, sums = recurrences(degree), _rooms(rules, m, degree), np.empty((2 * m, 2 * m, LANES))
    chosen, ones, stiffs = np.empty(LANES, np.int64), np.ones((rules, LANES)), np.empty((rules, LANES))
    none, faces = np.zeros((rules, LANES)), np.arange(first, first + len(units))
    count, following = _choose(0, faces, lengths, chosen)
    while count > 0:
        for lane in range(count):
            for q in range(rules):
                stiffs[q, lane] = 1.0 if face_cells[chosen[lane], 1] >= 0 else 0.5
        for part in range(2):
            _add_up(
                points, face_vertices, face_cells, chosen, count, boxes, scale, ones if part else none,
                none if part else stiffs, nodes, weights, table, rooms, sums,
            )  # fmt: skip
            for lane in range(count):
                unit, place = units[chosen[lane] - first, part], 0
                for i in range(2 * m):
                    for j in range(i + 1):
                        unit[place] = sums[i, j, lane]
                        place += 1
        count, following = _choose(following, faces, lengths, chosen)


@kernel
def scaled_blocks(face_cells, faces, mine, slots, diagonal, sigma, kappa, stiffness, units, blocks):
    """As :func:`face_blocks`, for ``kappa (n,)`` in the cells, of the ``units`` of all faces.

    The ``stiffness (n, m, m)`` of the cells, for κ = 1, is added to their blocks on the ``diagonal (n,)``.
    """
    m, both = blocks.shape[1], np.empty(units.shape[2])
    for c in range(len(diagonal)):
        if mine[c]:
            for i in range(m):
                for j in range(m):
                    blocks[diagonal[c], i, j] += kappa[c] * stiffness[c, i, j]
    for f in faces:
        if sigma[f] == 0.0:
            continue
        owner, neighbour, jumps, averages = face_cells[f, 0], face_cells[f, 1], units[f, 0], units[f, 1]
        mean = kappa[owner]
        if neighbour >= 0:
            mean *= kappa[neighbour] / (kappa[owner] + kappa[neighbour])
        stiff = sigma[f] * mean
        for k in range(len(both)):
            both[k] = stiff * jumps[k] + mean * averages[k]
        for side in range(2):
            if face_cells[f, side] < 0 or not mine[face_cells[f, side]]:
                continue
            block = blocks[slots[f, side, side]]
            for i in range(m):
                row = side * m + i
                start = (row * (row + 1)) // 2 + side * m
                for j in range(i):
                    block[i, j] += both[start + j]
                    block[j, i] += both[start + j]
                block[i, i] += both[start + i]
        if neighbour < 0:
            continue
        lower, upper = blocks[slots[f, 1, 0]], blocks[slots[f, 0, 1]]
        for i in range(m if mine[neighbour] else 0):
            start = ((m + i) * (m + i + 1)) // 2
            for j in range(m):
                lower[i, j] += both[start + j]
        for i in range(m if mine[owner] else 0):
            start = ((m + i) * (m + i + 1)) // 2
            for j in range(m):
                upper[j, i] += both[start + j]
