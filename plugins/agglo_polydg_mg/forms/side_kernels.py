"""Compiled kernels for sides, the common boundaries of two polyhedra: their list and matrix blocks.

On each side the polynomials of both cells are written in coordinate powers of one frame, a box around the
side. All faces of the side contribute to the integrals of these powers, weighted by penalty and by normals;
all later work is independent of the face count.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_polydg_mg.space.legendre_kernels import CONSTANT, recurrences
from agglo_polydg_mg.space.solid_kernels import oriented_triangle


@kernel
def sides_of_cells(offsets, faces, face_cells, normals):
    """Group the faces of polyhedra into :class:`~agglo_polydg_mg.forms.sides.Sides`, by neighbour.

    Cell c has the faces ``faces[offsets[c]:offsets[c + 1]]``; ``normals (F, 3)`` point outward from the
    owner.
    """
    n, count = len(offsets) - 1, 0
    of_faces, last, outer = np.empty(len(face_cells), np.int64), np.full(n, -1), np.empty(6, np.int64)
    cells = np.full((len(face_cells), 2), -1)
    for c in range(n):
        # Sides are numbered by their first cells. Sides created by cell c start here: an entry of ``last``
        # belongs to this cell, and not to an earlier one, if it is at least start.
        start = count
        for k in range(6):
            outer[k] = -1
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            # At the boundary: one side for each main direction ±x, ±y or ±z of the face normals.
            if face_cells[f, 1] < 0:
                axis = 0
                for k in range(1, 3):
                    if abs(normals[f, k]) > abs(normals[f, axis]):
                        axis = k
                way = 2 * axis + (1 if normals[f, axis] < 0.0 else 0)
                if outer[way] < 0:
                    outer[way] = count
                    cells[count, 0] = c
                    count += 1
                of_faces[f] = outer[way]
                continue
            # Inside: one side per neighbour, created by the cell with the lower number.
            neighbour = face_cells[f, 0] + face_cells[f, 1] - c
            if neighbour < c:
                continue
            if last[neighbour] < start:
                last[neighbour] = count
                cells[count, 0], cells[count, 1] = c, neighbour
                count += 1
            of_faces[f] = last[neighbour]
    ends, members = _members(of_faces, count)
    cell_ends, cell_sides = _sides_by_cells(cells[:count], n)
    return ends, members, cells[:count].copy(), cell_ends, cell_sides, of_faces


@helper(allocates=True)
def _members(groups, count):
    """Return offsets ``(count + 1,)`` and members ``(n,)`` of the groups, by counting sort."""
    ends, members = np.zeros(count + 1, np.int64), np.empty(len(groups), np.int64)
    for f in range(len(groups)):
        ends[groups[f] + 1] += 1
    for s in range(count):
        ends[s + 1] += ends[s]
    free = ends[:count].copy()
    for f in range(len(groups)):
        members[free[groups[f]]] = f
        free[groups[f]] += 1
    return ends, members


@helper(allocates=True)
def _sides_by_cells(cells, n):
    """List each cell's sides: offsets ``(n + 1,)`` and sides, by counting sort."""
    ends = np.zeros(n + 1, np.int64)
    for s in range(len(cells)):
        for k in range(2):
            if cells[s, k] >= 0:
                ends[cells[s, k] + 1] += 1
    for c in range(n):
        ends[c + 1] += ends[c]
    free, sides = ends[:n].copy(), np.empty(ends[n], np.int64)
    for s in range(len(cells)):
        for k in range(2):
            if cells[s, k] >= 0:
                sides[free[cells[s, k]]] = s
                free[cells[s, k]] += 1
    return ends, sides


@helper
def _frame(owner, neighbour, boxes, frame):
    """Write centre and half sides of a box around the side between two cells.

    At the boundary it is the owner's box. Inside it is centred on the overlap of both boxes, with the half
    sides of the smaller box: the overlap may be flat, and coordinates are divided by the half sides.
    """
    for d in range(3):
        low, high = boxes[owner, d] - boxes[owner, 3 + d], boxes[owner, d] + boxes[owner, 3 + d]
        half = boxes[owner, 3 + d]
        if neighbour >= 0:
            low = max(low, boxes[neighbour, d] - boxes[neighbour, 3 + d])
            high = min(high, boxes[neighbour, d] + boxes[neighbour, 3 + d])
            half = min(half, boxes[neighbour, 3 + d])
        frame[d], frame[3 + d] = 0.5 * (low + high), half


