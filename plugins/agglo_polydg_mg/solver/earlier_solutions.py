"""Compute initial guesses: the combination of earlier solutions with the smallest energy error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from agglo_core.authoring import Float, frozen_float, frozen_index, kernel

WIDE = 8
"""Number of columns of a vector table, the maximum: :func:`half_products` is unrolled for 8."""
_ROWS = 256  # per block: 16 KiB for 8 vectors, which stay in the L1 cache (benchmarks/time_steps.py)


@kernel
def differences_of(vectors: Any, table: Any) -> None:
    """Write the backward differences of successive vectors, by order, to the columns of ``table (n, WIDE)``.

    The ``vectors (k, n)`` are ordered by age, the latest last. Order 0 is the latest vector itself.
    Each column is divided by its largest magnitude; columns from k on, and vanishing differences, are 0.
    """
    count, n = vectors.shape
    rows, largest = np.zeros((WIDE, _ROWS)), np.zeros(WIDE)
    for first in range(0, n, _ROWS):
        size = min(_ROWS, n - first)
        for k in range(count):
            for i in range(size):
                rows[k, i] = vectors[count - 1 - k, first + i]
        # Order m from order m − 1, in place: row k is the m-th difference k − m steps back. The last row goes
        # first, as each needs the one above unchanged; in the end row k is the latest difference of order k.
        for order in range(1, count):
            for k in range(count - 1, order - 1, -1):
                for i in range(size):
                    rows[k, i] = rows[k - 1, i] - rows[k, i]
        for i in range(size):
            for k in range(WIDE):
                table[first + i, k] = rows[k, i]
                largest[k] = max(largest[k], abs(rows[k, i]))
    # Scaling: differences of high order are smaller by orders of magnitude.
    for k in range(WIDE):
        largest[k] = 1.0 / largest[k] if largest[k] > 0.0 else 0.0
    for i in range(n):
        for k in range(WIDE):
            table[i, k] *= largest[k]


@kernel
def half_products(indptr: Any, indices: Any, blocks: Any, table: Any, products: Any) -> None:
    """Write the product H V to ``products (n, WIDE)``, for a symmetric block matrix A = H + Hᵀ.

    V is ``table (n, WIDE)``. H contains the blocks of the lower half, and half of each diagonal block:
    Vᵀ A V = Vᵀ H V + (Vᵀ H V)ᵀ takes half the work of A V.
    """
    m = blocks.shape[1]
    # Each row of H V collects its eight sums in registers
    for i in range(len(indptr) - 1):
        for a in range(m):
            s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = 0.0  # registers: faster than an array
            for h in range(indptr[i], indptr[i + 1]):
                j = indices[h]
                if j > i:
                    continue
                share = 0.5 if j == i else 1.0
                for b in range(m):
                    entry, row = share * blocks[h, a, b], table[j * m + b]
                    s0, s1, s2, s3 = (
                        s0 + entry * row[0], s1 + entry * row[1], s2 + entry * row[2], s3 + entry * row[3]
                    )  # fmt: skip
                    s4, s5, s6, s7 = (
                        s4 + entry * row[4], s5 + entry * row[5], s6 + entry * row[6], s7 + entry * row[7]
                    )  # fmt: skip
            into = products[i * m + a]
            into[0], into[1], into[2], into[3] = s0, s1, s2, s3
            into[4], into[5], into[6], into[7] = s4, s5, s6, s7


KEPT: Final = 8
"""Number of kept solutions, at most WIDE: smooth changes are extrapolated, individual errors average out.
Each takes memory, and time for the initial guess (benchmarks/time_steps.py)."""
_PARALLEL: Final = 1e-12
"""Directions count as rounding if their scaled energy eigenvalue is at most this fraction of the largest.

A smaller value amplifies rounding in nearly parallel solutions, a larger value drops high differences.
"""


def best_combination(A: Any, b: Float, earlier: Sequence[Float]) -> Float:
    """Return the combination x of vectors with the smallest energy error ‖x − A⁻¹b‖_A.

    For earlier solutions this extrapolates as well as any formula, at any step sizes, and the result is
    never worse than 0 (P. Fischer, Comput. Methods Appl. Mech. Engrg. 163, 1998). A block matrix takes
    about as long as two products.

    Parameters
    ----------
    A : (n, n) sparse
        Symmetric, positive definite; directions in which A proves not to be definite are left out.
    b : (n,) float
    earlier : sequence of (n,) float
        The latest last; the last 8 are used.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.diags_array([1.0, 2.0, 4.0])
    >>> best_combination(A, np.array([1.0, 2.0, 0.0]), [np.ones(3), np.array([1.0, 1.0, 0.0])]).round(9)
    array([1., 1., 0.])
    """
    V = np.empty((len(b), WIDE))  # differences keep the digits that similar vectors would lose
    differences_of(np.array(earlier[-KEPT:], dtype=np.float64), V)
    # 1. G = Vᵀ A V, scaled to a unit diagonal; columns without energy are scaled to 0.
    energies = _energies(A, V)
    squares = np.diag(energies)
    sizes = np.sqrt(np.where(squares > 0.0, squares, np.inf))
    # 2. Eigenvectors of G above the rounding level: energy-orthogonal directions.
    values, turn = np.linalg.eigh(energies / np.outer(sizes, sizes))
    significant = values > max(_PARALLEL * values[-1], 0.0)
    turn = turn[:, significant] / sizes[:, None]
    # 3. x = V c with G c = Vᵀ b, restricted to these directions.
    return frozen_float(V @ (turn @ ((turn.T @ (b @ V)) / values[significant])))


def _energies(A: Any, V: Float) -> Float:
    """Return the energy products Vᵀ A V ``(k, k)`` of the columns of V."""
    if getattr(A, "format", "") != "bsr" or A.blocksize[0] != A.blocksize[1] or A.dtype != np.float64:
        return np.asarray(V.T @ (A @ V), dtype=np.float64)
    products = np.empty(V.shape)
    half_products(frozen_index(A.indptr), frozen_index(A.indices), frozen_float(A.data), V, products)
    half = V.T @ products
    return np.asarray(half + half.T)
