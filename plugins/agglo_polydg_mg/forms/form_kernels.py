"""Small-matrix kernels for the sharp penalty: Cholesky factors, eigenvalue bounds, face weights.

A form is the lower half of a face matrix, row by row, followed by its trace. Upper bounds for largest
eigenvalues are computed for ``LANES`` matrices at a time, so that their powers are computed side by side:
the matrices alone are too small for fast loops. Each cell's requirement is then distributed among its
faces.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_polydg_mg.space.legendre_kernels import LANES

# Number of squarings in the eigenvalue bound. The bound exceeds the eigenvalue by a factor n^(1/64) at
# most: 5 % for n = 27, 1 % for n = 2. One more squaring costs a matrix product for each cell and weighting,
# and halves the excess; one less doubles it (benchmarks/penalty.py).
SQUARINGS = 5


@helper
def factorise(matrix, n, tolerance):
    """Compute a Cholesky factor in place, and return False if a pivot is zero up to rounding.

    The factor is in the lower half, its diagonal inverted. Only the lower half of the first n rows in
    ``matrix`` is read. A pivot counts as rounding below ``tolerance`` times its original diagonal entry.
    """
    for j in range(n):
        # The pivot, the square of L's diagonal entry, is the diagonal entry reduced by the earlier columns.
        # The test fails for NaN too.
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
    """Divide symmetric matrices by their traces, and square them in place.

    Only the lower halves of ``lanes (n, n, LANES)`` are read and written; the traces are written to
    ``traces``; ``scaled`` is workspace for whole matrices, ``inverse (LANES,)`` for inverse traces.
    """
    n = len(lanes)
    # 1. Traces. Divided by them, positive semidefinite matrices have eigenvalues of at most 1, whose powers
    # do not overflow. Zero matrices stay zero.
    for lane in range(LANES):
        traces[lane] = 0.0
    for i in range(n):
        for lane in range(LANES):
            traces[lane] += lanes[i, i, lane]
    for lane in range(LANES):
        inverse[lane] = 1.0 / traces[lane] if traces[lane] > 0.0 else 0.0
    # 2. Scaled matrices, both halves: rows of both factors are then contiguous.
    for i in range(n):
        for j in range(i + 1):
            for lane in range(LANES):
                scaled[i, j, lane] = scaled[j, i, lane] = inverse[lane] * lanes[i, j, lane]
    # 3. Squares, lower halves.
    for i in range(n):
        for j in range(i + 1):
            entry, row_i, row_j = lanes[i, j], scaled[i], scaled[j]
            for lane in range(LANES):
                entry[lane] = 0.0
            for k in range(0, n - 3, 4):  # unrolled by four: sums stay in registers
                for lane in range(LANES):
                    entry[lane] += (
                        row_i[k, lane] * row_j[k, lane]
                        + row_i[k + 1, lane] * row_j[k + 1, lane]
                        + row_i[k + 2, lane] * row_j[k + 2, lane]
                        + row_i[k + 3, lane] * row_j[k + 3, lane]
                    )
            for k in range(n - n % 4, n):
                for lane in range(LANES):
                    entry[lane] += row_i[k, lane] * row_j[k, lane]


@helper
def complete(lanes, scaled, traces, inverse, bounds):
    """Complete the eigenvalue ``bounds`` of matrices that :func:`square` has squared once."""
    # 1. The remaining squarings. With G_0 = G and G_{k+1} = (G_k / tr G_k)² the lanes hold G_5.
    for step in range(1, SQUARINGS):
        square(lanes, scaled, traces[step], inverse)
    # 2. Frobenius norms of G_5, upper bounds of its largest eigenvalues λ_5.
    for lane in range(LANES):
        bounds[lane] = 0.0
    for i in range(len(lanes)):
        for j in range(i + 1):
            twice = 1.0 if i == j else 2.0
            for lane in range(LANES):
                bounds[lane] += twice * lanes[i, j, lane] * lanes[i, j, lane]
    # 3. Return to G: λ_k = tr G_k √λ_{k+1}. Every root halves the relative excess.
    for lane in range(LANES):
        bound = np.sqrt(bounds[lane])
        for step in range(SQUARINGS - 1, -1, -1):
            bound = traces[step, lane] * np.sqrt(bound)
        bounds[lane] = bound


@kernel
def largest_bounds(lanes, bounds):
    """Compute upper ``bounds (LANES,)`` for the largest eigenvalues of positive semidefinite matrices.

    λ^(2^k) is an eigenvalue of the 2^k-th power, which its Frobenius norm bounds. ``lanes`` contains the
    lower halves ``(n, n, LANES)`` and is overwritten.
    """
    scaled, traces, inverse = np.empty(lanes.shape), np.empty((SQUARINGS, LANES)), np.empty(LANES)
    square(lanes, scaled, traces[0], inverse)
    complete(lanes, scaled, traces, inverse, bounds)


@helper
def whiten(slopes, q, factor, n):
    """Replace ``slopes[q]`` by L⁻¹ ``slopes[q]``, for a Cholesky factor L with inverted diagonal."""
    for i in range(n):
        value = slopes[q, i]
        for k in range(i):
            value -= factor[i, k] * slopes[q, k]
        slopes[q, i] = value * factor[i, i]


@helper
def _gather(forms, weights, first, last, n, whole, lanes, lane):
    """Sum weights[F] forms[F] over the faces ``first`` to ``last`` of one cell, in one vector lane.

    ``whole`` is workspace for the sum, contiguous there and strided in the lane.
    """
    place = 0
    for k in range(len(whole)):
        whole[k] = 0.0
    for face in range(first, last):
        form, weight = forms[face], weights[face]
        for k in range(len(whole)):
            whole[k] += form[k] * weight
    for i in range(n):
        for j in range(i + 1):
            lanes[i, j, lane] = whole[place]
            place += 1


@helper
def _spread(lanes, lane, n, whole):
    """Copy the lower half of the matrix in one vector lane to ``whole``, row by row.

    Entries off the diagonal are doubled: the product with a form, a lower half, is then the trace of both.
    """
    place = 0
    for i in range(n):
        for j in range(i + 1):
            whole[place] = lanes[i, j, lane] if i == j else 2.0 * lanes[i, j, lane]
            place += 1


@helper(reorder_sums=True)
def _trace_of_product(form, whole, size):
    """Return the trace of the product of a face matrix and a matrix from :func:`_spread`."""
    value = 0.0
    for k in range(size):
        value += form[k] * whole[k]
    return value


@helper(allocates=True)
def balance_workspace(most, n):
    """Allocate the workspace of :func:`balance` for ``most`` faces.

    Separate arrays are faster than a single array.
    """
    return (
        np.empty(most), np.empty(most), np.empty(most), np.empty((n, n, LANES)), np.empty((n, n, LANES)),
        np.empty((SQUARINGS, LANES)), np.empty(LANES), np.empty(LANES), np.empty(LANES),
        np.zeros(n * (n + 1) // 2 + 1),
    )  # fmt: skip


@helper
def balance(offsets, faces, face_cells, first_cell, begin, end, forms, lengths, n, workspace, penalties):
    """Compute the penalty s_KF that each cell K from ``begin`` to ``end`` requires on each face F.

    There are at most ``LANES`` cells, and ``penalties (F, 2)`` receives the values. They satisfy Σ_F T_F /
    s_F ≤ S, with the forms T_F in coordinates where S is the identity: s_F = λ w_F, λ a bound for the
    largest eigenvalue of Σ_F T_F / w_F, for the better weight w of two (``mathematics.md``, "The sharp
    penalty"). ``forms`` and ``lengths`` are counted from the first face of cell ``begin``; a face with length
    0 needs no penalty.
    """
    first, second, inverse, lanes, scaled, traces, of_traces, uniform, balanced, whole = workspace
    start, last = offsets[begin], forms.shape[1] - 1
    # 1. First weights w_F² = tr(T_F) / |F|, and G = Σ_F T_F / w_F, one cell per lane.
    lanes[:] = 0.0
    for c in range(begin, end):
        for k in range(offsets[c] - start, offsets[c + 1] - start):
            first[k] = inverse[k] = 0.0
            if lengths[k] > 0.0:
                first[k] = np.sqrt(forms[k, last] / lengths[k])
                inverse[k] = 1.0 / first[k] if first[k] > 0.0 else 0.0
        _gather(forms, inverse, offsets[c] - start, offsets[c + 1] - start, n, whole, lanes, c - begin)
    # 2. Second weights w_F² = tr(G² T_F) / |F|. The lanes hold (G / tr G)², which is also the first step to
    # the bound for λ; here tr G is multiplied back.
    square(lanes, scaled, traces[0], of_traces)
    for c in range(begin, end):
        _spread(lanes, c - begin, n, whole)
        for k in range(offsets[c] - start, offsets[c + 1] - start):
            second[k] = inverse[k] = 0.0
            if first[k] > 0.0:
                spread = _trace_of_product(forms[k], whole, last) / lengths[k]
                second[k] = traces[0, c - begin] * np.sqrt(max(0.0, spread))
                inverse[k] = 1.0 / second[k] if second[k] > 0.0 else 0.0
    # 3. λ for the first weights, then the sum for the second weights, and their λ.
    complete(lanes, scaled, traces, of_traces, uniform)
    lanes[:] = 0.0
    for c in range(begin, end):
        _gather(forms, inverse, offsets[c] - start, offsets[c + 1] - start, n, whole, lanes, c - begin)
    square(lanes, scaled, traces[0], of_traces)
    complete(lanes, scaled, traces, of_traces, balanced)
    # 4. Choose s = λ w with the smaller Σ_F |F| s_F, the penalty of a unit jump.
    for c in range(begin, end):
        before, after, lane = 0.0, 0.0, c - begin
        for k in range(offsets[c] - start, offsets[c + 1] - start):
            before += lengths[k] * uniform[lane] * first[k]
            after += lengths[k] * balanced[lane] * second[k]
        for k in range(offsets[c] - start, offsets[c + 1] - start):
            f = faces[start + k]
            side = 0 if face_cells[f, 0] == first_cell + c else 1
            s_first, s_second = uniform[lane] * first[k], balanced[lane] * second[k]
            penalties[f, side] = s_second if after < before else s_first


@helper
def most_faces(offsets):
    """Return the largest total face count of ``LANES`` successive cells."""
    n_cells, most = len(offsets) - 1, 0
    for begin in range(0, n_cells, LANES):
        most = max(most, offsets[min(begin + LANES, n_cells)] - offsets[begin])
    return most