@helper
def _in_powers(box, scale, frame, table, powers, terms, lines, coefficients):
    """Expand the cell polynomials in monomials of the frame coordinates ξ: coefficients T ``(t,)``.

    T is a sparse matrix with entries at ``terms``: a polynomial with degrees (i, j, k) only has powers up
    to these along each axis.
    """
    degree = table.shape[1]
    # 1. Along each axis x̂ = at + stretch ξ. Row k of ``line`` has the coefficients of L_k(x̂) in powers of
    # ξ, by the recurrence L_{k+1} = a x̂ L_k − b L_{k−1}.
    for d in range(3):
        at, stretch, line = (frame[d] - box[d]) / box[3 + d], frame[3 + d] / box[3 + d], lines[d]
        line[0, 0] = CONSTANT
        line[1, 0], line[1, 1] = table[0, 0] * at * CONSTANT, table[0, 0] * stretch * CONSTANT
        for k in range(1, degree):
            a, b = table[0, k], table[1, k]
            for i in range(k + 2):
                value = a * at * line[k, i] if i <= k else 0.0
                if i > 0:
                    value += a * stretch * line[k, i - 1]
                if i < k:
                    value -= b * line[k - 1, i]
                line[k + 1, i] = value
    # 2. Coefficients of the triple products.
    for t in range(len(coefficients)):
        i, a = terms[t, 0], terms[t, 1]
        value = scale * lines[0, powers[i, 0], powers[a, 0]] * lines[1, powers[i, 1], powers[a, 1]]
        coefficients[t] = value * lines[2, powers[i, 2], powers[a, 2]]


@helper
def _powers_at(a, b, c, s, t, frame, xi):
    """Write the powers 0, 1, … of ξ_d = (x_d − centre) / half side at a point of a triangle to ``xi``."""
    for d in range(3):
        x = (a[d] + s * (b[d] - a[d]) + t * (c[d] - a[d]) - frame[d]) / frame[3 + d]
        xi[d, 0] = 1.0
        for k in range(xi.shape[1] - 1):
            xi[d, k + 1] = xi[d, k] * x


@helper
def _add_triangle(a, b, c, weighted, frame, rule, powers, xi, local):
    """Add Σ_q weighted[q] ξ^powers over the points of a triangle to ``local``."""
    for q in range(len(rule)):
        _powers_at(a, b, c, rule[q, 0], rule[q, 1], frame, xi)
        for k in range(len(local)):
            local[k] += weighted[q] * xi[0, powers[k, 0]] * xi[1, powers[k, 1]] * xi[2, powers[k, 2]]


@helper
def _add_slanted(a, b, c, weighted, frame, rule, powers, xi, directions, turned, normals):
    """Add Σ_q weighted[q] d ξ^powers over a triangle for the direction d on each side of it.

    ``directions (2, 1 or q, 3)`` are outward from the owner of the face, and ``normals (2, 3, k)`` from the
    first cell of the side, the second one if ``turned``.
    """
    for q in range(len(rule)):
        _powers_at(a, b, c, rule[q, 0], rule[q, 1], frame, xi)
        at = min(q, directions.shape[1] - 1)
        for side in range(2):
            direction = directions[1 - side if turned else side, at]
            sign = -1.0 if turned else 1.0
            for k in range(normals.shape[2]):
                value = sign * weighted[q] * xi[0, powers[k, 0]] * xi[1, powers[k, 1]] * xi[2, powers[k, 2]]
                for d in range(3):
                    normals[side, d, k] += value * direction[d]


