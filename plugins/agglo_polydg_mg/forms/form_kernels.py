"""Helpers of the kernels of the sharp penalty, on small matrices: factors, bounds, shares of the faces.

A form is a matrix of a face, its lower half row by row, and its trace. Upper bounds of largest eigenvalues
are computed for ``LANES`` matrices at a time, so that their powers are computed side by side: the matrices
themselves are too small for fast loops. What a cell requires is then distributed among its faces.
"""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_polydg_mg.space.legendre_kernels import LANES

SQUARINGS = 5  # the bound exceeds the eigenvalue by n^(1/64) at most: 5 % for n = 27, 1 % for n = 2


@helper
def factorise(matrix, n, tolerance):
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
def square(lanes, scaled, traces, inverse):
    """Divide symmetric matrices by their ``traces``, which come out, and square them: the lower halves."""
    n = len(lanes)
    for lane in range(LANES):
        traces[lane] = 0.0
    for i in range(n):
        for lane in range(LANES):
            traces[lane] += lanes[i, i, lane]
    for lane in range(LANES):
        inverse[lane] = 1.0 / traces[lane] if traces[lane] > 0.0 else 0.0
    for i in range(n):
        for j in range(i + 1):
            for lane in range(LANES):
                scaled[i, j, lane] = scaled[j, i, lane] = inverse[lane] * lanes[i, j, lane]
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
def complete(lanes, scaled, traces, inverse, bounds):
    """The ``bounds`` from matrices that have been squared once and their first ``traces``."""
    for step in range(1, SQUARINGS):
        square(lanes, scaled, traces[step], inverse)
    for lane in range(LANES):
        bounds[lane] = 0.0
    for i in range(len(lanes)):
        for j in range(i + 1):
            twice = 1.0 if i == j else 2.0
            for lane in range(LANES):
                bounds[lane] += twice * lanes[i, j, lane] * lanes[i, j, lane]
    for lane in range(LANES):
        bound = np.sqrt(bounds[lane])
        for step in range(SQUARINGS - 1, -1, -1):
            bound = traces[step, lane] * np.sqrt(bound)
        bounds[lane] = bound


@kernel
def largest_bounds(lanes, bounds):
    """Upper ``bounds (LANES,)`` of the largest eigenvalues of symmetric positive semidefinite matrices.

    λ^(2^k) is an eigenvalue of the 2^k-th power, and none of these exceeds its Frobenius norm. ``lanes``
    holds the lower halves ``(n, n, LANES)`` and is overwritten.
    """
    scaled, traces, inverse = np.empty(lanes.shape), np.empty((SQUARINGS, LANES)), np.empty(LANES)
    square(lanes, scaled, traces[0], inverse)
    complete(lanes, scaled, traces, inverse, bounds)


@helper
def whiten(slopes, q, factor, n):
    """Replace ``slopes[q]`` by L⁻¹ of it, L being a Cholesky factor with the inverses of its diagonal."""
    for i in range(n):
        value = slopes[q, i]
        for k in range(i):
            value -= factor[i, k] * slopes[q, k]
        slopes[q, i] = value * factor[i, i]


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
def balancing(most, n):
    """Where :func:`balance` computes, for ``most`` faces: arrays by themselves, or loops are slow."""
    return (
        np.empty(most), np.empty(most), np.empty(most), np.empty((n, n, LANES)), np.empty((n, n, LANES)),
        np.empty((SQUARINGS, LANES)), np.empty(LANES), np.empty(LANES), np.empty(LANES),
        np.zeros(n * (n + 1) // 2 + 1),
    )  # fmt: skip


@helper
def balance(
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
def most_faces(offsets):
    """Faces of ``LANES`` cells in a row, at most."""
    n_cells, most = len(offsets) - 1, 0
    for begin in range(0, n_cells, LANES):
        most = max(most, offsets[min(begin + LANES, n_cells)] - offsets[begin])
    return most
