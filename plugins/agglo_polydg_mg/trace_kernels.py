"""Kernel of the sharp penalty: how large normal derivatives on its faces a cell allows.

Cells are taken ``LANES`` at a time, so that the powers of their matrices are computed side by side: the
matrices themselves are too small for fast loops.
"""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_polydg_mg.legendre_kernels import CONSTANT, LANES, along_box, recurrences

__all__ = ["largest_bounds", "side_penalties"]

_SQUARINGS = 5  # the bound exceeds the eigenvalue by n^(1/64) at most: 5 % for n = 27, 1 % for n = 2
_RESOLVED = 1e-10  # of a pivot to its diagonal entry, times the share of its box a cell fills


@helper
def _factorise(matrix, n, tolerance):
    """Cholesky factor in place, in the lower half, its diagonal inverted; False where a pivot is rounding."""
    for j in range(n):
        diagonal = matrix[j, j]
        pivot = diagonal
        for k in range(j):
            pivot -= matrix[j, k] * matrix[j, k]
        if not pivot > tolerance * diagonal:
            return False
        matrix[j, j] = 1.0 / np.sqrt(pivot)
        for i in range(j + 1, n):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = value * matrix[j, j]
    return True


@helper
def _square(lanes, scaled, traces):
    """Divide symmetric matrices by their ``traces``, which come out, and square them: the lower halves."""
    n = len(lanes)
    for lane in range(LANES):
        traces[lane] = 0.0
    for i in range(n):
        for lane in range(LANES):
            traces[lane] += lanes[i, i, lane]
    for i in range(n):
        for j in range(i + 1):
            for lane in range(LANES):
                shrink = 1.0 / traces[lane] if traces[lane] > 0.0 else 0.0
                scaled[i, j, lane] = scaled[j, i, lane] = shrink * lanes[i, j, lane]
    for i in range(n):
        for j in range(i + 1):
            out, left, right = lanes[i, j], scaled[i], scaled[j]
            for lane in range(LANES):
                out[lane] = 0.0
            for k in range(0, n - 3, 4):  # by fours: sums stay in registers
                for lane in range(LANES):
                    out[lane] += (
                        left[k, lane] * right[k, lane]
                        + left[k + 1, lane] * right[k + 1, lane]
                        + left[k + 2, lane] * right[k + 2, lane]
                        + left[k + 3, lane] * right[k + 3, lane]
                    )
            for k in range(n - n % 4, n):
                for lane in range(LANES):
                    out[lane] += left[k, lane] * right[k, lane]


@helper
def _complete(lanes, scaled, traces, bounds):
    """The ``bounds`` from matrices that have been squared once and their first ``traces``."""
    for step in range(1, _SQUARINGS):
        _square(lanes, scaled, traces[step])
    for lane in range(LANES):
        bounds[lane] = 0.0
    for i in range(len(lanes)):
        for j in range(i + 1):
            twice = 1.0 if i == j else 2.0
            for lane in range(LANES):
                bounds[lane] += twice * lanes[i, j, lane] * lanes[i, j, lane]
    for lane in range(LANES):
        bound = np.sqrt(bounds[lane])
        for step in range(_SQUARINGS - 1, -1, -1):
            bound = traces[step, lane] * np.sqrt(bound)
        bounds[lane] = bound


@kernel
def largest_bounds(lanes, bounds):
    """Upper ``bounds (LANES,)`` of the largest eigenvalues of symmetric positive semidefinite matrices.

    λ^(2^k) is an eigenvalue of the 2^k-th power, and none of these exceeds its Frobenius norm. ``lanes``
    holds the lower halves ``(n, n, LANES)`` and is overwritten.
    """
    scaled, traces = np.empty(lanes.shape), np.empty((_SQUARINGS, LANES))
    _square(lanes, scaled, traces[0])
    _complete(lanes, scaled, traces, bounds)


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
    """Σ_q masses[q] y yᵀ with y = slopes[q]: the lower half, row by row, to ``forms[face]``; its trace."""
    trace, place = 0.0, 0
    for i in range(n):
        for j in range(i + 1):
            value = 0.0
            for q in range(len(masses)):
                value += masses[q] * slopes[q, i] * slopes[q, j]
            forms[face, place] = value
            place += 1
        trace += value
    return trace


