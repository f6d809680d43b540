"""The iterations around a multigrid cycle, by name."""

from __future__ import annotations

from typing import Any, Final, Literal

import numpy as np
from scipy.sparse.linalg import LinearOperator

from agglo_core.authoring import Float, History, OptionError, Tell, pcg, solvers, to_nobody
from agglo_polydg_mg.paper.stationary import Step, stationary

Cycle = Literal["V", "W", "F", "K"]
Outer = Literal["cg", "flexible_cg", "stationary"]

CYCLES: Final = ("V", "W", "F", "K")
OUTER: Final = ("cg", "flexible_cg", "stationary")

_WAY_OUT: Final = "take outer=flexible_cg or outer=stationary"
_ROUNDING: Final = 1e-7
"""What two products may differ by, relative to their factors."""


def require_together(cycle: str, outer: str) -> None:
    """Raise OptionError for a cycle that the outer iteration cannot use."""
    if outer == "cg" and cycle in ("F", "K"):
        how = "not symmetric" if cycle == "F" else "not linear"
        raise OptionError(f"conjugate gradients cannot use the {cycle}-cycle, which is {how}: {_WAY_OUT}")


def require_linear(M: LinearOperator, made_of: str) -> None:
    """Raise OptionError if a cycle is not linear and symmetric, as conjugate gradients need it.

    Parameters
    ----------
    M : (n, n) LinearOperator
        Tried on three vectors.
    made_of : str
        What it is made of, for the message.
    """
    u, v = np.random.default_rng(1).standard_normal((2, M.shape[0]))
    Mu, Mv, both = M @ u, M @ v, M @ (2.0 * u - 3.0 * v)
    size = np.linalg.norm(Mu) + np.linalg.norm(Mv)
    bent = float(np.linalg.norm(both - 2.0 * Mu + 3.0 * Mv))
    apart = abs(float(u @ Mv - v @ Mu)) / (np.linalg.norm(u) + np.linalg.norm(v))
    for wrong, gap in (("linear", bent), ("symmetric", apart)):
        if not gap <= _ROUNDING * size:
            raise OptionError(
                f"conjugate gradients need a preconditioner that is linear and symmetric; the cycle made of "
                f"{made_of} is not {wrong}: {_WAY_OUT}"
            )


def iterate(
    outer: Outer,
    fine: solvers.FineSystem,
    M: LinearOperator,
    tolerance: float,
    most: int,
    tell: Tell = to_nobody,
) -> History:
    """Solve the system on the mesh from 0, with a cycle M for the approximate inverse.

    Converged is said where both the residual and an estimate of the energy error are ``tolerance`` or less.

    Parameters
    ----------
    outer : "cg", "flexible_cg" or "stationary"
        Conjugate gradients, for an M that is linear and symmetric; :class:`FlexibleSteps`, for any; or
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
            tell=tell,
        )
    step = FlexibleSteps(fine.A, M) if outer == "flexible_cg" else _added(fine.A, M)
    return stationary(fine.A, fine.b, step, tolerance, most, fine.measure, tell)


def _added(A: Any, M: LinearOperator) -> Step:
    return lambda b, x: x + M @ (b - A @ x if x.any() else b)


class FlexibleSteps:
    """Steps ``(b, x)`` to the next x of flexible conjugate gradients, for a cycle that need not be linear.

    Each direction is made conjugate to the one before, the step is the best along it: FCG(1) of Notay, SIAM
    J. Sci. Comput. 22 (2000). Meant for one iteration, each x being that of the last step.
    """

    def __init__(self, A: Any, M: LinearOperator) -> None:
        self._A, self._M = A, M
        self._last: tuple[Float, Float, float] | None = None

    def __call__(self, b: Float, x: Float) -> Float:
        """Return the next x ``(n,)``; LinAlgError if the matrix turns out not to be positive definite."""
        r = b - self._A @ x if x.any() else b
        p = self._M @ r
        if self._last is not None:
            before, image, size = self._last
            p = p - ((p @ image) / size) * before
        Ap = self._A @ p
        curvature = float(p @ Ap)
        if not curvature > 0.0:
            if p.any():
                raise np.linalg.LinAlgError("the matrix is not positive definite")
            return x
        self._last = p, Ap, curvature
        better: Float = x + (float(p @ r) / curvature) * p
        return better
