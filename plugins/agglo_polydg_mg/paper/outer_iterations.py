"""Outer iterations around a multigrid cycle: cg, flexible_cg and stationary."""

from __future__ import annotations

from typing import Any, Final, Literal

import numpy as np
from scipy.sparse.linalg import LinearOperator

from agglo_core.authoring import Float, History, Notify, OptionError, pcg, solvers
from agglo_core.progress import ignore_progress
from agglo_polydg_mg.paper.stationary import Step, stationary

Cycle = Literal["V", "W", "F", "K"]
Outer = Literal["cg", "flexible_cg", "stationary"]

CYCLES: Final = ("V", "W", "F", "K")
OUTER: Final = ("cg", "flexible_cg", "stationary")

_WAY_OUT: Final = "use outer=flexible_cg or outer=stationary"
_ROUNDING: Final = 1e-7
"""Tolerance for equality of two products, relative to their factors."""


def require_together(cycle: str, outer: str) -> None:
    """Raise OptionError if the outer iteration cannot use the cycle."""
    if outer == "cg" and cycle in ("F", "K"):
        how = "not symmetric" if cycle == "F" else "not linear"
        raise OptionError(f"conjugate gradients cannot use the {cycle}-cycle, which is {how}: {_WAY_OUT}")


def require_linear(M: LinearOperator, made_of: str) -> None:
    """Raise OptionError unless a cycle is linear and symmetric, as conjugate gradients require.

    Parameters
    ----------
    M : (n, n) LinearOperator
        Tested on three vectors.
    made_of : str
        Description of the cycle for the message.
    """
    u, v = np.random.default_rng(1).standard_normal((2, M.shape[0]))
    Mu, Mv, both = M @ u, M @ v, M @ (2.0 * u - 3.0 * v)
    size = np.linalg.norm(Mu) + np.linalg.norm(Mv)
    bent = float(np.linalg.norm(both - 2.0 * Mu + 3.0 * Mv))
    apart = abs(float(u @ Mv - v @ Mu)) / (np.linalg.norm(u) + np.linalg.norm(v))
    for wrong, gap in (("linear", bent), ("symmetric", apart)):
        if not gap <= _ROUNDING * size:
            raise OptionError(
                "conjugate gradients require a linear and symmetric preconditioner, but the cycle with "
                f"{made_of} is not {wrong}: {_WAY_OUT}"
            )


def iterate(
    outer: Outer,
    fine: solvers.FineSystem,
    M: LinearOperator,
    tolerance: float,
    most: int,
    notify: Notify = ignore_progress,
) -> History:
    """Solve the system on the mesh by iteration from 0, with a cycle M as approximate inverse.

    The solution counts as converged if both the residual and an estimate of the energy error are at
    most ``tolerance``.

    Parameters
    ----------
    outer : "cg", "flexible_cg" or "stationary"
        Conjugate gradients, for a linear and symmetric M; :class:`FlexibleSteps`, for any; or
        x + M (b − A x).
    """
    if outer == "cg":
        return pcg(
            fine.A,
            fine.b,
            M,
            tolerance=tolerance,
            most=most,
            stop="both",
            measure=fine.measure,
            energy=fine.measure.energy,
            notify=notify,
        )
    step = FlexibleSteps(fine.A, M) if outer == "flexible_cg" else _correction_step(fine.A, M)
    return stationary(fine.A, fine.b, step, tolerance, most, fine.measure, notify)


def _correction_step(A: Any, M: LinearOperator) -> Step:
    return lambda b, x: x + M @ (b - A @ x if x.any() else b)


class FlexibleSteps:
    """Iterate flexible conjugate gradients, for a cycle that may be nonlinear.

    Maps ``(b, x)`` to the next x. Each direction is made conjugate to the previous direction, and the
    step minimises along it: FCG(1), Notay, SIAM J. Sci. Comput. 22 (2000). An instance serves a single
    iteration: each x must be the result of the last step.
    """

    def __init__(self, A: Any, M: LinearOperator) -> None:
        self._A, self._M = A, M
        self._last: tuple[Float, Float, float] | None = None

    def __call__(self, b: Float, x: Float) -> Float:
        """Return the next iterate x ``(n,)``.

        Raises
        ------
        LinAlgError
            If the matrix proves not to be positive definite.
        """
        # 1. Preconditioned residual
        r = b - self._A @ x if x.any() else b
        p = self._M @ r
        # 2. Make the direction conjugate to the last direction
        if self._last is not None:
            before, image, size = self._last
            p = p - ((p @ image) / size) * before
        # 3. Minimise along the direction
        Ap = self._A @ p
        curvature = float(p @ Ap)
        if not curvature > 0.0:
            if p.any():
                raise np.linalg.LinAlgError("the matrix is not positive definite")
            return x
        self._last = p, Ap, curvature
        better: Float = x + (float(p @ r) / curvature) * p
        return better
