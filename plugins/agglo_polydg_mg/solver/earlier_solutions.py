"""Where to start from when systems follow one another: the best that earlier solutions can do together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from agglo_core.authoring import Float, frozen_float, frozen_index

KEPT: Final = 8
"""Solutions that are kept: what changes smoothly is extrapolated, what each lacks is averaged."""
_PARALLEL: Final = 1e-12
"""Directions whose energy is this part of the largest are rounding."""


def best_combination(A: Any, b: Float, earlier: Sequence[Float]) -> Float:
    """The combination of vectors next to the solution of A x = b in the energy norm ``(n,)``.

    Of earlier solutions it is an extrapolation as good as any formula's, whatever the steps between them, and
    never worse than 0 (P. Fischer, Comput. Methods Appl. Mech. Engrg. 163, 1998). Of a matrix in blocks it
    takes about as long as two products.

    Parameters
    ----------
    A : (n, n) sparse
        Symmetric, positive definite; directions in which it turns out not to be are left out.
    b : (n,) float
    earlier : sequence of (n,) float
        The latest last; 8 of them count.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.diags_array([1.0, 2.0, 4.0])
    >>> best_combination(A, np.array([1.0, 2.0, 0.0]), [np.ones(3), np.array([1.0, 1.0, 0.0])]).round(9)
    array([1., 1., 0.])
    """
    from agglo_polydg_mg.solver.energy_kernels import WIDE, differences_of

    V = np.empty((len(b), WIDE))  # differences: each has the digits that vectors alike would lose
    differences_of(np.array(earlier[-KEPT:], dtype=np.float64), V)
    energies = _energies(A, V)
    squares = np.diag(energies)
    sizes = np.sqrt(np.where(squares > 0.0, squares, np.inf))
    values, turn = np.linalg.eigh(energies / np.outer(sizes, sizes))
    chosen = values > max(_PARALLEL * values[-1], 0.0)
    turn = turn[:, chosen] / sizes[:, None]
    return frozen_float(V @ (turn @ ((turn.T @ (b @ V)) / values[chosen])))


def _energies(A: Any, V: Float) -> Float:
    """Vᵀ A V ``(k, k)``."""
    from agglo_polydg_mg.solver.energy_kernels import half_products

    if getattr(A, "format", "") != "bsr" or A.blocksize[0] != A.blocksize[1] or A.dtype != np.float64:
        return np.asarray(V.T @ (A @ V), dtype=np.float64)
    products = np.empty(V.shape)
    half_products(frozen_index(A.indptr), frozen_index(A.indices), frozen_float(A.data), V, products)
    half = V.T @ products
    return np.asarray(half + half.T)