@helper
def _add_face(
    points, face_offsets, face_vertices, f, vector, turned, sigma, kappa, directions, inner, frame, rule,
    weights, powers, xi, weighted, local, stiff, normals,
):  # fmt: skip
    """Add ∫ γσ ξ^powers of a face to ``stiff``, and ∫ γ/2 n ξ^powers to ``normals[0]``.

    At the boundary κ replaces γ/2. The face is a fan of triangles about its first vertex, ``vector (3,)``
    its normal outward from the owner; ``turned`` is True if the owner is the second cell of the side. The
    powers in ``normals`` have lower degree, < 2p. With ``directions`` on both sides instead of n there are
    two ``normals``.
    """
    first, lower = face_offsets[f], normals.shape[2]
    a = points[face_vertices[first]]
    for k in range(first + 1, face_offsets[f + 1] - 1):
        b, c = points[face_vertices[k]], points[face_vertices[k + 1]]
        # 1. Normal of the triangle.
        x, y, z, size = oriented_triangle(a, b, c, vector)
        if size == 0.0:
            continue
        # 2. γ/2 at each point, at the boundary κ. Triangles are numbered through all faces: each face
        # before f has two triangles fewer than vertices.
        row = f if len(kappa) == len(face_offsets) - 1 else first - 2 * f + k - first - 1
        for q in range(len(weights)):
            at = min(q, kappa.shape[2] - 1)
            kappa_0, kappa_1 = kappa[row, 0, at], kappa[row, 1, at]
            mean = kappa_0 * (kappa_1 / (kappa_0 + kappa_1)) if inner else kappa_0
            weighted[q] = mean * weights[q] * size
        # 3. Integrals of the powers, once for both results. The unit normal points from the first cell of
        # the side to the second.
        local[:] = 0.0
        _add_triangle(a, b, c, weighted, frame, rule, powers, xi, local)
        if len(directions) > 0:
            _add_slanted(
                a, b, c, weighted, frame, rule, powers, xi, directions[row], turned, normals
            )  # fmt: skip
        else:
            size = -size if turned else size
            x, y, z = x / size, y / size, z / size
            for i in range(lower):
                normals[0, 0, i] += x * local[i]
                normals[0, 1, i] += y * local[i]
                normals[0, 2, i] += z * local[i]
        # γσ = 2σ · γ/2 inside; γ = κ at the boundary.
        factor = 2.0 * sigma if inner else sigma
        for i in range(len(local)):
            stiff[i] += factor * local[i]


@helper
def _gradients(normal, frame, lowered, powers, gradients):
    """Compute ``gradients[a, b]`` = ∫ γ/2 ξ^a ∂ξ^b/∂n from the moments ∫ γ/2 n ξ^α in ``normal``."""
    # ∂ξ^b/∂x_d = b_d / (half side) ξ^(b − e_d); lowered is the index of ξ^(a + b − e_d).
    for a in range(len(gradients)):
        for b in range(len(gradients)):
            value = 0.0
            for d in range(3):
                if powers[b, d] > 0:
                    value += powers[b, d] / frame[3 + d] * normal[d, lowered[a, b, d]]
            gradients[a, b] = value


@helper
def _transform_form(form, L, R, terms, workspace, product):
    """Compute (L form Rᵀ)ᵀ for sparse matrices L and R with entries at ``terms``.

    Both products add rows to rows, with L form transposed between them, so that all loops run along rows.
    """
    first, second = workspace[0], workspace[1]
    n = len(product)
    # 1. L form.
    first[:] = 0.0
    for t in range(len(terms)):
        i, a, value = terms[t, 0], terms[t, 1], L[t]
        for b in range(n):
            first[i, b] += value * form[a, b]
    # 2. Its transpose, multiplied by R.
    for i in range(n):
        for b in range(n):
            second[b, i] = first[i, b]
    product[:] = 0.0
    for t in range(len(terms)):
        j, b, value = terms[t, 0], terms[t, 1], R[t]
        for i in range(n):
            product[j, i] += value * second[b, i]


@helper
def _add_own(form, gradients, sign, sums, T, terms, workspace, block):
    """Add the bilinear form of a side, restricted to one cell, to the diagonal block of this cell.

    ``form`` contains the integrals of γσ ξ^powers; ``sign`` applies to the cell's values in the jump.
    """
    n, whole, product = len(block), workspace[2], workspace[3]
    # γσ ξ^a ξ^b ∓ γ/2 (ξ^a ∂ξ^b/∂n + ξ^b ∂ξ^a/∂n), then transformed to the polynomials of the cell.
    for a in range(n):
        for b in range(n):
            whole[a, b] = form[sums[a, b]] - sign * (gradients[a, b] + gradients[b, a])
    _transform_form(whole, T, T, terms, workspace, product)
    for i in range(n):
        for j in range(i):
            block[i, j] += product[i, j]
            block[j, i] += product[i, j]
        block[i, i] += product[i, i]


