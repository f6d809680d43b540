"""The V-cycle on any number of levels, its stationary iteration, and plain conjugate gradients."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_polydg_mg.gauge import Gauge
from agglo_polydg_mg.schwarz import Smoother, Solve

__all__ = ["History", "Level", "Step", "conjugate_gradients", "stationary", "unsolved", "v_cycle"]

Step = Callable[[Float, Float], Float]
"""One iteration: right-hand side and iterate ``(n,)`` to the next iterate."""

_HOPELESS = 1e6
"""Growth of the residual at which a stationary iteration is given up."""
_MET = "tolerance met"


@dataclass(frozen=True)
class Level:
    """A level of a cycle that is smoothed: matrix, prolongation from the next one, smoother."""

    A: Any
    P: Any
    smooth: Smoother


@dataclass(frozen=True, eq=False)
class History:
    """An iterate ``x (n,)`` and the 2-norms of residuals that led to it, the first before any iteration."""

    x: Float
    residuals: Float
    converged: bool
    reason: str

    @property
    def iterations(self) -> int:
        """Number of iterations."""
        return len(self.residuals) - 1


def v_cycle(levels: Sequence[Level], coarsest: Solve, b: Float, x: Float) -> Float:
    """One V-cycle from ``x (n,)``: smooth, correct by the next level, smooth.

    Parameters
    ----------
    levels : sequence of Level
        Finest first; without any, ``coarsest`` solves.
    coarsest : callable
        Solves on the coarsest level.
    b, x : (n,) float
    """
    if not levels:
        return coarsest(b)
    here, below = levels[0], levels[1:]
    x = here.smooth(b, x)
    residual = here.P.T @ (b - here.A @ x)
    x = x + here.P @ v_cycle(below, coarsest, residual, np.zeros(len(residual)))
    return here.smooth(b, x)


def stationary(
    A: Any, b: Float, step: Step, tolerance: float, most: int, gauge: Gauge | None = None
) -> History:
    """Repeat ``x = step(b, x)`` from 0 until the residual is small, at most ``most`` times.

    It is small when ``gauge`` says ``tolerance`` or less; by default that is ‖b − A x‖ ≤ tolerance ‖b‖. A
    matrix that is found not to be positive definite ends the iteration, with the reason.
    """
    gauge = gauge or Gauge(b)
    x, r, reason = np.zeros(len(b)), b, ""
    residuals = [float(np.linalg.norm(b))]
    while not (converged := gauge(r) <= tolerance) and len(residuals) <= most:
        try:
            x = step(b, x)
        except np.linalg.LinAlgError as error:
            reason = f"{error} (iteration {len(residuals)})"
            break
        r = b - A @ x
        residuals.append(float(np.linalg.norm(r)))
        if not residuals[-1] <= _HOPELESS * residuals[0]:
            reason = f"diverged: residual {residuals[-1]:.1e} after {len(residuals) - 1} iterations"
            break
    if not (converged or reason):
        done = len(residuals) - 1
        reason = f"relative residual {gauge(r):.1e} after {done} iterations, wanted {tolerance:.1e}"
    return History(frozen_float(x), frozen_float(residuals), converged, reason or _MET)


def unsolved(b: Float, reason: str) -> History:
    """The history of a method that could not start."""
    return History(frozen_float(np.zeros(len(b))), frozen_float([np.linalg.norm(b)]), False, reason)


def conjugate_gradients(
    A: Any, b: Float, tolerance: float = 1e-6, most: int = 10_000, gauge: Gauge | None = None
) -> History:
    """Plain conjugate gradients from 0, with the test of :func:`stationary`, at most ``most`` iterations.

    The recursion's residual is tested, and where it is small enough b − A x as well. As in MATLAB's
    ``pcg``, an iteration that does not converge returns the iterate of smallest residual, whose number is
    the length of the history; ``reason`` says how many iterations were done.
    """
    gauge = gauge or Gauge(b)
    x, r = np.zeros(len(b)), b.copy()
    p, rho, why = r, float(r @ r), ""
    residuals, sizes, best = [float(np.sqrt(rho))], [gauge(r)], x
    smallest = 0
    while sizes[-1] > tolerance and len(residuals) <= most:
        Ap = A @ p
        curvature = float(p @ Ap)
        if not curvature > 0.0:
            why = "the matrix is not positive definite: "
            break
        alpha = rho / curvature
        x, r = x + alpha * p, r - alpha * Ap
        rho, before = float(r @ r), rho
        p = r + (rho / before) * p
        residuals.append(float(np.sqrt(rho)))
        sizes.append(_confirmed(gauge, tolerance, r, A, b, x))
        if sizes[-1] < sizes[smallest]:
            best, smallest = x, len(sizes) - 1
    converged, done = sizes[smallest] <= tolerance, len(sizes) - 1
    reason = f"{why}smallest relative residual {sizes[smallest]:.1e} in iteration {smallest} of {done}"
    reason = _MET if converged else f"{reason}, wanted {tolerance:.1e}"
    return History(frozen_float(best), frozen_float(residuals[: smallest + 1]), converged, reason)


def _confirmed(gauge: Gauge, tolerance: float, r: Float, A: Any, b: Float, x: Float) -> float:
    """Size of the recursion's residual; of b − A x where that would end the iteration."""
    size = gauge(r)
    return size if size > tolerance else max(size, gauge(b - A @ x))
