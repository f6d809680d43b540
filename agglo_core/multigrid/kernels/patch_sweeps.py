"""Schwarz smoothing on patches of a block matrix: inverses on patches, and sweeps."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from agglo_core.compiled.compiling import kernel
from agglo_core.multigrid.kernels.block_vectors import add_dots, add_product

_TINY = 1e-22  # relative to the largest entry: smaller entries are set to 0, against slow denormals


@kernel(reorder_sums=True)
def patch_inverses(offsets, parts, indptr, indices, data, starts, inverses):
    """Invert the matrix on each patch, and store inverse i by rows in ``inverses``, from ``starts[i]`` on.

    The blocks ``data`` must be symmetric, and only those in the lower half of a patch are read. The sweep
    operator (M. Goodnight, Amer. Statist. 33, 1979) inverts this half in place. Returns the first patch that
    is not positive definite, or −1.
    """
    n = data.shape[1]
    most = 0
    for i in range(len(offsets) - 1):
        most = max(most, (offsets[i + 1] - offsets[i]) * n)
    workspace, pivots = np.empty(most * most), np.empty(most)
    place = np.full(len(indptr) - 1, -1, np.int64)
    for i in range(len(offsets) - 1):
        # 1. W: lower half of the matrix on the patch.
        first, size = offsets[i], offsets[i + 1] - offsets[i]
        m = size * n
        W = workspace[: m * m].reshape(m, m)
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

        # 2. Sweep on each pivot j: with s = 1 / w_jj, w_rc −= w_rj s w_jc for r, c ≠ j, then w_rj *= s and
        #    w_jj = −s. The result is −W⁻¹.
        for j in range(m):
            if not W[j, j] > 0.0:
                return i
            # ``pivots`` is column j, by symmetry also above the diagonal. Its entry j is 0, so that column j
            # stays unchanged in the update of the rows below.
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

        # 3. Store without tiny entries. The largest entry of a definite matrix is on the diagonal.
        least = 0.0
        for r in range(m):
            least = max(least, -W[r, r] * _TINY)
        for r in range(m):
            for c in range(r + 1):
                value = -W[r, c] if abs(W[r, c]) > least else 0.0
                inverses[starts[i] + r * m + c] = value
                inverses[starts[i] + c * m + r] = value
    return -1


@cache
def patch_sweep(width: int) -> Any:
    """Return a compiled multiplicative Schwarz sweep through overlapping patches.

    The arguments are ``(offsets, parts, starts, below, pivots, factors, indptr, indices, data, b, x,
    order)``. The sweep solves for the unknowns of each patch in turn with the factors of
    :mod:`.patch_factors`, keeping all other unknowns, and updates x. Patches are taken forward (``order`` 1
    or 0) or backward (−1). For ``order`` 0, b must be the residual b − A x, and is updated. Blocks have the
    size ``width``, and are stored in flat arrays.
    """

    @kernel(reorder_sums=True)
    def sweep(offsets, parts, starts, below, pivots, factors, indptr, indices, data, b, x, order):
        n, block = width, width * width
        count, most = len(offsets) - 1, 0
        for i in range(count):
            most = max(most, offsets[i + 1] - offsets[i])
        rhs, solution = np.empty(most * n, x.dtype), np.empty(most * n, x.dtype)
        holder = np.full(len(indptr) - 1, -1, np.int32)  # last patch that contains a part
        for turn in range(count):
            i = count - 1 - turn if order < 0 else turn
            first, size = offsets[i], offsets[i + 1] - offsets[i]
            for a in range(size):
                holder[np.uint32(parts[first + a])] = i  # unsigned: no test for negative indices
            # 1. The right-hand side times −1: the residual for ``order`` 0, which gives the change of x,
            #    otherwise b − Σ_j A_ij x_j with j outside the patch, which gives x itself.
            for a in range(size):
                part = np.uint32(parts[first + a])
                for q in range(n):
                    rhs[a * n + q] = -b[part * n + q]
                    solution[a * n + q] = 0
                if order != 0:
                    for h in range(indptr[part], indptr[part + 1]):
                        column = np.uint32(indices[h])
                        if holder[column] != i:
                            add_dots(width, data, h * block, x, column * n, rhs, a * n)

            # 2. L y = rhs, forward by columns of L: with b = ``below[h]``, block h of ``factors`` is
            # −(Lᵀ)_ab,    used as its transpose. D⁻¹ y in the same loop, then Lᵀ solution = D⁻¹ y, backward.
            for a in range(size):
                for h in range(starts[first + a], starts[first + a + 1]):
                    add_product(width, rhs, a * n, 1, factors, h * block, rhs, below[h] * n)
                add_product(width, rhs, a * n, 1, pivots, (first + a) * block, solution, a * n)
            for back in range(size):
                a = size - 1 - back
                for h in range(starts[first + a], starts[first + a + 1]):
                    add_dots(width, factors, h * block, solution, below[h] * n, solution, a * n)

            # 3. ``solution`` is the change of x, or x itself, times −1.
            for a in range(size):
                part = np.uint32(parts[first + a])
                if order != 0:
                    for q in range(n):
                        x[part * n + q] = -solution[a * n + q]
                    continue
                for q in range(n):
                    x[part * n + q] -= solution[a * n + q]
                    b[part * n + q] = 0  # zero except for rounding
                # The residual outside the patch: r_j −= A_ijᵀ (change of x_i).
                for h in range(indptr[part], indptr[part + 1]):
                    column = np.uint32(indices[h])
                    if holder[column] != i:
                        add_product(width, solution, a * n, 1, data, h * block, b, column * n)

    return sweep
