"""The smoother ``two_sweeps``."""

from __future__ import annotations

from collections.abc import Callable

from scipy import sparse
from scipy.sparse.linalg import spsolve_triangular

from agglo_core.authoring import Float, MultigridLevel

__all__ = ["GaussSeidel"]


class GaussSeidel:
    """A sweep of Gauss and Seidel through the unknowns and one back, as often as there are steps."""

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
