"""Kernel for the sharp penalty in 3-D: the trace inverse inequality on each side of each cell."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_polydg_mg.forms.form_kernels import balance, balance_workspace, factorise, most_faces, whiten
from agglo_polydg_mg.forms.trace_kernels import RESOLVED
from agglo_polydg_mg.space.legendre_kernels import LANES, legendre_at, recurrences, slopes_of
from agglo_polydg_mg.space.solid_kernels import oriented_triangle


@helper
def _normal_slopes(x, y, z, normal, table, lines, orders, slopes):
    """Compute the derivatives along ``normal`` of all nonconstant polynomials at a point of the box.

    ``normal (3,)`` are the coefficients of ∂/∂x̂, ∂/∂ŷ, ∂/∂ẑ; the result is ``slopes[0]``.
    """
    degree = table.shape[1]
    lx, ly, lz, dx, dy, dz = lines[0], lines[1], lines[2], lines[3], lines[4], lines[5]
    legendre_at(x, degree, table, lx)
    legendre_at(y, degree, table, ly)
    legendre_at(z, degree, table, lz)
    slopes_of(lx, table, dx)
    slopes_of(ly, table, dy)
    slopes_of(lz, table, dz)
    for k in range(1, len(orders)):
        i, j, m = orders[k, 0], orders[k, 1], orders[k, 2]
        value = normal[0] * dx[i] * ly[j] * lz[m] + normal[1] * lx[i] * dy[j] * lz[m]
        slopes[0, k - 1] = value + normal[2] * lx[i] * ly[j] * dz[m]


@helper
def _add_form(slopes, mass, n, form):
    """Add ``mass`` y yᵀ, with y = slopes[0], to a matrix stored as its lower half and trace."""
    place, last = 0, len(form) - 1
    for i in range(n):
        value = mass * slopes[0, i]
        for j in range(i + 1):
            form[place] += value * slopes[0, j]
            place += 1
        form[last] += value * slopes[0, i]


@helper
def _trace_face(
    points, face_offsets, face_vertices, f, vector, side, outer, kappa, directions, rule, weights, orders,
    box, scale, factor, workspace, form,
):  # fmt: skip
    """Add the matrix L⁻¹ T_F L⁻ᵀ of a face to that of its side, and return the face area.

    T_F is ∫_F c ∂v/∂n ∂w/∂n, as in ``side_penalties`` of ``trace_kernels``. L is the Cholesky ``factor`` of
    the cell stiffness; the face is a fan of triangles about its first vertex, ``vector (3,)`` its normal
    outward from the owner.
    """
    table, lines, slopes, normal = workspace[0], workspace[1], workspace[2], workspace[3]
    first, area, n = face_offsets[f], 0.0, len(orders) - 1
    a = points[face_vertices[first]]
    for k in range(first + 1, face_offsets[f + 1] - 1):
        b, c = points[face_vertices[k]], points[face_vertices[k + 1]]
        # 1. Normal of the triangle, and the derivative along the unit normal in box coordinates. Its sign
        # does not matter.
        x, y, z, size = oriented_triangle(a, b, c, vector)
        if size == 0.0:
            continue
        area += 0.5 * size
        normal[0], normal[1] = scale * x / size / box[3], scale * y / size / box[4]
        normal[2] = scale * z / size / box[5]
        # 2. y = L⁻¹ ∂φ/∂n at the points of the triangle, with the weights of T_F: c = ωκ/2 inside, κ at the
        # boundary. Triangles are numbered through all faces: each face before f has two triangles fewer
        # than vertices.
        row = f if len(kappa) == len(face_offsets) - 1 else first - 2 * f + k - first - 1
        for q in range(len(weights)):
            at = min(q, kappa.shape[2] - 1)
            kappa_0, kappa_1 = kappa[row, side, at], kappa[row, 1 - side, at]
            share = kappa_0 if outer else 0.5 * kappa_0 * (kappa_1 / (kappa_0 + kappa_1))
            s, t = rule[q, 0], rule[q, 1]
            if len(directions) > 0:
                direction = directions[row, side, min(q, directions.shape[2] - 1)]
                for axis in range(3):
                    normal[axis] = scale * direction[axis] / box[3 + axis]
            _normal_slopes(
                (a[0] + s * (b[0] - a[0]) + t * (c[0] - a[0]) - box[0]) / box[3],
                (a[1] + s * (b[1] - a[1]) + t * (c[1] - a[1]) - box[1]) / box[4],
                (a[2] + s * (b[2] - a[2]) + t * (c[2] - a[2]) - box[2]) / box[5],
                normal, table, lines, orders, slopes,
            )  # fmt: skip
            whiten(slopes, 0, factor, n)
            _add_form(slopes, share * weights[q] * size, n, form)
    return area


@kernel
def solid_penalties(
    points, face_offsets, face_vertices, face_cells, vectors, side_offsets, side_faces, side_cells, offsets,
    cell_sides, first_cell, boxes, scale, fill, blocks, penalised, kappa, directions, rule, weights, orders,
    penalties,
):  # fmt: skip
    """Compute the ``penalties (S, 2)`` that cells from ``first_cell`` on require on their sides.

    As in ``side_penalties`` of ``trace_kernels``, but all faces of a side have one s; only ``penalised``
    faces count. ``kappa`` is the coefficient on both sides, per face ``(F, 2, 1)`` or per triangle point
    ``(t, 2, q)``; ``vectors (F, 3)`` are normals outward from the owners. For a tensor
    κ is n·κn, and ``directions (t, 2, 1 or q, 3)`` are κn / (n·κn).
    """
    n, n_cells, most = len(orders) - 1, len(offsets) - 1, most_faces(offsets)
    degree = orders[len(orders) - 1, 2]
    resolved, forms = np.ones(n_cells, np.bool_), np.zeros((most, (n * (n + 1)) // 2 + 1))
    areas, factor, workspace = np.empty(most), np.empty((n, n)), balance_workspace(most, n)
    tracing = recurrences(degree), np.empty((6, degree + 1)), np.empty((1, n)), np.empty(3)
    for begin in range(0, n_cells, LANES):
        end, start = min(begin + LANES, n_cells), offsets[begin]
        for c in range(begin, end):
            # 1. S = L Lᵀ, the stiffness without the constant. If a pivot is rounding the cell is
            # unresolved: its sides get no forms.
            for i in range(n):
                for j in range(i + 1):
                    factor[i, j] = blocks[c, i + 1, j + 1]
            resolved[c] = factorise(factor, n, RESOLVED / fill[c])
            # 2. The form of each side, summed over its faces, and its area.
            for h in range(offsets[c], offsets[c + 1]):
                s, k = cell_sides[h], h - start
                areas[k] = 0.0
                forms[k, :] = 0.0
                for at in range(side_offsets[s], side_offsets[s + 1] if resolved[c] else 0):
                    f = side_faces[at]
                    if not penalised[f]:
                        continue
                    side = 0 if face_cells[f, 0] == first_cell + c else 1
                    areas[k] += _trace_face(
                        points, face_offsets, face_vertices, f, vectors[f], side, side_cells[s, 1] < 0, kappa,
                        directions, rule, weights, orders, boxes[c], scale[c], factor, tracing, forms[k],
                    )  # fmt: skip
        # 3. s_F for all sides of these cells.
        balance(
            offsets, cell_sides, side_cells, first_cell, begin, end, forms, areas, n, workspace, penalties
        )
    return resolved
