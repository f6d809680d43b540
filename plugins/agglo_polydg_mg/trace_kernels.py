"""Kernel of the sharp penalty: how large normal derivatives on its faces a cell allows.

Either at once, whatever κ; or in two parts where κ is one number in each cell: what is geometry alone is
kept, and scaled by each κ.
"""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_polydg_mg.bound_kernels import SQUARINGS, complete, factorise, square
from agglo_polydg_mg.legendre_kernels import CONSTANT, LANES, along_box, recurrences

__all__ = ["scaled_penalties", "side_penalties", "whitened_forms"]

_RESOLVED = 1e-10  # of a pivot to its diagonal entry, times the share of its box a cell fills


@helper
def _normal_slopes(x, y, along_x, along_y, table, lines, slopes, q):
    """Normal derivatives of the polynomials but the constant at a point of the box, into ``slopes[q]``."""
    degree = table.shape[1]
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
def _whiten(slopes, q, factor, n):
    """Replace ``slopes[q]`` by L⁻¹ of it, L being a Cholesky factor with the inverses of its diagonal."""
    for i in range(n):
        value = slopes[q, i]
        for k in range(i):
            value -= factor[i, k] * slopes[q, k]
        slopes[q, i] = value * factor[i, i]


@helper
def _face_form(slopes, masses, n, forms, face):
    """Σ_q masses[q] y yᵀ with y = slopes[q] to ``forms[face]``: lower half, row by row, and trace."""
    trace, place = 0.0, 0
    for i in range(n):
        for j in range(i + 1):
            value = 0.0
            for q in range(len(masses)):
                value += masses[q] * slopes[q, i] * slopes[q, j]
            forms[face, place] = value
            place += 1
        trace += value
    forms[face, place] = trace


@helper
def _gather(forms, base, weights, start, first, last, n, whole, lanes, lane):
    """Σ_F weights[F] forms[F] over the faces of a cell, into a lane; ``whole`` is room for it."""
    place = 0
    for k in range(len(whole)):
        whole[k] = 0.0
    for h in range(first, last):
        form, weight = forms[h - base], weights[h - start]
        for k in range(len(whole)):
            whole[k] += form[k] * weight
    for i in range(n):
        for j in range(i + 1):
            lanes[i, j, lane] = whole[place]
            place += 1


@helper
def _spread(lanes, lane, n, whole):
    """The matrix in a lane to ``whole``, its lower half row by row: what multiplies a form to the trace."""
    place = 0
    for i in range(n):
        for j in range(i + 1):
            whole[place] = lanes[i, j, lane] if i == j else 2.0 * lanes[i, j, lane]
            place += 1


@helper(reorder_sums=True)
def _against(form, whole, size):
    """Trace of the product of a form and the matrix that is :func:`_spread`."""
    value = 0.0
    for k in range(size):
        value += form[k] * whole[k]
    return value