@helper
def _gather(forms, shares, first, last, n, lanes, lane):
    """Σ_F shares[F] forms[F] over the faces of a cell, into a lane."""
    place = 0
    for i in range(n):
        for j in range(i + 1):
            value = 0.0
            for h in range(first, last):
                value += forms[h, place] * shares[h]
            lanes[i, j, lane] = value
            place += 1


@helper
def _against(forms, face, n, lanes, lane):
    """Trace of the product of a form and the matrix in a lane."""
    value, place = 0.0, 0
    for i in range(n):
        for j in range(i):
            value += 2.0 * forms[face, place] * lanes[i, j, lane]
            place += 1
        value += forms[face, place] * lanes[i, i, lane]
        place += 1
    return value


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
    n, n_cells, rules, most = (degree + 1) * (degree + 2) // 2 - 1, len(offsets) - 1, len(nodes), 0
    for begin in range(0, n_cells, LANES):
        most = max(most, offsets[min(begin + LANES, n_cells)] - offsets[begin])
    table, lines = recurrences(degree), np.empty((4, degree + 1))
    resolved = np.ones(n_cells, np.bool_)
    forms, lengths = np.zeros((most, (n * (n + 1)) // 2)), np.empty(most)
    first, second, inverse = np.empty(most), np.empty(most), np.empty(most)
    slopes, masses, factor = np.empty((rules, n)), np.empty(rules), np.empty((n, n))
    lanes, scaled = np.empty((n, n, LANES)), np.empty((n, n, LANES))
    traces, uniform, balanced = np.empty((_SQUARINGS, LANES)), np.empty(LANES), np.empty(LANES)
    for begin in range(0, n_cells, LANES):
        end, start = min(begin + LANES, n_cells), offsets[begin]
        lanes[:] = 0.0
        for c in range(begin, end):
            for i in range(n):
                for j in range(i + 1):
                    factor[i, j] = blocks[c, i + 1, j + 1]
            resolved[c] = _factorise(factor, n, _RESOLVED / fill[c])
            for h in range(offsets[c], offsets[c + 1]):
                f, k = faces[h], h - start
                first[k] = lengths[k] = inverse[k] = 0.0
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
                for q in range(rules):
                    at = min(q, kappa.shape[2] - 1)
                    own, across = kappa[f, side, at], kappa[f, 1 - side, at]
                    share = own if face_cells[f, 1] < 0 else 0.5 * own * (across / (own + across))
                    masses[q] = 0.5 * weights[q] * length * share
                    s = 0.5 * (1.0 + nodes[q])
                    x, y = ax + s * ex * wide, ay + s * ey * high
                    _normal_slopes(x, y, along_x, along_y, table, lines, slopes, q)
                    _whiten(slopes, q, factor, n)
                lengths[k] = length
                first[k] = np.sqrt(_face_form(slopes, masses, n, forms, k) / length)
                inverse[k] = 1.0 / first[k] if first[k] > 0.0 else 0.0
            _gather(forms, inverse, offsets[c] - start, offsets[c + 1] - start, n, lanes, c - begin)
        _square(lanes, scaled, traces[0])
        for c in range(begin, end):
            for k in range(offsets[c] - start, offsets[c + 1] - start):
                second[k] = inverse[k] = 0.0
                if first[k] > 0.0:
                    spread = _against(forms, k, n, lanes, c - begin) / lengths[k]
                    second[k] = traces[0, c - begin] * np.sqrt(max(0.0, spread))
                    inverse[k] = 1.0 / second[k] if second[k] > 0.0 else 0.0
        _complete(lanes, scaled, traces, uniform)
        lanes[:] = 0.0
        for c in range(begin, end):
            _gather(forms, inverse, offsets[c] - start, offsets[c + 1] - start, n, lanes, c - begin)
        _square(lanes, scaled, traces[0])
        _complete(lanes, scaled, traces, balanced)
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
    return resolved
