"""Schwarz smoothing on patches of a block matrix: inverses of the patches, and sweeps through them."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from agglo_core.kernels.compiling import helper, kernel

__all__ = ["patch_borders", "patch_inverses", "patch_sum", "patch_sweep"]

_TINY = 1e-22  # of the largest entry: less is 0, lest single precision computes with denormal numbers


@kernel(reorder_sums=True)
def patch_inverses(offsets, parts, indptr, indices, data, starts, half, out):
    """Fill ``out`` with the inverses of the patches' matrices by rows, patch i from ``starts[i]`` on.

    If ``half``, only the rows of their lower halves are stored, one after the other. The blocks ``data`` of
    the matrix must be symmetric; only those in the lower half of a patch are read. Symmetric sweeps
    (M. Goodnight, Amer. Statist. 33, 1979) invert that half in place. Returns the first patch that is not
    positive definite, −1 if there is none.
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
        for r in range(m):
            row, at = W[r], starts[i] + (r * (r + 1) // 2 if half else r * m)
            for c in range(r + 1):
                out[at + c] = -row[c] if abs(row[c]) > least else 0.0
        for r in range(0 if half else m):
            for c in range(r):
                out[starts[i] + c * m + r] = out[starts[i] + r * m + c]
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


@cache
def patch_sweep(width: int) -> Any:
    """Kernel ``(offsets, parts, inverse_starts, inverses, starts, stops, columns, border, b, x, back)``.

    It returns x after solving for the unknowns of each patch in turn, others fixed; ``back``: last patch
    first. ``inverses`` are stored by half. Block h of :func:`patch_borders`, transposed, is ``border[h]``, of
    size ``width``; 0 stands for any. Blocks ``starts[a]:stops[a]`` enter: all, or those that can matter in a
    first sweep from x = 0.
    """

    @kernel(reorder_sums=True)
    def sweep(offsets, parts, inverse_starts, inverses, starts, stops, columns, border, b, x, back):
        n, count = width if width > 0 else border.shape[1], len(offsets) - 1
        most = 0
        for i in range(count):
            most = max(most, (offsets[i + 1] - offsets[i]) * n)
        own, rest, better = np.empty(n, x.dtype), np.empty(most, x.dtype), np.empty(most, x.dtype)
        x = x.copy()
        for s in range(count):
            i = count - 1 - s if back else s
            first, last = offsets[i], offsets[i + 1]
            for a in range(first, last):
                row, into = np.uint32(parts[a]) * n, (a - first) * n
                for r in range(n):
                    own[r] = b[row + r]
                for h in range(starts[a], stops[a]):
                    column = np.uint32(columns[h]) * n  # unsigned: no test whether it counts from the end
                    for c in range(n):
                        value = x[column + c]
                        for r in range(n):
                            own[r] -= border[h, c, r] * value
                for r in range(n):
                    rest[into + r] = own[r]
            _solve(inverses, inverse_starts[i], rest, (last - first) * n, better)
            for a in range(first, last):
                row, into = np.uint32(parts[a]) * n, (a - first) * n
                for r in range(n):
                    x[row + r] = better[into + r]
        return x

    return sweep


@helper(reorder_sums=True)
def _solve(inverses, start, rest, m, better):
    """``better[:m]`` becomes the product of ``rest`` with the symmetric matrix stored by half."""
    at = start
    for r in range(m):
        inverse, value = inverses[at : at + r + 1], rest[r]
        total = inverse[r] * value
        for c in range(r):
            total += inverse[c] * rest[c]
            better[c] += inverse[c] * value
        better[r] = total
        at += r + 1


@kernel(reorder_sums=True)
def patch_sum(offsets, parts, inverse_starts, inverses, weights, n, r):
    """The sum of the solutions of all patches, inverses by half; each part is weighted before and after."""
    most = 0
    for i in range(len(offsets) - 1):
        most = max(most, (offsets[i + 1] - offsets[i]) * n)
    there, better = np.empty(most, r.dtype), np.empty(most, r.dtype)
    x = np.zeros_like(r)
    for i in range(len(offsets) - 1):
        first, last = offsets[i], offsets[i + 1]
        for a in range(first, last):
            for c in range(n):
                there[(a - first) * n + c] = weights[parts[a]] * r[parts[a] * n + c]
        _solve(inverses, inverse_starts[i], there, (last - first) * n, better)
        for a in range(first, last):
            for c in range(n):
                x[parts[a] * n + c] += weights[parts[a]] * better[(a - first) * n + c]
    return x
