"""Static condensation: elimination of unknowns that are coupled within one cell only."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, Int, frozen_float, frozen_int


@dataclass(frozen=True, eq=False)
class Condensation:
    """Symmetric system A x = b with its inner unknowns eliminated by the Schur complement.

    Attributes
    ----------
    A : (n, n) sparse
    b : (n,) float
    outer : (m,) int
    inner : (cells, k) int
        Unknowns of each cell, coupled to no inner unknowns of other cells.
    coupling : (cells * k, m) sparse
        Rows of the inner unknowns, columns of the outer ones.
    root : (cells * k, cells * k) sparse
        L⁻¹ of the inner blocks L Lᵀ.

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
    coupling: Any
    root: Any

    @classmethod
    def of(cls, A: Any, b: Float, inner: Int) -> Self:
        """Split a system. Raises LinAlgError for an inner block that is not positive definite."""
        A, flat = sparse.csr_array(A), inner.ravel()
        outer = np.setdiff1d(np.arange(A.shape[0]), flat)
        cells, width = inner.shape
        blocks = np.zeros((cells, width, width))
        rows = A[flat]
        within = sparse.coo_array(rows[:, flat])
        blocks[within.row // width, within.row % width, within.col % width] = within.data
        roots = np.linalg.inv(np.linalg.cholesky(blocks)), np.arange(cells), np.arange(cells + 1)
        root = sparse.csr_array(sparse.bsr_array(roots))
        return cls(A, b, frozen_int(outer), inner, sparse.csr_array(rows[:, outer]), root)

    @property
    def matrix(self) -> Any:
        """Schur complement ``(m, m)``."""
        W = self.root @ self.coupling
        return sparse.csr_array(self.A[self.outer][:, self.outer] - W.T @ W)

    @property
    def load(self) -> Float:
        """Right-hand side ``(m,)`` of the outer unknowns."""
        inside = self._solve(self.b[self.inner.ravel()])
        return frozen_float(self.b[self.outer] - self.coupling.T @ inside)

    def with_load(self, load: Float) -> Self:
        """Return the system with ``load (n,)`` added to the right-hand side."""
        return replace(self, b=frozen_float(self.b + load))

    def recover(self, x: Float) -> Float:
        """Return all unknowns ``(n,)`` from the outer ones ``(m,)``."""
        whole, inner = np.empty(len(self.b)), self.inner.ravel()
        whole[self.outer] = x
        whole[inner] = self._solve(self.b[inner] - self.coupling @ x)
        return frozen_float(whole)

    def _solve(self, r: Float) -> Float:
        """Return the inner blocks' solutions for ``r (cells * k,)``."""
        return np.asarray(self.root.T @ (self.root @ r))
