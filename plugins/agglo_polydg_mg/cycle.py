"""The V-cycle on any number of levels, and its stationary iteration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from agglo_core.authoring import MET, Float, History, frozen_float
from agglo_polydg_mg.corrections import Corrections
from agglo_polydg_mg.residual_measure import ResidualMeasure
from agglo_polydg_mg.schwarz import Smooth, Solve

__all__ = ["SmoothedLevel", "Step", "stationary", "unsolved", "v_cycle"]

Step = Callable[[Float, Float], Float]
"""One iteration: maps right-hand side and iterate ``(n,)`` to the next iterate."""

_DIVERGED = 1e6
"""Growth of the residual at which a stationary iteration is given up."""


@dataclass(frozen=True)
class SmoothedLevel:
    """A multigrid level that is smoothed: matrix, prolongation from the next one, smoother."""

    A: Any
    P: Any
    smooth: Smooth


def v_cycle(levels: Sequence[SmoothedLevel], coarsest: Solve, b: Float, x: Float) -> Float:
    """One V-cycle from ``x (n,)``: smooth, correct by the next level, smooth.

    Parameters
    ----------
    levels : sequence of SmoothedLevel
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
    A: Any,
    b: Float,
    step: Step,
    tolerance: float,
    max_iterations: int,
    measure: ResidualMeasure | None = None,
) -> History:
    """Repeat ``x = step(b, x)`` from 0 until x is found to be right, at most ``max_iterations`` times.

    It is right when two things are ``tolerance`` or less: what ``measure`` says of b − A x, by default ‖b − A
    x‖ / ‖b‖, and the :class:`~agglo_polydg_mg.corrections.Corrections`' estimate of the energy error over the
    energy norm of x. The latter takes one more step, which is not counted. A matrix that is found not to be
    positive definite ends the iteration, with the reason.
    """
    measure = measure or ResidualMeasure(b)
    x, r, reason, error = np.zeros(len(b)), b, "", None
    residuals, corrections = [float(np.linalg.norm(b))], Corrections()
    while True:
        small = measure(r) <= tolerance
        if small and not r.any():
            error = 0.0
            break
        if not small and len(residuals) > max_iterations:
            break
        try:
            better = step(b, x)
        except np.linalg.LinAlgError as failure:
            reason = f"{failure} (iteration {len(residuals)})"
            break
        rest = b - A @ better
        corrections.add(better - x, r - rest)
        if small:
            error = corrections.error(r) / measure.energy(x)
            if error <= tolerance:
                break
        if len(residuals) > max_iterations:
            break
        x, r = better, rest
        residuals.append(float(np.linalg.norm(r)))
        if not residuals[-1] <= _DIVERGED * residuals[0]:
            reason = f"diverged: residual {residuals[-1]:.1e} after {len(residuals) - 1} iterations"
            break
    converged = error is not None and error <= tolerance
    if not (converged or reason):
        done = len(residuals) - 1
        reason = f"relative residual {measure(r):.1e} after {done} iterations, wanted {tolerance:.1e}"
    return History(frozen_float(x), frozen_float(residuals), converged, reason or MET, error)


def unsolved(b: Float, reason: str) -> History:
    """The history of a method that could not start."""
    return History(frozen_float(np.zeros(len(b))), frozen_float([np.linalg.norm(b)]), False, reason)
