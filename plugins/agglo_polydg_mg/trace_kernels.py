"""Kernel of the sharp penalty: how large normal derivatives on its faces a cell allows."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import kernel
from agglo_polydg_mg.legendre_kernels import legendre_at, roots_up_to, slopes_of

__all__ = ["largest_bound", "side_penalties"]

_SQUARINGS = 5  # the bound exceeds the eigenvalue by n^(1/64) at most: 5 % for n = 27, 1 % for n = 2
_RESOLVED = 1e-10  # of a pivot to its diagonal entry, times the share of its box a cell fills


@kernel
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


@kernel
def largest_bound(matrix, n, square, other):
    """Upper bound of the largest eigenvalue of a symmetric positive semidefinite matrix.

    λ^(2^k) is an eigenvalue of the 2^k-th power, and none of these exceeds its Frobenius norm. ``matrix``,
    ``square`` and ``other`` are ``(n, n)``; the latter two are overwritten.
    """
    bound, exponent = 1.0, 1.0
    for i in range(n):
        for j in range(n):
            square[i, j] = matrix[i, j]
    for step in range(_SQUARINGS + 1):
        trace, norm = 0.0, 0.0
        for i in range(n):
            trace += square[i, i]
            for j in range(n):
                norm += square[i, j] * square[i, j]
        if step == _SQUARINGS:
            return bound * np.sqrt(norm) ** exponent
        if not trace > 0.0:
            return 0.0
        bound *= trace**exponent
        exponent *= 0.5
        shrink = 1.0 / trace
        for i in range(n):
            for j in range(n):
                other[i, j] = shrink * square[i, j]
        for i in range(n):
            for j in range(i + 1):
                value = 0.0
                for k in range(n):
                    value += other[i, k] * other[j, k]
                square[i, j] = square[j, i] = value
    return bound


@kernel
def _whitened_slopes(x, y, normal, box, scale, degree, roots, lines, factor, out):
    """L⁻¹ of the normal derivatives of the polynomials but the constant, L being a Cholesky factor."""
    lx, ly, dx, dy = lines[0], lines[1], lines[2], lines[3]
    legendre_at((x - box[0]) / box[2], degree, roots, lx)
    legendre_at((y - box[1]) / box[3], degree, roots, ly)
    slopes_of(lx, degree, roots, dx)
    slopes_of(ly, degree, roots, dy)
    along_x, along_y = scale * normal[0] / box[2], scale * normal[1] / box[3]
    for j in range(degree + 1):
        first, second = along_x * ly[j], along_y * dy[j]
        for i in range(degree + 1 - j):
            k = ((i + j) * (i + j + 1)) // 2 + j
            if k > 0:
                out[k - 1] = first * dx[i] + second * lx[i]
    for k in range(len(out)):  # the factor holds the inverses of its diagonal
        value = out[k] * factor[k, k]
        out[k] = value
        for i in range(k + 1, len(out)):
            out[i] -= factor[i, k] * value


@kernel
def _gather(slopes, masses, shares, n_faces, n, out):
    """Σ_F Σ_q masses[F, q] y yᵀ / shares[F] with y = slopes[F, q]: symmetric, ``(n, n)``."""
    for i in range(n):
        for j in range(n):
            out[i, j] = 0.0
    for f in range(n_faces):
        if not shares[f] > 0.0:
            continue
        for q in range(masses.shape[1]):
            weight = masses[f, q] / shares[f]
            for i in range(n):
                left = weight * slopes[f, q, i]
                for j in range(i + 1):
                    out[i, j] += left * slopes[f, q, j]
    for i in range(n):
        for j in range(i):
            out[j, i] = out[i, j]


@kernel
def _shares(slopes, masses, lengths, metric, n_faces, n, out):
    """Root of the mean of ‖metric y‖² over each face, y = slopes[F, q]; the metric may be absent, (0, 0)."""
    for f in range(n_faces):
        out[f], total = 0.0, 0.0
        if not lengths[f] > 0.0:
            continue
        for q in range(masses.shape[1]):
            for i in range(n):
                value = 0.0
                if len(metric) == 0:
                    value = slopes[f, q, i]
                else:
                    for j in range(n):
                        value += metric[i, j] * slopes[f, q, j]
                total += masses[f, q] * value * value
        out[f] = np.sqrt(total / lengths[f])


@kernel
def side_penalties(
    points,
    offsets,
    faces,
    face_vertices,
    face_cells,
    held,
    boxes,
    scale,
    fill,
    blocks,
    kappa,
    nodes,
    weights,
    degree,
):
    """What each cell asks of the penalty of its faces, ``(F, 2)`` for owner and neighbour, and where it can.

    With S the stiffness ``blocks (n, m, m)`` without the constant and T_F = ∫_F c ∂v/∂n ∂w/∂n, c = ωκ/2
    inside and κ at the boundary, ω the weight of the cell in the average: Σ_F T_F / s_F <= S. The second
    result is False for cells whose S is singular to rounding: nothing is said of them. Faces that are not
    ``held`` have no penalty. ``fill (n,)`` is the part of its bounding box a cell fills.
    """
    n, most, rules = (degree + 1) * (degree + 2) // 2 - 1, 0, len(nodes)
    for c in range(len(offsets) - 1):
        most = max(most, offsets[c + 1] - offsets[c])
    asked, resolved = np.zeros((len(face_cells), 2)), np.ones(len(offsets) - 1, np.bool_)
    slopes, masses, lengths = np.empty((most, rules, n)), np.empty((most, rules)), np.empty(most)
    first, second, lines, normal = np.empty(most), np.empty(most), np.empty((4, degree + 1)), np.empty(2)
    factor, sums, square, other = np.empty((n, n)), np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    roots, nothing = roots_up_to(degree), np.empty((0, 0))
    for c in range(len(offsets) - 1):
        count = 0
        for i in range(n):
            for j in range(n):
                factor[i, j] = blocks[c, i + 1, j + 1]
        if not _factorise(factor, n, _RESOLVED / fill[c]):
            resolved[c] = False
            continue
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            a, b = face_vertices[f, 0], face_vertices[f, 1]
            ex, ey = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
            length = np.sqrt(ex * ex + ey * ey)
            lengths[count] = length if held[f] else 0.0
            normal[0], normal[1] = ey / length, -ex / length
            side = 0 if face_cells[f, 0] == c else 1
            for q in range(rules):
                at = min(q, kappa.shape[2] - 1)
                own, across = kappa[f, side, at], kappa[f, 1 - side, at]
                share = own if face_cells[f, 1] < 0 else 0.5 * own * (across / (own + across))
                masses[count, q] = 0.5 * weights[q] * lengths[count] * share
                if lengths[count] > 0.0:
                    s = 0.5 * (1.0 + nodes[q])
                    x, y = points[a, 0] + s * ex, points[a, 1] + s * ey
                    _whitened_slopes(
                        x, y, normal, boxes[c], scale[c], degree, roots, lines, factor, slopes[count, q]
                    )
            count += 1
        _shares(slopes, masses, lengths, nothing, count, n, first)
        _gather(slopes, masses, first, count, n, sums)
        uniform = largest_bound(sums, n, square, other)
        _shares(slopes, masses, lengths, sums, count, n, second)
        _gather(slopes, masses, second, count, n, sums)
        balanced = largest_bound(sums, n, square, other)
        before, after = 0.0, 0.0
        for k in range(count):
            before += lengths[k] * uniform * first[k]
            after += lengths[k] * balanced * second[k]
        for k in range(count):
            f = faces[offsets[c] + k]
            side = 0 if face_cells[f, 0] == c else 1
            asked[f, side] = balanced * second[k] if after < before else uniform * first[k]
    return asked, resolved
