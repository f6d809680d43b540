"""Plain conjugate gradients: the baseline for every method."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.problems.ritz import RitzValue
from agglo_core.problems.sizes import Measure, energy_of_solution, relative_to, size_ratio

__all__ = ["MET", "TESTS", "History", "conjugate_gradients"]

MET = "tolerance met"
"""The reason of an iteration that converged."""
TESTS = ("residual", "energy error")
"""What has to be small for that."""
_INDEFINITE = "the matrix is not positive definite: "
_UNDERFLOW = "r·r is too small for floating-point numbers, scale b: "


@dataclass(frozen=True, eq=False)
class History:
    """An iterate ``x (n,)`` and the 2-norms of residuals that led to it, the first before any iteration.

    ``energy_error`` is an estimate of the error of x in the energy norm, relative to that of x, None if there
    is none; ``tests`` are those of ``"residual"`` and ``"energy error"`` that x has passed.
    """

    x: Float
    residuals: Float
    converged: bool
    reason: str
    energy_error: float | None = None
    tests: tuple[str, ...] = ()

    @property
    def iterations(self) -> int:
        """Number of iterations."""
        return len(self.residuals) - 1


def conjugate_gradients(
    A: Any,
    b: Float,
    tolerance: float = 1e-6,
    most: int = 10_000,
    measure: Measure | None = None,
    energy: Measure | None = None,
) -> History:
    """Plain conjugate gradients from 0 until residual and energy error are ``tolerance`` or less.

    Parameters
    ----------
    A : (n, n) sparse
    b : (n,) float
    tolerance : float
    most : int
        Iterations.
    measure : callable, optional
        Of residuals; by default ‖r‖ / ‖b‖.
    energy : callable, optional
        Of x: the norm that ‖e‖_A is compared with, e being the error; by default (b·x)^½.

    Notes
    -----
    Where the recursion's residual is small enough ‖e‖_A is estimated from the coefficients of the iteration,
    and b − A x is computed. If it turns out to be another vector the iteration starts afresh from it, and is
    given up once that gains nothing. As in MATLAB's ``pcg``, an iteration that does not converge returns the
    iterate of smallest residual, whose number is the length of the history; ``reason`` says how many
    iterations were done.
    """
    claim = _Claim(A, b, tolerance, measure or relative_to(b), energy or energy_of_solution(b))
    run = _Run(A, np.zeros(len(b)), b.copy())
    residuals, sizes = [float(np.sqrt(run.rho))], [claim.measure(run.r)]
    best, smallest = run.x, 0
    claim.met, claim.why = not b.any(), _UNDERFLOW if b.any() and not run.rho else ""
    while not (claim.met or claim.why) and len(residuals) <= most:
        if not run.step():
            claim.why = _INDEFINITE
            break
        residuals.append(float(np.sqrt(run.rho)))
        sizes.append(claim.check(run))
        if sizes[-1] < sizes[smallest] or claim.met:
            best, smallest = run.x, len(sizes) - 1
    kept, passed = frozen_float(residuals[: smallest + 1]), TESTS[: sizes[smallest] <= tolerance]
    if claim.met:
        return History(frozen_float(best), kept, True, MET, claim.error, TESTS)
    reason = claim.failed(sizes[smallest], smallest, len(sizes) - 1)
    return History(frozen_float(best), kept, False, reason, None, passed)


@dataclass(eq=False)
class _Run:
    """The recursion: iterate, its residual, direction, r·r."""

    A: Any
    x: Float
    r: Float
    ritz: RitzValue = field(default_factory=RitzValue)

    def __post_init__(self) -> None:
        self.p, self.rho = self.r, float(self.r @ self.r)

    def step(self) -> bool:
        """One iteration; False if the matrix is found not to be positive definite."""
        Ap = self.A @ self.p
        curvature = float(self.p @ Ap)
        if not curvature > 0.0:
            return False
        alpha = self.rho / curvature
        self.x, self.r = self.x + alpha * self.p, self.r - alpha * Ap
        self.rho, before = float(self.r @ self.r), self.rho
        self.p = self.r + (self.rho / before) * self.p
        self.ritz.add(alpha, self.rho / before)
        return True

    def restart(self, r: Float) -> None:
        """Go on from another residual of the same iterate."""
        self.r = self.p = r
        self.rho = float(r @ r)
        self.ritz.restart()

    def energy_error(self) -> float:
        """‖e‖_A ≤ r·r / (θ p·p)^½, θ the smallest eigenvalue (Meurant, Tichý, Numer. Algorithms 82, 2019)."""
        return self.rho / float(np.sqrt(self.ritz.least * (self.p @ self.p))) if self.rho else 0.0


@dataclass(eq=False)
class _Claim:
    """Whether an iteration may be called converged: ``met`` says so, ``why`` says that it never will."""

    A: Any
    b: Float
    tolerance: float
    measure: Measure
    energy: Measure
    met: bool = False
    why: str = ""
    error: float = 0.0
    _scale: float = 0.0
    _replaced: float = np.inf

    def check(self, run: _Run) -> float:
        """Size of the residual of a run, the true one where that decides."""
        size = self.measure(run.r)
        if not size <= self.tolerance:
            return size
        if self._scale and not size_ratio(run.energy_error(), self._scale) <= self.tolerance:
            return size  # even by a Ritz value from before
        if not run.ritz.refresh() > 0.0:
            self.why = _INDEFINITE
            return size
        self._scale = self.energy(run.x)
        self.error = size_ratio(run.energy_error(), self._scale)
        if not self.error <= self.tolerance:
            return size
        true = self.b - self.A @ run.x
        drift = float(np.linalg.norm(true - run.r))
        self.error += size_ratio(drift / float(np.sqrt(run.ritz.least)), self._scale)
        size = max(size, self.measure(true))
        self.met = size <= self.tolerance and self.error <= self.tolerance
        if not self.met:
            self.why = "rounding lets b − A x fall no further: " if size > 0.5 * self._replaced else ""
            self._replaced = size
            run.restart(true)
        return size

    def failed(self, size: float, at: int, done: int) -> str:
        """The reason of an iteration that has not converged."""
        near = f", energy error about {self.error:.1e}" if size <= self.tolerance else ""
        wanted = f"smallest relative residual {size:.1e} in iteration {at} of {done}{near}"
        return f"{self.why}{wanted}, wanted {self.tolerance:.1e}"
