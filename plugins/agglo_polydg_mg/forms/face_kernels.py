"""Compiled kernels for the matrix blocks of faces.

Polynomials and boxes are defined in :mod:`~agglo_polydg_mg.space.legendre_kernels`.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_polydg_mg.space.legendre_kernels import CONSTANT, LANES, along_box, recurrences


@kernel
def block_pattern(offsets, faces, face_cells):
    """Compute the block sparsity pattern that couples each cell with itself and its neighbours.

    Cell c has the faces ``faces[offsets[c]:offsets[c + 1]]``; ``face_cells (F, 2)`` are owner and
    neighbour, −1 outside. Returns row offsets ``(n + 1,)``, sorted columns, the diagonal positions ``(n,)``
    and the face positions ``(F, 2, 2)`` (row of owner or neighbour, column of owner or neighbour). Cells
    are visited in order, so rows fill from left to right.
    """
    n = len(offsets) - 1
    indptr, last, slots = (
        np.zeros(n + 1, np.int64),
        np.full(n, -1),
        np.zeros((len(face_cells), 2, 2), np.int64),
    )
    # 1. Count the blocks in each row. Cell c is a column in its own row and, regardless of the number of
    # shared faces, once in each neighbour's row: last[row] is the last column counted in that row.
    for c in range(n):
        indptr[c + 1] += 1
        last[c] = c
        for h in range(offsets[c], offsets[c + 1]):
            row = face_cells[faces[h], 0] + face_cells[faces[h], 1] - c
            if row >= 0 and last[row] != c:
                indptr[row + 1] += 1
                last[row] = c
    # 2. Row offsets.
    for c in range(n):
        indptr[c + 1] += indptr[c]
    indices, diagonal, free = np.empty(indptr[n], np.int64), np.empty(n, np.int64), indptr[:n].copy()
    # 3. Columns in the order c = 0, 1, ..., so that each row is sorted; free[row] is the next free
    # position. Every face stores the position of its block in column c for both rows.
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
            # A further face between the same cells uses the block written last in this row.
            if free[row] == indptr[row] or indices[free[row] - 1] != c:
                indices[free[row]] = c
                free[row] += 1
            slots[f, 1 - side, side] = free[row] - 1
    return indptr, indices, diagonal, slots


@helper
def _polynomials_along(start, step, s, table, values, slopes):
    """Evaluate Legendre polynomials ``(degree + 1, LANES)`` and their derivatives at start + s step.

    Each vector lane has its own point. The rows a, b, c, d of ``table`` are defined in ``recurrences``.
    """
    # L_0, L_1 and their slopes first; the recurrences in a, b and c, d give all others.
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
def _sum_points(jumps, fluxes, sums):
    """Write the lower half of Σ_q (j rᵀ + r jᵀ) to ``sums``, with j = jumps[q] and r = fluxes[q].

    Each vector lane has its own matrix.
    """
    for i in range(jumps.shape[1]):
        for j in range(i + 1):
            for lane in range(LANES):
                sums[i, j, lane] = (
                    jumps[0, i, lane] * fluxes[0, j, lane] + fluxes[0, i, lane] * jumps[0, j, lane]
                )
            for q in range(1, len(jumps)):
                for lane in range(LANES):
                    first = jumps[q, i, lane] * fluxes[q, j, lane]
                    sums[i, j, lane] += first + fluxes[q, i, lane] * jumps[q, j, lane]


@helper
def _scatter(sums, lane, m, f, face_cells, in_strip, slots, blocks):
    """Add the matrix of face f, given in one vector lane, to the rows of ``in_strip`` cells.

    ``sums (2 m, 2 m, LANES)`` contain lower halves, the owner's m rows before the neighbour's.
    """
    owner, neighbour = face_cells[f, 0], face_cells[f, 1]
    # Diagonal blocks are symmetric: ``sums`` contains their lower halves.
    for side in range(2):
        if face_cells[f, side] < 0 or not in_strip[face_cells[f, side]]:
            continue
        diagonal, start = slots[f, side, side], side * m
        for i in range(m):
            for j in range(i):
                value = sums[start + i, start + j, lane]
                blocks[diagonal, i, j] += value
                blocks[diagonal, j, i] += value
            blocks[diagonal, i, i] += sums[start + i, start + i, lane]
    if neighbour < 0:
        return
    # ``sums`` contains the block (neighbour, owner); the block (owner, neighbour) is its transpose.
    lower, upper = slots[f, 1, 0], slots[f, 0, 1]
    if in_strip[neighbour]:
        for i in range(m):
            for j in range(m):
                blocks[lower, i, j] += sums[m + i, j, lane]
    if in_strip[owner]:
        for i in range(m):
            for j in range(m):
                blocks[upper, j, i] += sums[m + i, j, lane]


@helper
def _choose(following, faces, sigma, batch):
    """Collect at most ``LANES`` faces with σ > 0, and return their number and the next index."""
    count = 0
    while count < LANES and following < len(faces):
        if sigma[faces[following]] != 0.0:
            batch[count] = faces[following]
            count += 1
        following += 1
    return count, following


@helper(allocates=True)
def _rooms(rules, m, degree):
    """Allocate the workspace of :func:`_add_up`: traces, polynomials along the axes, and face frames."""
    return np.empty((2, rules, 2 * m, LANES)), np.empty((4, degree + 1, LANES)), np.empty((8, LANES))


@helper
def _add_up(
    points, face_vertices, face_cells, batch, count, boxes, scale, directions, means, stiffs, nodes,
    weights, table, workspace, sums,
):  # fmt: skip
    """Compute the bilinear form of each face in ``batch``: the lower half of Σ_q (j rᵀ + r jᵀ).

    ``sums (2 m, 2 m, LANES)`` receives the results. Here j are the polynomial jumps between both cells and
    r = stiff j − mean g, with the sum g of their normal derivatives; ``means`` and ``stiffs (q, LANES)``
    are given at each point, and ``directions (F, 2, 1 or q, 2)`` replace the normals if there are any.
    With mean = γ/2 and stiff = σγ/2 this is the bilinear form of the face, j being
    weighted by the Gauss rule.
    """
    traces, lines, frame = workspace
    jumps, fluxes, degree, m = traces[0], traces[1], table.shape[1], traces.shape[2] // 2
    lx, dx, ly, dy = lines[0], lines[1], lines[2], lines[3]
    x, y, along_x, along_y = frame[0], frame[1], frame[2], frame[3]
    nx, ny, signed, length = frame[4], frame[5], frame[6], frame[7]
    for side in range(2):
        # 1. Map each face to the box [−1, 1]² of its cell: the first vertex, the step to the second, and
        # the coefficients of ∂/∂x̂ and ∂/∂ŷ in the derivative along the owner's outward normal. Lanes
        # without a cell or face stay 0, and so do their traces.
        frame[:] = 0.0
        for lane in range(count):
            f = batch[lane]
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
        # 2. Traces at the Gauss points. Weight and face length multiply only j, so that they enter j rᵀ
        # once. The jump is the owner's value minus the neighbour's, and both sides share one normal.
        for q in range(len(nodes)):
            s, mean, stiff = 0.5 * (1.0 + nodes[q]), means[q], stiffs[q]
            if len(directions) > 0:
                at = min(q, directions.shape[2] - 1)
                for lane in range(count):
                    c, direction = face_cells[batch[lane], side], directions[batch[lane], side, at]
                    if c >= 0:
                        tx, ty = along_box(direction[0], direction[1], boxes[c])
                        nx[lane], ny[lane] = scale[c] * tx / boxes[c, 2], scale[c] * ty / boxes[c, 3]
            _polynomials_along(x, along_x, s, table, lx, dx)
            _polynomials_along(y, along_y, s, table, ly, dy)
            k, half = side * m, 0.5 * weights[q]
            # Polynomials by total degree, first the owner's, then the neighbour's.
            for total in range(degree + 1):
                for j in range(total + 1):
                    i = total - j
                    for lane in range(LANES):
                        value = signed[lane] * lx[i, lane] * ly[j, lane]
                        slope = nx[lane] * dx[i, lane] * ly[j, lane] + ny[lane] * lx[i, lane] * dy[j, lane]
                        fluxes[q, k, lane] = stiff[lane] * value - mean[lane] * slope
                        jumps[q, k, lane] = half * length[lane] * value
                    k += 1
    # 3. The bilinear form, from the traces of both sides.
    _sum_points(jumps, fluxes, sums)


@kernel
def face_blocks(
    points, face_vertices, face_cells, faces, in_strip, slots, boxes, scale, sigma, kappa, directions,
    nodes, weights, blocks,
):  # fmt: skip
    """Add ∫ −{κ∇u·n}[v] − {κ∇v·n}[u] + γσ[u][v] over ``faces (k,)`` to the rows of ``in_strip`` cells.

    Each block ``(m, m)`` is stored in its row cell; ``slots (F, 2, 2)`` gives the block position for (owner
    or neighbour, owner or neighbour). ``kappa (F, 2, 1 or q)`` is the coefficient on both sides,
    ``sigma (F,)`` the penalty without κ. For a tensor they are n·κn and ``directions`` κn / (n·κn).
    Faces with σ = 0 are skipped. Averages and penalty are weighted
    harmonically, γ = 2 κ κ' / (κ + κ'). With jumps j and r = γσ/2 j − g, g the average, each point adds j
    rᵀ + r jᵀ. Each pass takes ``LANES`` faces.
    """
    m, rules = blocks.shape[1], len(nodes)
    degree = int(np.sqrt(2.0 * m)) - 1  # m = (degree + 1)(degree + 2) / 2
    table, workspace, sums = recurrences(degree), _rooms(rules, m, degree), np.empty((2 * m, 2 * m, LANES))
    batch, means, stiffs = np.empty(LANES, np.int64), np.zeros((rules, LANES)), np.zeros((rules, LANES))
    count, following = _choose(0, faces, sigma, batch)
    while count > 0:
        # Inside, γ/2 weights both normal derivatives; at the boundary, with one side, κ does.
        for q in range(rules):
            at = min(q, kappa.shape[2] - 1)
            for lane in range(count):
                kappa_0, kappa_1 = kappa[batch[lane], 0, at], kappa[batch[lane], 1, at]
                inner = face_cells[batch[lane], 1] >= 0
                means[q, lane] = kappa_0 * (kappa_1 / (kappa_0 + kappa_1)) if inner else kappa_0
                stiffs[q, lane] = (1.0 if inner else 0.5) * sigma[batch[lane]] * means[q, lane]
        # Sum j rᵀ + r jᵀ over all Gauss points, then scatter each face to its four blocks.
        _add_up(
            points, face_vertices, face_cells, batch, count, boxes, scale, directions, means, stiffs, nodes,
            weights, table, workspace, sums,
        )  # fmt: skip
        for lane in range(count):
            _scatter(sums, lane, m, batch[lane], face_cells, in_strip, slots, blocks)
        count, following = _choose(following, faces, sigma, batch)