@kernel
def side_blocks(
    points, face_offsets, face_vertices, face_cells, vectors, side_offsets, side_faces, side_cells, sides,
    in_strip, slots, boxes, scale, sigma, kappa, directions, rule, weights, powers, sums, lowered, terms,
    blocks,
):  # fmt: skip
    """Add ∫ −{κ∇u·n}[v] − {κ∇v·n}[u] + γσ[u][v] over ``sides (k,)`` to the rows of ``in_strip`` cells.

    Each block ``(m, m)`` is stored in its row cell; ``slots (S, 2, 2)`` gives the block position for (owner
    or neighbour, owner or neighbour). ``kappa`` is the coefficient on both sides, per face ``(F, 2, 1)`` or
    per triangle point ``(t, 2, q)``; ``sigma (F,)`` the penalty without κ. Faces with σ = 0 are skipped.
    ``vectors (F, 3)`` are normals outward from the owners. For a tensor κ is n·κn per triangle, and
    ``directions (t, 2, 1 or q, 3)`` are κn / (n·κn). The tables come from ``monomials``.
    """
    n, degree = blocks.shape[1], powers[len(powers) - 1, 2] // 2
    table, lines = recurrences(degree), np.zeros((3, degree + 1, degree + 1))
    xi, frame, weighted = np.empty((3, 2 * degree + 1)), np.empty(6), np.empty(len(weights))
    local, stiff = np.empty(len(powers)), np.empty(len(powers))
    n_directions = 2 if len(directions) > 0 else 1
    normals = np.empty((n_directions, 3, len(powers) - (degree + 1) * (2 * degree + 1)))
    all_gradients = np.empty((n_directions, n, n))
    gradients, gradients_beyond = all_gradients[0], all_gradients[n_directions - 1]
    owner_T, neighbour_T, workspace = np.empty(len(terms)), np.empty(len(terms)), np.empty((4, n, n))
    for s in sides:
        owner, neighbour = side_cells[s, 0], side_cells[s, 1]
        # 1. Moments of the side in its frame: m_α = ∫ γσ ξ^α for |α| ≤ 2p in stiff, n_α = ∫ γ/2 n ξ^α for
        # |α| < 2p in normal. Only this step depends on the number of faces.
        _frame(owner, neighbour, boxes, frame)
        stiff[:] = 0.0
        normals[:] = 0.0
        for h in range(side_offsets[s], side_offsets[s + 1]):
            f = side_faces[h]
            if sigma[f] != 0.0:
                _add_face(
                    points, face_offsets, face_vertices, f, vectors[f], face_cells[f, 0] != owner, sigma[f],
                    kappa, directions, neighbour >= 0, frame, rule, weights, powers, xi, weighted, local,
                    stiff, normals,
                )  # fmt: skip
        # 2. Transform the form on the powers, Q, to the polynomials: T Q Tᵀ with the coefficients T of the
        # owner, then of the neighbour, whose values have the minus sign in the jump.
        for k in range(n_directions):
            _gradients(normals[k], frame, lowered, powers, all_gradients[k])
        _in_powers(boxes[owner], scale[owner], frame, table, powers, terms, lines, owner_T)
        if in_strip[owner]:
            _add_own(stiff, gradients, 1.0, sums, owner_T, terms, workspace, blocks[slots[s, 0, 0]])
        if neighbour < 0:
            continue
        _in_powers(boxes[neighbour], scale[neighbour], frame, table, powers, terms, lines, neighbour_T)
        if in_strip[neighbour]:
            _add_own(
                stiff, gradients_beyond, -1.0, sums, neighbour_T, terms, workspace, blocks[slots[s, 1, 1]]
            )
        # 3. The coupling: v of the neighbour and u of the owner, −γσ vu + γ/2 v ∂u/∂n − γ/2 u ∂v/∂n, and
        # its transpose.
        whole, product = workspace[2], workspace[3]
        for a in range(n):
            for b in range(n):
                whole[a, b] = gradients[a, b] - gradients_beyond[b, a] - stiff[sums[a, b]]
        _transform_form(whole, neighbour_T, owner_T, terms, workspace, product)
        for j in range(n):
            for i in range(n):
                if in_strip[neighbour]:
                    blocks[slots[s, 1, 0], i, j] += product[j, i]
                if in_strip[owner]:
                    blocks[slots[s, 0, 1], j, i] += product[j, i]
