"""Where to start from when systems follow one another: the best that earlier solutions can do together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from agglo_core.authoring import Float, frozen_float

__all__ = ["KEPT", "best_combination"]

KEPT: Final = 5
"""Solutions that are kept: what changes smoothly is extrapolated to fourth order."""
_PARALLEL: Final = 1e-12
"""Directions whose energy is this part of the largest are rounding."""


def best_combination(A: Any, b: Float, earlier: Sequence[Float]) -> Float:
    """The combination of vectors next to the solution of A x = b in the energy norm ``(n,)``.

    Of earlier solutions it is an extrapolation as good as any formula's, whatever the steps between them, and
    never worse than 0 (P. Fischer, Comput. Methods Appl. Mech. Engrg. 163, 1998). It costs one product with
    A for each of them.

    Parameters
    ----------
    A : (n, n) sparse
        Symmetric, positive definite; directions in which it turns out not to be are left out.
    b : (n,) float
    earlier : sequence of (n,) float
        The latest last.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.diags_array([1.0, 2.0, 4.0])
    >>> best_combination(A, np.array([1.0, 2.0, 0.0]), [np.ones(3), np.array([1.0, 1.0, 0.0])]).round(9)
    array([1., 1., 0.])
    """
    rows, differences = [], np.array(earlier, dtype=np.float64)[::-1]
    while len(differences):  # of higher and higher order, each with the digits that vectors alike would lose
        length = float(np.linalg.norm(differences[0]))
        if length > 0.0:
            rows.append(differences[0] / length)
        differences = differences[:-1] - differences[1:]
    if not rows:
        return frozen_float(np.zeros(len(b)))
    V = np.stack(rows, axis=1)
    energies = V.T @ (A @ V)
    sizes = np.sqrt(np.maximum(np.diag(energies), np.finfo(float).tiny))
    values, turn = np.linalg.eigh(energies / np.outer(sizes, sizes))
    chosen = values > _PARALLEL * values[-1]
    turn = turn[:, chosen] / sizes[:, None]
    return frozen_float(V @ (turn @ ((turn.T @ (V.T @ b)) / values[chosen])))
