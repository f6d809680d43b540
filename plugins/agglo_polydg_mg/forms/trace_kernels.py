"""Kernels for the sharp penalty in 2-D: the trace inverse inequality of each cell."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_polydg_mg.forms.form_kernels import balance, balance_workspace, factorise, most_faces, whiten
from agglo_polydg_mg.space.legendre_kernels import CONSTANT, LANES, along_box, recurrences

# Ratio of a Cholesky pivot to its diagonal entry, times the cell's fraction of its box, below which the
# stiffness of a cell counts as singular. A smaller value lets rounding decide the penalty, a larger value
# gives more cells the safe triangle constants, which are larger than necessary.
RESOLVED = 1e-10


@helper
def _normal_slopes(x, y, along_x, along_y, table, lines, slopes, q):
    """Write normal derivatives of all nonconstant polynomials at a point of the box to ``slopes[q]``.

    ``along_x`` and ``along_y`` are the coefficients of ∂/∂x̂ and ∂/∂ŷ; ``lines (4, degree + 1)`` is
    workspace for the polynomials in x̂ and ŷ, then their derivatives.
    """
    degree = table.shape[1]
    # L_k and L'_k along both axes, by the recurrences in a, b and c, d.
    for axis in range(2):
        at, value, slope, before, below = (x, y)[axis], CONSTANT, 0.0, 0.0, 0.0
        lines[axis, 0], lines[2 + axis, 0] = value, slope
        for k in range(degree):
            slope, below = table[2, k] * below + table[3, k] * value, slope
            value, before = table[0, k] * at * value - table[1, k] * before, value
            lines[axis, k + 1], lines[2 + axis, k + 1] = value, slope
    k = 0
    for total in range(1, degree + 1):
        for j in range(total + 1):
            i = total - j
            slopes[q, k] = along_x * lines[2, i] * lines[1, j] + along_y * lines[0, i] * lines[3, j]
            k += 1


@helper
def _face_form(slopes, masses, n, form):
    """Write Σ_q masses[q] y yᵀ, with y = slopes[q], to ``form`` as its lower half and trace."""
    trace, place = 0.0, 0
    for i in range(n):
        for j in range(i + 1):
            value = 0.0
            for q in range(len(masses)):
                value += masses[q] * slopes[q, i] * slopes[q, j]
            form[place] = value
            place += 1
        trace += value
    form[place] = trace


@helper(allocates=True)
def _trace_workspace(rules, degree, n):
    """Allocate the workspace of :func:`_trace`, with its polynomial recurrences."""
    return (
        recurrences(degree), np.empty((4, degree + 1)), np.empty((rules, n)), np.empty(rules),
        np.empty((n, n)),
    )  # fmt: skip


@helper
def _trace(
    points, offsets, faces, face_vertices, face_cells, first_cell, begin, end, penalised, boxes, scale, fill,
    blocks, kappa, directions, nodes, weights, n, workspace, forms, lengths, resolved,
):  # fmt: skip
    """Compute the matrix of the trace inequality on each face of the cells ``begin`` to ``end``.

    The results ``forms`` are counted from the first face of these cells. They are L⁻¹ T_F L⁻ᵀ with the
    Cholesky factor L of the stiffness S without the constant, for which T_F is 0. ``lengths`` receives the
    face lengths; 0 for faces without form.
    """
    table, lines, slopes, masses, factor = workspace
    start = offsets[begin]
    for c in range(begin, end):
        # 1. S = L Lᵀ. If a pivot is rounding the cell is unresolved.
        for i in range(n):
            for j in range(i + 1):
                factor[i, j] = blocks[c, i + 1, j + 1]
        resolved[c] = factorise(factor, n, RESOLVED / fill[c])
        for h in range(offsets[c], offsets[c + 1]):
            f, k = faces[h], h - start
            lengths[k] = 0.0
            if not (resolved[c] and penalised[f]):
                continue
            # 2. Map the face to the box [−1, 1]² of the cell: its first vertex, the step to the second, and
            # the normal derivative as a combination of ∂/∂x̂ and ∂/∂ŷ. Its sign does not matter.
            a, b = face_vertices[f, 0], face_vertices[f, 1]
            ex, ey = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
            length = np.sqrt(ex * ex + ey * ey)
            if not length > 0.0:
                continue
            wide, high = 1.0 / boxes[c, 2], 1.0 / boxes[c, 3]
            ex, ey = along_box(ex, ey, boxes[c])
            ax, ay = along_box(points[a, 0] - boxes[c, 0], points[a, 1] - boxes[c, 1], boxes[c])
            along_x, along_y = scale[c] * ey / length * wide, -scale[c] * ex / length * high
            ax, ay = ax * wide, ay * high
            side = 0 if face_cells[f, 0] == first_cell + c else 1
            # 3. y = L⁻¹ ∂φ/∂n at the Gauss points, and the weights of T_F = ∫_F c ∂φ/∂n (∂φ/∂n)ᵀ: c = ωκ/2
            #    inside, ωκ = κ κ' / (κ + κ'), and κ at the boundary.
            for q in range(len(nodes)):
                at = min(q, kappa.shape[2] - 1)
                kappa_0, kappa_1 = kappa[f, side, at], kappa[f, 1 - side, at]
                share = kappa_0 if face_cells[f, 1] < 0 else 0.5 * kappa_0 * (kappa_1 / (kappa_0 + kappa_1))
                masses[q] = 0.5 * weights[q] * length * share
                s = 0.5 * (1.0 + nodes[q])
                x, y = ax + s * ex * wide, ay + s * ey * high
                if len(directions) > 0:
                    direction = directions[f, side, min(q, directions.shape[2] - 1)]
                    tx, ty = along_box(direction[0], direction[1], boxes[c])
                    along_x, along_y = scale[c] * tx * wide, scale[c] * ty * high
                _normal_slopes(x, y, along_x, along_y, table, lines, slopes, q)
                whiten(slopes, q, factor, n)
            lengths[k] = length
            _face_form(slopes, masses, n, forms[k])


@kernel
def side_penalties(
    points, offsets, faces, face_vertices, face_cells, first_cell, penalised, boxes, scale, fill, blocks,
    kappa, directions, nodes, weights, degree, penalties,
):  # fmt: skip
    """Compute the ``penalties (F, 2)`` that cells from ``first_cell`` on require on their faces.

    With S the stiffness ``blocks (n, m, m)`` without the constant and T_F = ∫_F c ∂v/∂n ∂w/∂n, c = ωκ/2
    inside and κ at the boundary, ω the cell's weight in the average, the penalties s_F satisfy Σ_F T_F /
    s_F <= S. The result ``(n,)`` is False for cells whose S is singular to rounding: they require nothing.
    Only ``penalised`` faces have a penalty. ``fill (n,)`` is the fraction of its bounding box that a cell
    fills; ``kappa (F, 2, 1 or q)`` the coefficient on both sides, ``nodes`` and ``weights (q,)`` a Gauss
    rule. For a tensor κ is n·κn, and derivatives are along ``directions (F, 2, 1 or q, 2)`` κn / (n·κn).
    """
    n, n_cells, most = (degree + 1) * (degree + 2) // 2 - 1, len(offsets) - 1, most_faces(offsets)
    resolved, forms = np.ones(n_cells, np.bool_), np.zeros((most, (n * (n + 1)) // 2 + 1))
    lengths = np.empty(most)
    tracing, workspace = _trace_workspace(len(nodes), degree, n), balance_workspace(most, n)
    # One batch of cells at a time: their forms, then the required penalties.
    for begin in range(0, n_cells, LANES):
        end = min(begin + LANES, n_cells)
        _trace(
            points, offsets, faces, face_vertices, face_cells, first_cell, begin, end, penalised, boxes,
            scale, fill, blocks, kappa, directions, nodes, weights, n, tracing, forms, lengths, resolved,
        )  # fmt: skip
        balance(offsets, faces, face_cells, first_cell, begin, end, forms, lengths, n, workspace, penalties)
    return resolved
