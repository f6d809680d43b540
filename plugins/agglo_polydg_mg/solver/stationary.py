"""Stationary iterations: a step that is repeated until the solution is right."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from agglo_core.authoring import (
    MET,
    TESTS,
    Float,
    History,
    Tell,
    frozen_float,
    iterated,
    size_ratio,
    to_nobody,
)
from agglo_polydg_mg.solver.corrections import Corrections
from agglo_polydg_mg.solver.residual_measure import ResidualMeasure

Step = Callable[[Float, Float], Float]
"""One iteration: maps right-hand side and iterate ``(n,)`` to the next iterate."""

_DIVERGED = 1e6
"""Growth of the residual at which a stationary iteration is given up."""


def stationary(
    A: Any,
    b: Float,
    step: Step,
    tolerance: float,
    max_iterations: int,
    measure: ResidualMeasure | None = None,
    tell: Tell = to_nobody,
) -> History:
    """Repeat ``x = step(b, x)`` from 0 until x is found to be right, at most ``max_iterations`` times.

    Two things have to be ``tolerance`` or less: what ``measure`` says of b − A x, by default ‖b − A x‖ / ‖b‖;
    then the energy error as :class:`~agglo_polydg_mg.solver.corrections.Corrections` see it, over the energy
    norm of x. This takes one more step, which is not counted if x is right. A matrix that is found not to be
    positive definite ends the iteration, with the reason. After that, or once it diverges, an iterate that is
    worse than 0 is replaced by that of least residual, whose number is the length of the history.
    """
    run = _Run(A, b, step, tolerance, measure or ResidualMeasure(b))
    while not run.reason and (run.small or run.done < max_iterations):
        tell(*iterated(run.done, run.size, tolerance))
        following = run.following()
        if run.done == max_iterations:
            break
        if not run.reason:
            run.go_on(*following)
    return run.history()


class _Run:
    """An iterate of a stationary iteration, its residual, and what led to it."""

    def __init__(self, A: Any, b: Float, step: Step, tolerance: float, measure: ResidualMeasure) -> None:
        self.A, self.b, self.step, self.tolerance, self.measure = A, b, step, tolerance, measure
        self.residuals: list[float] = []
        self.corrections, self.reason, self.least = Corrections(), "", (np.inf, b, 0)
        self.go_on(np.zeros(len(b)), b)
        if not b.any():
            self.error, self.reason = 0.0, MET

    @property
    def done(self) -> int:
        """Number of iterations."""
        return len(self.residuals) - 1

    def go_on(self, x: Float, r: Float) -> None:
        """Take the next iterate and its residual; ends the run if that has grown too large."""
        self.x, self.r, self.error = x, r, float("inf")
        self.residuals.append(float(np.linalg.norm(r)))
        self.size = self.measure(r)
        self.small = self.size <= self.tolerance
        if self.size < self.least[0]:
            self.least = self.size, x, len(self.residuals)
        if not self.residuals[-1] <= _DIVERGED * self.residuals[0]:
            self.reason = f"diverged: residual {self.residuals[-1]:.1e} after {self.done} iterations"

    def following(self) -> tuple[Float, Float]:
        """The next iterate and its residual; ends the run if they show that this one is right."""
        try:
            x = self.step(self.b, self.x)
        except np.linalg.LinAlgError as failure:
            self.reason = f"{failure} (iteration {self.done + 1})"
            return self.x, self.r
        r = self.b - self.A @ x
        self.corrections.add(x - self.x, self.r - r)
        if self.small:
            self.error = size_ratio(self.corrections.error(self.r), self.measure.energy(self.x))
            self.reason = MET if self.error <= self.tolerance else ""
        return x, r

    def history(self) -> History:
        """How it ended."""
        passed = (self.small, self.error <= self.tolerance)
        beside = f", energy error about {self.error:.1e}" if self.small else ""
        failed = f"relative residual {self.size:.1e}{beside} after {self.done} iterations"
        if self.reason and not self.residuals[-1] <= self.residuals[0]:
            _, self.x, count = self.least
            self.residuals = self.residuals[:count]
        return History(
            frozen_float(self.x),
            frozen_float(self.residuals),
            self.reason == MET,
            self.reason or f"{failed}, wanted {self.tolerance:.1e}",
            self.error if np.isfinite(self.error) else None,
            tuple(name for name, ok in zip(TESTS, passed, strict=True) if ok),
        )


def unsolved(b: Float, reason: str) -> History:
    """The history of a method that could not start."""
    return History(frozen_float(np.zeros(len(b))), frozen_float([np.linalg.norm(b)]), False, reason)
