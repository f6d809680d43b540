"""Block Gauss–Seidel in a given order of the parts, for matrices that need not be symmetric."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.arrays import Int, frozen, frozen_float, frozen_index, frozen_int
from agglo_core.multigrid.kernels.block_sweeps import block_sweeps
from agglo_core.multigrid.stack import Real


class OrderedGaussSeidel:
    """Block Gauss–Seidel sweeps in an order of the parts, before and after the coarse correction.

    Where convection dominates and the order is downstream, a sweep nearly solves the system.

    Parameters
    ----------
    A : (n, n) sparse
        Matrix with equal blocks, not necessarily symmetric.
    width : int
        Unknowns per part.
    order : (parts,) int
        Permutation of the parts.

    Raises
    ------
    LinAlgError
        If a diagonal block is singular.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import OrderedGaussSeidel
    >>> A = sparse.csr_array([[2.0, -1.0], [0.0, 2.0]])
    >>> OrderedGaussSeidel(A, 1, np.array([1, 0])).before(np.array([2.0, 4.0]))
    (array([2., 2.]), array([0., 0.]))
    """

    def __init__(self, A: Any, width: int, order: Int) -> None:
        parts = len(order)
        self._rows = frozen_int((np.asarray(order)[:, None] * width + np.arange(width)).ravel())
        sorted_rows = sparse.csr_array(A)[self._rows][:, self._rows]
        ordered = sparse.bsr_array(sorted_rows, blocksize=(width, width))
        blocks = np.zeros((parts, width, width))
        row = np.repeat(np.arange(parts), np.diff(ordered.indptr))
        on = row == ordered.indices
        blocks[row[on]] = ordered.data[on]
        try:
            inverses = np.linalg.inv(blocks)
        except np.linalg.LinAlgError:
            part = int(order[np.argmin(np.abs(np.linalg.det(blocks)))])
            raise np.linalg.LinAlgError(
                f"the matrix block of part {part}, unknowns {part * width}:{(part + 1) * width}, is singular"
            ) from None
        self._sweep, self._A = block_sweeps(width)[1], A
        pattern = frozen_index(ordered.indptr), frozen_index(ordered.indices)
        transposed = np.ascontiguousarray(inverses.transpose(0, 2, 1))  # as the kernel requires
        self._arrays = *pattern, *(frozen_float(each).reshape(-1) for each in (ordered.data, transposed))

    def before(self, b: Real) -> tuple[Real, Real]:
        """Return x ``(n,)`` after a sweep from 0, and the residual b − A x."""
        x = self.after(b, np.zeros(len(b)))
        return x, b - self._A @ x

    def after(self, b: Real, x: Real) -> Real:
        """Return x ``(n,)`` after a further sweep."""
        ordered, swept = np.ascontiguousarray(x[self._rows]), np.empty(len(x))
        self._sweep(*self._arrays, frozen(b[self._rows], np.float64), ordered, 1)
        swept[self._rows] = ordered
        return swept
