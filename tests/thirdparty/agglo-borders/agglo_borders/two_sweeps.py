"""Smoother ``two_sweeps``."""

from __future__ import annotations

from collections.abc import Callable

from scipy import sparse
from scipy.sparse.linalg import spsolve_triangular

from agglo_core.authoring import Float, MultigridLevel

__all__ = ["GaussSeidel"]


class GaussSeidel:
    """Symmetric Gauss-Seidel: a forward and a backward sweep per step."""

    def setup(self, level: MultigridLevel) -> Callable[[Float, Float], Float]:
        """Return ``smooth(b, x)``."""
        A = sparse.csr_array(level.A)
        lower, upper = sparse.csr_array(sparse.tril(A)), sparse.csr_array(sparse.triu(A))

        def smooth(b: Float, x: Float) -> Float:
            for _ in range(level.steps):
                x = x + spsolve_triangular(lower, b - A @ x)
                x = x + spsolve_triangular(upper, b - A @ x, lower=False)
            return x

        return smooth
