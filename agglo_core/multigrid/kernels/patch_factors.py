"""Sparse block factors L D Lᵀ of the matrix on each patch of parts.

The cells around a vertex form a ring, each coupled to two others. The inverse of their matrix is full, but
its factors hold at most three blocks for each cell: they are found in time proportional to the number of
cells, not to its cube.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@kernel
def patch_orders(offsets, parts, indptr, indices):
    """Order the parts of each patch by minimum degree, and find the blocks of L in that order.

    Patch i has the parts ``parts[offsets[i]:offsets[i + 1]]`` of a block matrix. Returned are the parts,
    permuted within patches so that the next is always one with the fewest neighbours; and of L the blocks
    ``starts[a]:starts[a + 1]`` in the column of ``parts[a]``, the row of block h being at the place
    ``below[h]`` of the patch.
    """
    # ``turn[a]`` is the place of part a in the order of elimination, −1 before it is eliminated.
    most = 0
    for i in range(len(offsets) - 1):
        most = max(most, offsets[i + 1] - offsets[i])
    coupled, turn = np.zeros((most, most), np.bool_), np.empty(most, np.int64)
    place = np.full(len(indptr) - 1, -1, np.int64)
    ordered, starts = np.empty(len(parts), np.int32), np.zeros(len(parts) + 1, np.int64)
    below, count = np.empty(4 * len(parts), np.int32), 0
    for i in range(len(offsets) - 1):
        first, size = offsets[i], offsets[i + 1] - offsets[i]
        # 1. The graph of the patch, dense: which of its parts the matrix couples.
        for a in range(size):
            place[parts[first + a]] = a
            turn[a] = -1
        for a in range(size):
            part = parts[first + a]
            for h in range(indptr[part], indptr[part + 1]):
                b = place[indices[h]]
                if b >= 0:
                    coupled[a, b] = coupled[b, a] = True
        # Room for the blocks of this patch: fewer than size².
        if count + size * size > len(below):
            longer = np.empty(2 * len(below) + size * size, np.int32)
            longer[:count] = below[:count]
            below = longer
        # 2. Next is a part j with the fewest neighbours among those left, the first of several.
        for s in range(size):
            j, fewest = -1, size + 1
            for a in range(size):
                if turn[a] < 0:
                    degree = 0
                    for b in range(size):
                        degree += coupled[a, b] and turn[b] < 0
                    if degree < fewest:
                        j, fewest = a, degree
            # 3. Eliminate j: its neighbours left are the blocks of its column of L, and become coupled to one
            #    another (fill).
            turn[j] = s
            ordered[first + s] = parts[first + j]
            for a in range(size):
                if coupled[j, a] and turn[a] < 0:
                    below[count] = a
                    count += 1
                    for b in range(size):
                        if coupled[j, b] and turn[b] < 0:
                            coupled[a, b] = True
            starts[first + s + 1] = count
        # 4. Rows of L as places in the new order; work arrays are cleared for the next patch.
        for h in range(starts[first], count):
            below[h] = turn[below[h]]
        for a in range(size):
            place[parts[first + a]] = -1
            for b in range(size):
                coupled[a, b] = False
    return ordered, starts, below[:count].copy()


@cache
def patch_factors(width: int) -> Any:
    """Kernel of the block factors L D Lᵀ of the matrix on each patch, for blocks of a size.

    Its arguments are ``(offsets, parts, starts, below, indptr, indices, data, pivots, factors)``. D is block
    diagonal, the diagonal blocks of L are identities. ``pivots (·, n, n)`` are filled with the blocks of D⁻¹,
    and ``factors (·, n, n)`` with those of −Lᵀ above the diagonal; patches are those of :func:`patch_orders`;
    the size 0 stands for any. Returned is the first patch on which the matrix is not positive definite, −1 if
    there is none.
    """

    @kernel(reorder_sums=True)
    def factors_of_patches(offsets, parts, starts, below, indptr, indices, data, pivots, factors):
        n = width if width > 0 else data.shape[1]
        most = 0
        for i in range(len(offsets) - 1):
            most = max(most, offsets[i + 1] - offsets[i])
        W = np.empty((most * most, n, n))  # its upper half: block of places a ≤ b at a · most + b
        D, L = np.empty((n, n)), np.empty((most, n, n))
        place = np.full(len(indptr) - 1, -1, np.int64)
        for i in range(len(offsets) - 1):
            first, size = offsets[i], offsets[i + 1] - offsets[i]
            # 1. W: the matrix on the patch in the order of elimination, its upper half.
            for a in range(size):
                place[parts[first + a]] = a
                for b in range(a, size):
                    for r in range(n):
                        for q in range(n):
                            W[a * most + b, r, q] = 0.0
            for a in range(size):
                part = parts[first + a]
                for h in range(indptr[part], indptr[part + 1]):
                    b = place[indices[h]]
                    if b >= a:
                        for r in range(n):
                            for q in range(n):
                                W[a * most + b, r, q] = data[h, r, q]
            for a in range(size):
                place[parts[first + a]] = -1

            for a in range(size):
                # 2. D_a is what the eliminations before left of the diagonal block; invert it.
                for r in range(n):
                    for q in range(n):
                        D[r, q] = W[a * most + a, r, q]
                if not _inverted(D, n):
                    return i
                for r in range(n):
                    for q in range(n):
                        pivots[first + a, r, q] = D[r, q]
                # 3. Row a of −Lᵀ: blocks −D_a⁻¹ W_ab, for the places b below a in its column of L.
                low, high = starts[first + a], starts[first + a + 1]
                for h in range(low, high):
                    k, m = a * most + below[h], h - low
                    for r in range(n):
                        for q in range(n):
                            L[m, r, q] = 0.0
                        for c in range(n):
                            for q in range(n):
                                L[m, r, q] -= D[r, c] * W[k, c, q]
                        for q in range(n):
                            factors[h, r, q] = L[m, r, q]
                # 4. Schur complement: W_bc −= W_abᵀ D_a⁻¹ W_ac for all such b ≤ c.
                for h in range(low, high):
                    for g in range(low, high):
                        if below[h] <= below[g]:
                            into, k, m = below[h] * most + below[g], a * most + below[g], h - low
                            for r in range(n):
                                for c in range(n):
                                    for q in range(n):
                                        W[into, r, q] += L[m, c, r] * W[k, c, q]
        return -1

    return factors_of_patches


@helper(reorder_sums=True)
def _inverted(D, n):
    """Invert a symmetric matrix in place, and return whether it is positive definite.

    Gauss–Jordan without pivoting: the pivots are those of Cholesky, squared, and must be positive.
    """
    for j in range(n):
        if not D[j, j] > 0.0:
            return False
        scale = 1.0 / D[j, j]
        D[j, j] = 1.0
        for q in range(n):
            D[j, q] *= scale
        for r in range(n):
            if r != j:
                factor = D[r, j]
                D[r, j] = 0.0
                for q in range(n):
                    D[r, q] -= factor * D[j, q]
    for r in range(n):  # but for rounding it is symmetric
        for q in range(r):
            D[q, r] = D[r, q]
    return True
