"""Sparse block factors L D Lᵀ of the matrix on each patch.

The cells around a vertex form a ring, each coupled to two others. The inverse of their matrix is full, but
its factors have at most three blocks per cell. Therefore factorisation time is proportional to the number of
cells, not to its cube.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@kernel
def patch_orders(offsets, parts, indptr, indices):
    """Order the parts of each patch by minimum degree, and find the sparsity pattern of the factor L.

    Patch i has the parts ``parts[offsets[i]:offsets[i + 1]]`` of a block matrix. Returns the parts, permuted
    within patches so that the next part always has the fewest neighbours, and the pattern of L: the column of
    ``parts[a]`` has the blocks ``starts[a]:starts[a + 1]``, and the row of block h is the position
    ``below[h]`` in the patch.
    """
    # ``turn[a]`` is the position of part a in the elimination order, −1 before its elimination.
    most = 0
    for i in range(len(offsets) - 1):
        most = max(most, offsets[i + 1] - offsets[i])
    coupled, turn = np.zeros((most, most), np.bool_), np.empty(most, np.int64)
    place = np.full(len(indptr) - 1, -1, np.int64)
    ordered, starts = np.empty(len(parts), np.int32), np.zeros(len(parts) + 1, np.int64)
    below, count = np.empty(4 * len(parts), np.int32), 0
    for i in range(len(offsets) - 1):
        first, size = offsets[i], offsets[i + 1] - offsets[i]
        # 1. Dense coupling graph of the patch.
        for a in range(size):
            place[parts[first + a]] = a
            turn[a] = -1
        for a in range(size):
            part = parts[first + a]
            for h in range(indptr[part], indptr[part + 1]):
                b = place[indices[h]]
                if b >= 0:
                    coupled[a, b] = coupled[b, a] = True
        # Reserve space for the blocks of this patch, fewer than size².
        if count + size * size > len(below):
            longer = np.empty(2 * len(below) + size * size, np.int32)
            for k in range(count):
                longer[k] = below[k]
            below = longer
        # 2. Choose the first part j with the fewest remaining neighbours.
        for s in range(size):
            j, fewest = -1, size + 1
            for a in range(size):
                if turn[a] < 0:
                    degree = 0
                    for b in range(size):
                        degree += coupled[a, b] and turn[b] < 0
                    if degree < fewest:
                        j, fewest = a, degree
            # 3. Eliminate j. Its remaining neighbours are the blocks in its column of L, and become coupled
            # to each    other (fill-in).
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
        # 4. Convert rows of L to positions in the new order, and clear the workspace for the next patch.
        for h in range(starts[first], count):
            below[h] = turn[below[h]]
        for a in range(size):
            place[parts[first + a]] = -1
            for b in range(size):
                coupled[a, b] = False
    return ordered, starts, below[:count].copy()


@cache
def patch_factors(width: int) -> Any:
    """Return the compiled block factorisation L D Lᵀ on patches, for a block size (0 for any).

    The arguments are ``(offsets, parts, starts, below, indptr, indices, data, pivots, factors)``, with
    patches from :func:`patch_orders`. D is block diagonal, and the diagonal blocks of L are identities. The
    kernel fills ``pivots (·, n, n)`` with the blocks of D⁻¹, and ``factors (·, n, n)`` with the blocks of −Lᵀ
    above the diagonal. It returns the first patch on which the matrix is not positive definite, or −1.
    """

    @kernel(reorder_sums=True)
    def factors_of_patches(offsets, parts, starts, below, indptr, indices, data, pivots, factors):
        n = width if width > 0 else data.shape[1]
        most = 0
        for i in range(len(offsets) - 1):
            most = max(most, offsets[i + 1] - offsets[i])
        W = np.empty((most * most, n, n))  # upper half: block (a, b), a ≤ b, at a · most + b
        D, L = np.empty((n, n)), np.empty((most, n, n))
        place = np.full(len(indptr) - 1, -1, np.int64)
        for i in range(len(offsets) - 1):
            first, size = offsets[i], offsets[i + 1] - offsets[i]
            # 1. W: upper half of the matrix on the patch, in elimination order.
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
                # 2. D_a is the diagonal block after the previous eliminations. Invert it.
                for r in range(n):
                    for q in range(n):
                        D[r, q] = W[a * most + a, r, q]
                if not _invert_symmetric(D, n):
                    return i
                for r in range(n):
                    for q in range(n):
                        pivots[first + a, r, q] = D[r, q]
                # 3. Row a of −Lᵀ: blocks −D_a⁻¹ W_ab for all b below a in its column of L.
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
                # 4. Schur complement: W_bc −= W_abᵀ D_a⁻¹ W_ac for all these b ≤ c.
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
def _invert_symmetric(D, n):
    """Invert a symmetric matrix in place, and return True if positive definite.

    Gauss–Jordan without pivoting: the pivots are the squared Cholesky pivots, and must be positive.
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
    for r in range(n):  # remove asymmetry by rounding
        for q in range(r):
            D[q, r] = D[r, q]
    return True
