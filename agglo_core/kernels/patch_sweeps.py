"""Schwarz smoothing on patches of a block matrix: inverses of the patches, and sweeps through them."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import kernel

__all__ = ["patch_borders", "patch_inverses", "patch_sum", "patch_sweep"]

_TINY = 1e-22  # of the largest entry: less is 0, lest single precision computes with denormal numbers


@kernel(reorder_sums=True)
def patch_inverses(offsets, parts, indptr, indices, data, starts, out):
    """Fill ``out`` with the inverses of the patches' matrices, patch i at ``starts[i]``.

    The blocks ``data`` of the matrix must be symmetric; only those in the lower half of a patch are read.
    Symmetric sweeps (M. Goodnight, Amer. Statist. 33, 1979) invert that half in place. Returns the first
    patch that is not positive definite, −1 if there is none.
    """
    n = data.shape[1]
    most = 0
    for i in range(len(offsets) - 1):
        most = max(most, (offsets[i + 1] - offsets[i]) * n)
    room, pivots = np.empty(most * most), np.empty(most)
    place = np.full(len(indptr) - 1, -1, np.int64)
    for i in range(len(offsets) - 1):
        first, size = offsets[i], offsets[i + 1] - offsets[i]
        m = size * n
        W = room[: m * m].reshape(m, m)
        W[:] = 0.0
        for a in range(size):
            place[parts[first + a]] = a
        for a in range(size):
            part = parts[first + a]
            for h in range(indptr[part], indptr[part + 1]):
                b = place[indices[h]]
                if 0 <= b <= a:
                    for r in range(n):
                        for c in range(n):
                            W[a * n + r, b * n + c] = data[h, r, c]
        for a in range(size):
            place[parts[first + a]] = -1

        for j in range(m):  # sweep on each pivot: what is left is −W⁻¹
            if not W[j, j] > 0.0:
                return i
            scale = 1.0 / W[j, j]
            for c in range(j):
                pivots[c] = W[j, c]
            for r in range(j + 1, m):
                pivots[r] = W[r, j]
            pivots[j] = 0.0
            for r in range(j):
                factor, row = pivots[r] * scale, W[r]
                for c in range(r + 1):
                    row[c] -= factor * pivots[c]
            for c in range(j):
                W[j, c] = pivots[c] * scale
            for r in range(j + 1, m):
                factor, row = pivots[r] * scale, W[r]
                for c in range(r + 1):
                    row[c] -= factor * pivots[c]
                row[j] = factor
            W[j, j] = -scale

        least = 0.0
        for r in range(m):
            least = max(least, -W[r, r] * _TINY)
        inverse = out[starts[i] : starts[i] + m * m].reshape(m, m)
        for r in range(m):
            row, into = W[r], inverse[r]
            for c in range(r + 1):
                into[c] = -row[c] if abs(row[c]) > least else 0.0
        for r in range(m):
            for c in range(r):
                inverse[c, r] = inverse[r, c]
    return -1


@kernel
def patch_borders(offsets, parts, indptr, indices):
    """For each part of a patch, the blocks in its row that lead out of the patch.

    Blocks ``starts[a]:starts[a + 1]`` belong to ``parts[a]``; those before ``known[a]`` lead to parts that
    an earlier patch holds. Returned with them: which block of the matrix each is, and its column.
    """
    holder = np.full(len(indptr) - 1, -1, np.int64)  # the last patch that holds a part
    starts = np.zeros(len(parts) + 1, np.int64)
    known = np.empty(len(parts), np.int64)
    for i in range(len(offsets) - 1):
        for a in range(offsets[i], offsets[i + 1]):
            holder[parts[a]] = i
        for a in range(offsets[i], offsets[i + 1]):
            part, count, earlier = parts[a], 0, 0
            for h in range(indptr[part], indptr[part + 1]):
                count += holder[indices[h]] != i
                earlier += (holder[indices[h]] != i) & (holder[indices[h]] >= 0)
            starts[a + 1] = starts[a] + count
            known[a] = starts[a] + earlier
    blocks = np.empty(starts[-1], np.int32)
    columns = np.empty(starts[-1], np.int32)
    holder[:] = -1
    for i in range(len(offsets) - 1):
        for a in range(offsets[i], offsets[i + 1]):
            holder[parts[a]] = i
        for a in range(offsets[i], offsets[i + 1]):
            part, early, late = parts[a], starts[a], known[a]
            for h in range(indptr[part], indptr[part + 1]):
                column = indices[h]
                if holder[column] == i:
                    continue
                at = early if holder[column] >= 0 else late
                early += holder[column] >= 0
                late += holder[column] < 0
                blocks[at] = h
                columns[at] = column
    return starts, known, blocks, columns


@kernel(reorder_sums=True)
def patch_sweep(offsets, parts, inverse_starts, inverses, starts, stops, blocks, columns, data, b, x, back):
    """x after solving for the unknowns of each patch in turn, others fixed; ``back``: last patch first.

    ``data`` are the blocks of the matrix, transposed. Blocks ``starts[a]:stops[a]`` of
    :func:`patch_borders` enter: all, or those that can matter in a first sweep from x = 0.
    """
    n, count = data.shape[1], len(offsets) - 1
    most = 0
    for i in range(count):
        most = max(most, (offsets[i + 1] - offsets[i]) * n)
    rest, better = np.empty(most, x.dtype), np.empty(most, x.dtype)
    x = x.copy()
    for s in range(count):
        i = count - 1 - s if back else s
        first, m = offsets[i], (offsets[i + 1] - offsets[i]) * n
        for a in range(offsets[i], offsets[i + 1]):
            own = rest[(a - first) * n : (a - first + 1) * n]
            row = parts[a] * n
            for r in range(n):
                own[r] = b[row + r]
            for h in range(starts[a], stops[a]):
                block, column = data[blocks[h]], columns[h] * n
                for c in range(n):
                    value = x[column + c]
                    for r in range(n):
                        own[r] -= block[c, r] * value
        for r in range(m):
            better[r] = 0.0
        start = inverse_starts[i]
        for c in range(m):
            value, inverse = rest[c], inverses[start + c * m : start + (c + 1) * m]
            for r in range(m):
                better[r] += inverse[r] * value
        for a in range(offsets[i], offsets[i + 1]):
            row = parts[a] * n
            for r in range(n):
                x[row + r] = better[(a - first) * n + r]
    return x


@kernel(reorder_sums=True)
def patch_sum(offsets, parts, inverse_starts, inverses, weights, n, r):
    """The sum of the solutions of all patches; each part is weighted before and after."""
    most = 0
    for i in range(len(offsets) - 1):
        most = max(most, (offsets[i + 1] - offsets[i]) * n)
    there = np.empty(most, r.dtype)
    x = np.zeros_like(r)
    for i in range(len(offsets) - 1):
        first, m = offsets[i], (offsets[i + 1] - offsets[i]) * n
        for k in range(m):
            there[k] = 0.0
        start = inverse_starts[i]
        for a in range(offsets[i], offsets[i + 1]):
            row = parts[a] * n
            for c in range(n):
                value = weights[parts[a]] * r[row + c]
                at = start + ((a - first) * n + c) * m
                inverse = inverses[at : at + m]
                for k in range(m):
                    there[k] += inverse[k] * value
        for a in range(offsets[i], offsets[i + 1]):
            row = parts[a] * n
            for c in range(n):
                x[row + c] += weights[parts[a]] * there[(a - first) * n + c]
    return x
