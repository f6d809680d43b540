"""Run stationary iterations, and estimate the energy error from their corrections."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agglo_core.authoring import Float, History, Notify, frozen_float, solvers
from agglo_core.problems.iteration_history import MET, TESTS, iterated
from agglo_core.problems.residuals.sizes import size_ratio
from agglo_core.progress import ignore_progress

_KEPT = 5
"""Number of kept corrections: more of them show the error in more slow modes, and take more memory and time
(benchmarks/solve.py, row polydg_mg_paper)."""
_RATES = 3
"""Number of last ratios of corrections whose maximum is the rate: more of them make the error estimate safer,
and the iteration longer (benchmarks/solve.py, row polydg_mg_paper)."""
_INDEPENDENT = 1e-10
"""Gram matrix eigenvalues of unit vectors below this fraction of the largest count as 0."""


@dataclass(eq=False)
class Corrections:
    """Estimate the energy error e of an iterate from its last corrections d.

    Each correction is stored with A d. The estimate is the maximum of two approximate lower bounds of
    ‖e‖_A:

    - the norm of the projection of e on the corrections, known from d·A e = d·r with the residual r. It
      equals ‖e‖_A if only slow modes are left, however slow;
    - the norm of the last correction over 1 − ρ, where ρ is the largest of the last ratios of
      successive corrections. It equals ‖e‖_A if corrections continue to shrink at this rate.
    """

    _pairs: deque[tuple[Float, Float]] = field(default_factory=lambda: deque(maxlen=_KEPT))

    def add(self, correction: Float, image: Float) -> None:
        """Add the next correction d ``(n,)`` with A d."""
        self._pairs.append((correction, image))

    def error(self, r: Float) -> float:
        """Estimate ‖e‖_A, from the residual ``r (n,)`` that produced the last correction.

        The estimate is infinite if corrections do not shrink, A is not positive definite on them, or
        all are 0.
        """
        pairs = [(d, image) for d, image in self._pairs if d.any()]
        if not pairs:
            return float("inf")
        vectors, images = (np.array(each) for each in zip(*pairs, strict=True))
        gram = vectors @ images.T
        squares = np.diag(gram)
        if not (squares > 0.0).all():
            return float("inf")
        norms, stands = np.sqrt(squares), not self._pairs[-1][0].any()
        return max(_projection_norm(gram, vectors @ r, norms), 0.0 if stands else _sum_remaining_norms(norms))


def _projection_norm(gram: Float, products: Float, norms: Float) -> float:
    """Return the norm of a vector's projection on the span of other vectors.

    ``gram`` contains the inner products of the others, ``products`` their inner products with the
    vector.
    """
    unit = gram / np.outer(norms, norms)
    values, axes = np.linalg.eigh(0.5 * (unit + unit.T))
    kept = values > _INDEPENDENT * values[-1]
    along = (axes.T @ (products / norms))[kept]
    return float(np.sqrt(np.sum(along**2 / values[kept])))


def _sum_remaining_norms(norms: Float) -> float:
    """Extrapolate the sum of the norms of the last and all further corrections, at their recent rate."""
    rate = float((norms[1:] / norms[:-1])[-_RATES:].max(initial=0.0))
    return float(norms[-1]) / (1.0 - rate) if rate < 1.0 else float("inf")


Step = Callable[[Float, Float], Float]
"""One iteration: maps right-hand side and iterate ``(n,)`` to the next iterate."""

_DIVERGED = 1e6
"""Residual growth above which a stationary iteration stops."""


def stationary(
    A: Any,
    b: Float,
    step: Step,
    tolerance: float,
    max_iterations: int,
    measure: solvers.ResidualMeasure | None = None,
    notify: Notify = ignore_progress,
) -> History:
    """Repeat ``x = step(b, x)`` from 0 until x is accurate, at most ``max_iterations`` times.

    Both of these must be at most ``tolerance``: the ``measure`` of b − A x, by default ‖b − A x‖ / ‖b‖;
    and the energy error estimated by :class:`~agglo_polydg_mg.paper.stationary.Corrections`, relative
    to the energy norm of x. The second test takes an additional step, not counted if x passes. A matrix
    that proves not to be positive definite ends the iteration, with the reason. In this case, or on
    divergence, an iterate worse than 0 is replaced by the iterate with the smallest residual, and its
    number is the history length.
    """
    run = _Run(A, b, step, tolerance, measure or solvers.ResidualMeasure(b))
    while not run.reason and (run.small or run.done < max_iterations):
        notify(*iterated(run.done, run.size, tolerance))
        following = run.following()
        if run.done == max_iterations:
            break
        if not run.reason:
            run.go_on(*following)
    return run.history()


class _Run:
    """State of a stationary iteration: iterate, residual and history."""

    def __init__(
        self, A: Any, b: Float, step: Step, tolerance: float, measure: solvers.ResidualMeasure
    ) -> None:
        self.A, self.b, self.step, self.tolerance, self.measure = A, b, step, tolerance, measure
        self.residuals: list[float] = []
        self.corrections, self.reason, self.least = Corrections(), "", (np.inf, b, 0)
        self.go_on(np.zeros(len(b)), b)
        if not b.any():
            self.error, self.reason = 0.0, MET

    @property
    def done(self) -> int:
        """Iteration count."""
        return len(self.residuals) - 1

    def go_on(self, x: Float, r: Float) -> None:
        """Accept the next iterate and its residual, and end the run if the residual has grown too large."""
        self.x, self.r, self.error = x, r, float("inf")
        self.residuals.append(float(np.linalg.norm(r)))
        self.size = self.measure(r)
        self.small = self.size <= self.tolerance
        if self.size < self.least[0]:
            self.least = self.size, x, len(self.residuals)
        if not self.residuals[-1] <= _DIVERGED * self.residuals[0]:
            self.reason = f"diverged: residual {self.residuals[-1]:.1e} after {self.done} iterations"

    def following(self) -> tuple[Float, Float]:
        """Return the next iterate and its residual, and end the run if the current iterate is accurate."""
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
        """Return the convergence history, with the best iterate if the run diverged."""
        # A failed run returns its best iterate
        test_results = (self.small, self.error <= self.tolerance)
        energy_text = f", energy error about {self.error:.1e}" if self.small else ""
        failure = f"relative residual {self.size:.1e}{energy_text} after {self.done} iterations"
        if self.reason and not self.residuals[-1] <= self.residuals[0]:
            _, self.x, count = self.least
            self.residuals = self.residuals[:count]
        return History(
            frozen_float(self.x),
            frozen_float(self.residuals),
            self.reason == MET,
            self.reason or f"{failure}, required {self.tolerance:.1e}",
            self.error if np.isfinite(self.error) else None,
            tuple(name for name, ok in zip(TESTS, test_results, strict=True) if ok),
        )
