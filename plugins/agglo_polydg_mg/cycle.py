"""The V-cycle on any number of levels, and its stationary iteration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from agglo_core.authoring import MET, Float, History, frozen_float
from agglo_polydg_mg.gauge import Gauge
from agglo_polydg_mg.schwarz import Smooth, Solve

__all__ = ["Level", "Step", "stationary", "unsolved", "v_cycle"]

Step = Callable[[Float, Float], Float]
"""One iteration: right-hand side and iterate ``(n,)`` to the next iterate."""

_HOPELESS = 1e6
"""Growth of the residual at which a stationary iteration is given up."""


@dataclass(frozen=True)
class Level:
    """A level of a cycle that is smoothed: matrix, prolongation from the next one, smoother."""

    A: Any
    P: Any
    smooth: Smooth


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
    return History(frozen_float(x), frozen_float(residuals), converged, reason or MET)


def unsolved(b: Float, reason: str) -> History:
    """The history of a method that could not start."""
    return History(frozen_float(np.zeros(len(b))), frozen_float([np.linalg.norm(b)]), False, reason)