@helper(allocates=True)
def _balancing(most, n):
    """Where :func:`_balance` computes, for ``most`` faces: arrays by themselves, or loops are slow."""
    return (
        np.empty(most), np.empty(most), np.empty(most), np.empty((n, n, LANES)), np.empty((n, n, LANES)),
        np.empty((SQUARINGS, LANES)), np.empty(LANES), np.empty(LANES), np.empty(LANES),
        np.zeros(n * (n + 1) // 2 + 1),
    )  # fmt: skip


@helper
def _balance(
    offsets, faces, face_cells, first_cell, begin, end, forms, base, shares, lengths, n, rooms, asked
):  # fmt: skip
    """Write to ``asked (F, 2)`` what cells ``begin`` to ``end``, at most ``LANES``, ask of their faces.

    Faces ask in proportion to the sizes of their forms or, where that is less, to what the forms make of the
    sum of all. The form of face h of the list is ``forms[h - base]`` times ``shares[k]``, k counted from the
    first face of the first of these cells; a face with ``lengths[k]`` 0 asks for nothing.
    """
    first, second, inverse, lanes, scaled, traces, of_traces, uniform, balanced, whole = rooms
    start, last = offsets[begin], forms.shape[1] - 1
    lanes[:] = 0.0
    for c in range(begin, end):
        for h in range(offsets[c], offsets[c + 1]):
            k = h - start
            first[k] = inverse[k] = 0.0
            if lengths[k] > 0.0:
                first[k] = np.sqrt(forms[h - base, last] * shares[k] / lengths[k])
                inverse[k] = shares[k] / first[k] if first[k] > 0.0 else 0.0
        _gather(forms, base, inverse, start, offsets[c], offsets[c + 1], n, whole, lanes, c - begin)
    square(lanes, scaled, traces[0], of_traces)
    for c in range(begin, end):
        _spread(lanes, c - begin, n, whole)
        for h in range(offsets[c], offsets[c + 1]):
            k = h - start
            second[k] = inverse[k] = 0.0
            if first[k] > 0.0:
                spread = shares[k] * _against(forms[h - base], whole, last) / lengths[k]
                second[k] = traces[0, c - begin] * np.sqrt(max(0.0, spread))
                inverse[k] = shares[k] / second[k] if second[k] > 0.0 else 0.0
    complete(lanes, scaled, traces, of_traces, uniform)
    lanes[:] = 0.0
    for c in range(begin, end):
        _gather(forms, base, inverse, start, offsets[c], offsets[c + 1], n, whole, lanes, c - begin)
    square(lanes, scaled, traces[0], of_traces)
    complete(lanes, scaled, traces, of_traces, balanced)
    for c in range(begin, end):
        before, after, lane = 0.0, 0.0, c - begin
        for k in range(offsets[c] - start, offsets[c + 1] - start):
            before += lengths[k] * uniform[lane] * first[k]
            after += lengths[k] * balanced[lane] * second[k]
        for k in range(offsets[c] - start, offsets[c + 1] - start):
            f = faces[start + k]
            side = 0 if face_cells[f, 0] == first_cell + c else 1
            own, other = uniform[lane] * first[k], balanced[lane] * second[k]
            asked[f, side] = other if after < before else own


@helper
def _most_faces(offsets):
    """Faces of ``LANES`` cells in a row, at most."""
    n_cells, most = len(offsets) - 1, 0
    for begin in range(0, n_cells, LANES):
        most = max(most, offsets[min(begin + LANES, n_cells)] - offsets[begin])
    return most


@helper(allocates=True)
def _tracing(rules, degree, n):
    """Where :func:`_trace` computes, and the recurrences of its polynomials."""
    return (
        recurrences(degree), np.empty((4, degree + 1)), np.empty((rules, n)), np.empty(rules),
        np.empty((n, n)),
    )  # fmt: skip


@helper
def _trace(
    points, offsets, faces, face_vertices, face_cells, first_cell, begin, end, held, boxes, scale, fill,
    blocks, kappa, nodes, weights, n, rooms, forms, base, lengths, resolved,
):  # fmt: skip
    """Write the form of each face h of cells ``begin`` to ``end`` to ``forms[h - base]``.

    ``lengths`` are those of the faces, counted from the first; 0 where there is no form.
    """
    table, lines, slopes, masses, factor = rooms
    start = offsets[begin]
    for c in range(begin, end):
        for i in range(n):
            for j in range(i + 1):
                factor[i, j] = blocks[c, i + 1, j + 1]
        resolved[c] = factorise(factor, n, _RESOLVED / fill[c])
        for h in range(offsets[c], offsets[c + 1]):
            f, k = faces[h], h - start
            lengths[k] = 0.0
            if not (resolved[c] and held[f]):
                continue
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
            for q in range(len(nodes)):
                at = min(q, kappa.shape[2] - 1)
                own, across = kappa[f, side, at], kappa[f, 1 - side, at]
                share = own if face_cells[f, 1] < 0 else 0.5 * own * (across / (own + across))
                masses[q] = 0.5 * weights[q] * length * share
                s = 0.5 * (1.0 + nodes[q])
                x, y = ax + s * ex * wide, ay + s * ey * high
                _normal_slopes(x, y, along_x, along_y, table, lines, slopes, q)
                _whiten(slopes, q, factor, n)
            lengths[k] = length
            _face_form(slopes, masses, n, forms, h - base)


@kernel
def side_penalties(
    points, offsets, faces, face_vertices, face_cells, first_cell, held, boxes, scale, fill, blocks, kappa,
    nodes, weights, degree, asked,
):  # fmt: skip
    """Write to ``asked (F, 2)`` what cells ``first_cell``, ... ask of the penalty of their faces; who can.

    With S the stiffness ``blocks (n, m, m)`` without the constant and T_F = ∫_F c ∂v/∂n ∂w/∂n, c = ωκ/2
    inside and κ at the boundary, ω the weight of the cell in the average: Σ_F T_F / s_F <= S. The
    result is False for cells whose S is singular to rounding: nothing is said of them. Faces that are not
    ``held`` have no penalty. ``fill (n,)`` is the part of its bounding box a cell fills.
    """
    n, n_cells, most = (degree + 1) * (degree + 2) // 2 - 1, len(offsets) - 1, _most_faces(offsets)
    resolved, forms = np.ones(n_cells, np.bool_), np.zeros((most, (n * (n + 1)) // 2 + 1))
    lengths, shares = np.empty(most), np.ones(most)
    tracing, balancing = _tracing(len(nodes), degree, n), _balancing(most, n)
    for begin in range(0, n_cells, LANES):
        end, start = min(begin + LANES, n_cells), offsets[begin]
        _trace(
            points, offsets, faces, face_vertices, face_cells, first_cell, begin, end, held, boxes, scale,
            fill, blocks, kappa, nodes, weights, n, tracing, forms, start, lengths, resolved,
        )  # fmt: skip
        _balance(
            offsets, faces, face_cells, first_cell, begin, end, forms, start, shares, lengths, n, balancing,
            asked,
        )  # fmt: skip
    return resolved


@kernel
def whitened_forms(
    points, offsets, faces, face_vertices, face_cells, first_cell, held, boxes, scale, fill, blocks, kappa,
    nodes, weights, degree, forms,
):  # fmt: skip
    """Write to ``forms (h, k)`` those :func:`side_penalties` makes, with the same result.

    T_F of each face h of the list, whitened by the stiffness: the lower half, row by row, and its trace.
    """
    n, n_cells, most = (degree + 1) * (degree + 2) // 2 - 1, len(offsets) - 1, _most_faces(offsets)
    resolved, lengths, rooms = np.ones(n_cells, np.bool_), np.empty(most), _tracing(len(nodes), degree, n)
    for begin in range(0, n_cells, LANES):
        end = min(begin + LANES, n_cells)
        _trace(
            points, offsets, faces, face_vertices, face_cells, first_cell, begin, end, held, boxes, scale,
            fill, blocks, kappa, nodes, weights, n, rooms, forms, 0, lengths, resolved,
        )  # fmt: skip
    return resolved


@kernel
def scaled_penalties(
    offsets, faces, face_cells, first_cell, held, face_lengths, kappa, forms, resolved, degree, asked
):  # fmt: skip
    """As :func:`side_penalties`, of :func:`whitened_forms` for c = κ = 1, with ``kappa (n,)``."""
    n, n_cells, most = (degree + 1) * (degree + 2) // 2 - 1, len(offsets) - 1, _most_faces(offsets)
    lengths, shares, rooms = np.empty(most), np.empty(most), _balancing(most, n)
    for begin in range(0, n_cells, LANES):
        end, start = min(begin + LANES, n_cells), offsets[begin]
        for c in range(begin, end):
            cell = first_cell + c
            for h in range(offsets[c], offsets[c + 1]):
                f, k = faces[h], h - start
                other = face_cells[f, 0] + face_cells[f, 1] - cell
                lengths[k] = face_lengths[f] if resolved[cell] and held[f] else 0.0
                shares[k] = 1.0
                if other >= 0:
                    shares[k] = 0.5 * kappa[other] / (kappa[cell] + kappa[other])
        _balance(
            offsets, faces, face_cells, first_cell, begin, end, forms, 0, shares, lengths, n, rooms, asked
        )
