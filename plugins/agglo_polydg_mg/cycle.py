"""The V-cycle on any number of levels, its stationary iteration, and plain conjugate gradients."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_polydg_mg.schwarz import Smoother, Solve

__all__ = ["History", "Level", "Step", "conjugate_gradients", "stationary", "unsolved", "v_cycle"]

Step = Callable[[Float, Float], Float]
"""One iteration: right-hand side and iterate ``(n,)`` to the next iterate."""

_HOPELESS = 1e6
"""Growth of the residual at which a stationary iteration is given up."""


@dataclass(frozen=True)
class Level:
    """A level of a cycle that is smoothed: matrix, prolongation from the next one, smoother."""

    A: Any
    P: Any
    smooth: Smoother


@dataclass(frozen=True, eq=False)
class History:
    """An iterate ``x (n,)`` and the residual norms that led to it, the first one before any iteration."""

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


def stationary(A: Any, b: Float, step: Step, tolerance: float, most: int) -> History:
    """Repeat ``x = step(b, x)`` from 0 until ‖b − A x‖ ≤ tolerance ‖b‖, at most ``most`` times.

    A matrix that is found not to be positive definite ends the iteration, with the reason.
    """
    x = np.zeros(len(b))
    residuals = [float(np.linalg.norm(b))]
    least, hopeless = tolerance * residuals[0], _HOPELESS * residuals[0]
    reason = ""
    while residuals[-1] > least and len(residuals) <= most and not reason:
        try:
            x = step(b, x)
        except np.linalg.LinAlgError as error:
            reason = str(error)
            break
        residuals.append(float(np.linalg.norm(b - A @ x)))
        if not residuals[-1] <= hopeless:
            reason = f"diverged: residual {residuals[-1]:.1e} after {len(residuals) - 1} iterations"
    return _history(x, residuals, least, reason)


def unsolved(b: Float, reason: str) -> History:
    """The history of a method that could not start."""
    return History(frozen_float(np.zeros(len(b))), frozen_float([np.linalg.norm(b)]), False, reason)


def conjugate_gradients(A: Any, b: Float, tolerance: float = 1e-6, most: int = 10_000) -> History:
    """Plain conjugate gradients from 0 until ‖r‖ ≤ tolerance ‖b‖, at most ``most`` iterations.

    As in MATLAB's ``pcg``, an iteration that does not converge returns the iterate of smallest residual,
    whose number is the length of the history.
    """
    x, r = np.zeros(len(b)), b.copy()
    p, rho = r, float(r @ r)
    residuals, best, reason = [float(np.sqrt(rho))], x, ""
    least, smallest = tolerance * residuals[0], 0
    while residuals[-1] > least and len(residuals) <= most:
        Ap = A @ p
        curvature = float(p @ Ap)
        if not curvature > 0.0:
            reason = "the matrix is not positive definite"
            break
        alpha = rho / curvature
        x, r = x + alpha * p, r - alpha * Ap
        rho, before = float(r @ r), rho
        p = r + (rho / before) * p
        residuals.append(float(np.sqrt(rho)))
        if residuals[-1] < residuals[smallest]:
            best, smallest = x, len(residuals) - 1
    if residuals[-1] > least and not reason:
        size = residuals[smallest]
        reason = f"smallest residual {size:.1e} in iteration {smallest} of {most}, wanted {least:.1e}"
    return _history(best, residuals[: smallest + 1], least, reason)


def _history(x: Float, residuals: list[float], least: float, reason: str) -> History:
    converged = residuals[-1] <= least
    reason = reason or (
        "tolerance met"
        if converged
        else f"residual {residuals[-1]:.1e} after {len(residuals) - 1} iterations, wanted {least:.1e}"
    )
    return History(frozen_float(x), frozen_float(residuals), converged, reason)
