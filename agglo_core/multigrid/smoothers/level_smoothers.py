"""Smoothers of multigrid levels, by name or from components of kind ``smoother``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np

from agglo_core.errors import OptionError
from agglo_core.multigrid.matrices.block_matrix import BlockMatrix, block_matrix
from agglo_core.multigrid.smoothers.adapted import adapted
from agglo_core.multigrid.smoothers.spectrum import largest_eigenvalue
from agglo_core.multigrid.stack import LevelSmoother, Real
from agglo_core.problems import MultigridLevel

SetUp = Callable[[MultigridLevel, Any], LevelSmoother]
"""Builds a smoother from a level in double precision and the dtype of its vectors."""


class GaussSeidel:
    """Block Gauss–Seidel: forward sweeps before the coarse correction, backward sweeps after.

    As a plain smoother, ``smooth(b, x)`` sweeps forward and then backward.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.csr_array(2.0 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    >>> from agglo_core.multigrid import GaussSeidel, build_stack, cycle, pcg
    >>> P = sparse.csr_array(np.kron(np.eye(3), np.ones((2, 1))))
    >>> stack = build_stack(A, np.array([0, 2, 4, 6]), [P], smoother=GaussSeidel())
    >>> pcg(A, np.ones(6), cycle(stack)).converged
    True
    """

    uses_coarse: ClassVar[bool] = False

    def setup(self, level: MultigridLevel, dtype: Any = np.float64) -> _BlockGaussSeidel:
        """Return the level smoother, with ``level.steps`` sweeps over the parts.

        Raises
        ------
        OptionError
            If the matrix is not symmetric.
        LinAlgError
            If a part's block is not positive definite.
        """
        return self.on(block_matrix(level.A, level.block_offsets, dtype), level.steps)

    @staticmethod
    def on(matrix: BlockMatrix, steps: int = 1) -> _BlockGaussSeidel:
        """Return the smoother for a prepared level matrix."""
        return _BlockGaussSeidel(matrix, steps)


@dataclass(frozen=True, eq=False)
class _BlockGaussSeidel:
    A: BlockMatrix
    steps: int

    def before(self, b: Real) -> tuple[Real, Real]:
        return self.A.forward_from_zero(b, self.steps)

    def after(self, b: Real, x: Real) -> Real:
        return self.A.backward(b, x, self.steps)

    def __call__(self, b: Real, x: Real) -> Real:
        forward = self.A.forward(b, np.array(x, self.A.dtype), self.steps)
        return self.A.backward(b, forward, self.steps)


class BlockJacobi:
    """Block Jacobi steps, damped by 4/(3 λ_max).

    Notes
    -----
    λ_max belongs to D⁻¹A, with the diagonal blocks D of the parts
    (:func:`~agglo_core.multigrid.largest_eigenvalue`).

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.csr_array(2.0 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    >>> from agglo_core.multigrid import BlockJacobi, build_stack, cycle, pcg
    >>> P = sparse.csr_array(np.kron(np.eye(3), np.ones((2, 1))))
    >>> stack = build_stack(A, np.array([0, 2, 4, 6]), [P], smoother=BlockJacobi())
    >>> pcg(A, np.ones(6), cycle(stack)).converged
    True
    """

    uses_coarse: ClassVar[bool] = False

    def setup(self, level: MultigridLevel, dtype: Any = np.float64) -> _BlockPolynomial:
        """Return the level smoother, with ``level.steps`` steps.

        Exceptions are those of :class:`GaussSeidel`.
        """
        A = block_matrix(level.A, level.block_offsets, dtype)
        damping = 4.0 / (3.0 * largest_eigenvalue(A, A.inverses.__matmul__))
        return _BlockPolynomial(A, tuple((0.0, damping) for _ in range(level.steps)))


class Chebyshev:
    """Chebyshev polynomial in D⁻¹A, with the diagonal blocks D of the parts.

    The polynomial is small from λ_max / ``ratio`` to λ_max
    (:func:`~agglo_core.multigrid.largest_eigenvalue`).

    Parameters
    ----------
    degree : int
        Matrix applications per step.
    ratio : float
        Ratio of λ_max to the smallest eigenvalue to be smoothed.

    Notes
    -----
    M. Adams, M. Brezina, J. Hu, R. Tuminaro, J. Comput. Phys. 188, 2003.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.csr_array(2.0 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    >>> from agglo_core.multigrid import Chebyshev, build_stack, cycle, pcg
    >>> P = sparse.csr_array(np.kron(np.eye(3), np.ones((2, 1))))
    >>> stack = build_stack(A, np.array([0, 2, 4, 6]), [P], smoother=Chebyshev(3))
    >>> pcg(A, np.ones(6), cycle(stack)).converged
    True
    """

    uses_coarse: ClassVar[bool] = False

    def __init__(self, degree: int = 2, ratio: float = 4.0) -> None:
        if not isinstance(degree, int) or degree < 1:
            raise OptionError(f"degree must be a whole number, at least 1; given {degree!r}")
        if not 1.0 < ratio < np.inf:
            raise OptionError(f"ratio must be larger than 1; given {ratio!r}")
        self.degree, self.ratio = degree, float(ratio)

    def setup(self, level: MultigridLevel, dtype: Any = np.float64) -> _BlockPolynomial:
        """Return the level smoother, with ``level.steps`` steps.

        Exceptions are those of :class:`GaussSeidel`.
        """
        A = block_matrix(level.A, level.block_offsets, dtype)
        most = 1.05 * largest_eigenvalue(A, A.inverses.__matmul__)  # the estimate may be slightly low
        centre, radius = 0.5 * (most + most / self.ratio), 0.5 * (most - most / self.ratio)
        return _BlockPolynomial(A, _chebyshev(centre, radius, self.degree) * level.steps)


def _chebyshev(centre: float, radius: float, degree: int) -> tuple[tuple[float, float], ...]:
    """Return the factors α, β per Chebyshev step (Saad, Iterative Methods, algorithm 12.1)."""
    sigma = centre / radius
    rho = 1.0 / sigma
    steps = [(0.0, 1.0 / centre)]
    for _ in range(degree - 1):
        after = 1.0 / (2.0 * sigma - rho)
        steps.append((after * rho, 2.0 * after / radius))
        rho = after
    return tuple(steps)


@dataclass(frozen=True, eq=False)
class _BlockPolynomial:
    """Smoother by steps d ← α d + β D⁻¹ r, x ← x + d: a self-adjoint polynomial in D⁻¹A."""

    A: BlockMatrix
    factors: tuple[tuple[float, float], ...]

    def before(self, b: Real) -> tuple[Real, Real]:
        x, r = self._stepped(np.array(b, self.A.dtype))
        return x, r - self.A @ x

    def after(self, b: Real, x: Real) -> Real:
        x = np.asarray(x, self.A.dtype)
        done: Real = x + self._stepped(np.asarray(b, self.A.dtype) - self.A @ x)[0]
        return done

    def __call__(self, b: Real, x: Real) -> Real:
        return self.after(b, x)

    def _stepped(self, b: Real) -> tuple[Real, Real]:
        x = d = np.zeros_like(b)
        for step, (again, fresh) in enumerate(self.factors):
            r = b - self.A @ x if step else b
            d = b.dtype.type(again) * d + b.dtype.type(fresh) * (self.A.inverses @ r)
            x = x + d
        return x, b


_Own = GaussSeidel | BlockJacobi | Chebyshev

SMOOTHERS: Final[Mapping[str, Callable[[], _Own]]] = {
    "block_jacobi": BlockJacobi,
    "chebyshev": Chebyshev,
    "gauss_seidel": GaussSeidel,
}
"""Built-in smoothers by name. Their ``setup`` also accepts the dtype of the vectors."""


def smoother_setup(given: Any) -> SetUp:
    """Return the function that sets up a smoother on a level.

    Parameters
    ----------
    given : str, object with ``setup``, or callable
        A name in :data:`SMOOTHERS`, a built-in smoother, a component of kind ``smoother``, or a function
        of level and dtype that returns a :class:`~agglo_core.multigrid.LevelSmoother`.

    Raises
    ------
    OptionError
        For any other object.

    Examples
    --------
    >>> from agglo_core.multigrid import smoother_setup
    >>> callable(smoother_setup("gauss_seidel"))
    True
    """
    if isinstance(given, str) and given in SMOOTHERS:
        given = SMOOTHERS[given]()
    if isinstance(given, _Own):
        return given.setup
    if callable(getattr(given, "setup", None)) and not isinstance(given, type):
        return lambda level, dtype: adapted(given, level, f"smoother {type(given).__name__}")
    if callable(given) and not isinstance(given, type):
        setup: SetUp = given
        return setup
    raise OptionError(
        f"smoother must be one of {', '.join(SMOOTHERS)}, an object with setup(level), or a function "
        f"of level and dtype; given {given!r:.60}"
    )
