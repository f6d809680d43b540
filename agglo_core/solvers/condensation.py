"""Static condensation: elimination of unknowns that are coupled within one cell only."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, Int, frozen_float, frozen_int


@dataclass(frozen=True, eq=False)
class Condensation:
    """System A x = b with its inner unknowns eliminated by the Schur complement.

    Attributes
    ----------
    A : (n, n) sparse
    b : (n,) float
    outer : (m,) int
    inner : (cells, k) int
        Unknowns of each cell, coupled to no inner unknowns of other cells.
    inverse : (cells * k, cells * k) sparse
        Inverse of the inner blocks.

    Examples
    --------
    >>> import numpy as np
    >>> A = np.array([[2.0, 0.0, -1.0], [0.0, 2.0, -1.0], [-1.0, -1.0, 4.0]])
    >>> condensed = Condensation.of(A, np.ones(3), np.array([[2]]))
    >>> condensed.matrix.toarray(), condensed.load
    (array([[ 1.75, -0.25],
           [-0.25,  1.75]]), array([1.25, 1.25]))
    >>> condensed.recover(np.linalg.solve(condensed.matrix.toarray(), condensed.load)).round(3)
    array([0.833, 0.833, 0.667])
    """

    A: Any
    b: Float
    outer: Int
    inner: Int
    inverse: Any

    @classmethod
    def of(cls, A: Any, b: Float, inner: Int) -> Self:
        """Split a system. Raises LinAlgError for a singular inner block."""
        A, flat = sparse.csr_array(A), inner.ravel()
        outer = np.setdiff1d(np.arange(A.shape[0]), flat)
        cells, width = inner.shape
        blocks = np.zeros((cells, width, width))
        within = sparse.coo_array(A[flat][:, flat])
        blocks[within.row // width, within.row % width, within.col % width] = within.data
        inverse = sparse.bsr_array((np.linalg.inv(blocks), np.arange(cells), np.arange(cells + 1)))
        return cls(A, b, frozen_int(outer), inner, sparse.csr_array(inverse))

    @property
    def matrix(self) -> Any:
        """Schur complement ``(m, m)``."""
        to_inner = self.A[self.inner.ravel()][:, self.outer]
        schur = self.A[self.outer][:, self.outer] - to_inner.T @ (self.inverse @ to_inner)
        return sparse.csr_array(0.5 * (schur + schur.T))

    @property
    def load(self) -> Float:
        """Right-hand side ``(m,)`` of the outer unknowns."""
        inside = self.inverse @ self.b[self.inner.ravel()]
        return frozen_float(self.b[self.outer] - self.A[self.outer][:, self.inner.ravel()] @ inside)

    def with_load(self, load: Float) -> Self:
        """Return the system with ``load (n,)`` added to the right-hand side."""
        return replace(self, b=frozen_float(self.b + load))

    def recover(self, x: Float) -> Float:
        """Return all unknowns ``(n,)`` from the outer ones ``(m,)``."""
        whole, inner = np.empty(len(self.b)), self.inner.ravel()
        whole[self.outer] = x
        whole[inner] = self.inverse @ (self.b[inner] - self.A[inner][:, self.outer] @ x)
        return frozen_float(whole)
