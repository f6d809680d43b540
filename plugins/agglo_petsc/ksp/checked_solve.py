"""Solution by a PETSc ``KSP``, with checks of the true residual and the error's energy norm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from agglo_core.authoring import Float, History, OptionError, frozen_float
from agglo_core.problems.iteration_history import MET, TESTS
from agglo_core.problems.residuals.sizes import size_ratio
from agglo_petsc.matrices import entries, petsc

_DIGIT: Final = 0.1
"""Relative residual at which the solve for the error ends, about the relative accuracy of the error estimate.
A smaller value makes each check longer (benchmarks/petsc.py)."""
_CHECK: Final = 60
"""Maximum number of iterations for the error estimate: a check that needs more counts as failed."""
_ROUNDS: Final = 6
"""Maximum number of restarts of conjugate gradients from the true residual."""
_WHY: Final = {
    "DIVERGED_MAX_IT": ("most iterations", ""),
    "DIVERGED_INDEFINITE_PC": ("indefinite preconditioner", "the preconditioner is not positive definite: "),
    "DIVERGED_INDEFINITE_MAT": ("indefinite matrix", "the matrix is not positive definite: "),
    "DIVERGED_NANORINF": ("matrix not finite", "values are not finite: "),
    "DIVERGED_PCSETUP_FAILED": ("matrix not finite", "the levels cannot be set up: "),
}


def solve(
    ksp: Any,
    b: Any,
    *,
    tolerance: float = 1e-6,
    max_iterations: int = 300,
    measure: Callable[[Float], float] | None = None,
) -> History:
    """Solve A x = b with initial guess zero, and check the accuracy of x.

    Collective. The solution counts as converged if the true residual b − A x and an estimate of the error
    in the energy norm are at most ``tolerance``. A second solve for the residual determines the error to
    one digit. If the error is too large, it is added to x, and the iteration continues. If x is accurate,
    iterations of that check are not counted.

    Parameters
    ----------
    ksp : petsc4py.PETSc.KSP
        Set up for a symmetric positive definite matrix. Its tolerances are changed and restored.
    b : petsc4py.PETSc.Vec
    tolerance : float
        Below 1.
    max_iterations : int
    measure : callable, optional
        Maps the residual entries on this rank to a number, equal on all ranks. By default ‖r‖ / ‖b‖.

    Returns
    -------
    History
        ``x (n_own,)`` is the solution on this rank.

    Raises
    ------
    OptionError
        For a tolerance outside 0..1, or without iterations.
    """
    if not 0.0 < tolerance < 1.0 or max_iterations < 1:
        raise OptionError(
            f"tolerance must be between 0 and 1 and max_iterations 1 or more; given {tolerance!r} and "
            f"{max_iterations!r}"
        )
    before, kind, guess = ksp.getTolerances(), ksp.getNormType(), ksp.getInitialGuessNonzero()
    ksp.setNormType(petsc().KSP.NormType.UNPRECONDITIONED)
    try:
        run = _Run(ksp, b, tolerance, max_iterations, measure)
        return run.history()
    finally:
        ksp.setTolerances(*before)
        ksp.setNormType(kind)
        ksp.setInitialGuessNonzero(guess)
        ksp.setConvergenceHistory(0)


@dataclass(eq=False)
class _Run:
    """State of a checked solve: iterate, true residual, and residual history."""

    ksp: Any
    b: Any
    tolerance: float
    most: int
    measure: Callable[[Float], float] | None
    residuals: list[float] = field(default_factory=list)
    error: float = np.inf
    ended: str = ""

    def __post_init__(self) -> None:
        self.A = self.ksp.getOperators()[0]
        self.x, self.r = self.b.duplicate(), self.b.copy()
        self.x.set(0.0)
        self.first = float(self.b.norm())
        self.residuals.append(self.first)
        self.size, rounds, target = (0.0 if self.first == 0.0 else np.inf), 0, self.tolerance
        if self.first == 0.0:
            self.error = 0.0
        # Alternate iterations and error checks
        while not self.right and self.done < self.most and rounds < _ROUNDS and not self.ended:
            before = self.size
            self._iterate(target)
            if self.size > self.tolerance:
                target *= 0.5 * self.tolerance / max(self.size, 1e-300)
                target = max(target, 1e-300)
                self.ended = self.ended or ("stagnation" if not self.size < 0.9 * before else "")
            else:
                self._check()
            rounds += 1

    @property
    def done(self) -> int:
        """Iteration count."""
        return len(self.residuals) - 1

    @property
    def right(self) -> bool:
        """True if both the residual and the estimated energy error are small enough."""
        return self.size <= self.tolerance and self.error <= self.tolerance

    def _iterate(self, wanted: float) -> None:
        """Continue with conjugate gradients until their recursively updated residual is small enough."""
        self._solve(self.b, self.x, wanted * self.first, self.most - self.done, from_zero=self.done == 0)
        norms = self.ksp.getConvergenceHistory()[1:]
        reason = self.ksp.getConvergedReason()
        self.r = self.b - self.A * self.x
        self.residuals.extend(float(each) for each in norms)
        self.residuals[-1] = float(self.r.norm())
        self.size = self._measured()
        self.ended = _name(reason) if reason < 0 else ""

    def _check(self) -> None:
        """Estimate the error of the iterate, and correct the iterate if the error is too large."""
        # 1. Solve A c = r for the error c
        c = self.b.duplicate()
        self._solve(self.r, c, _DIGIT * float(self.r.norm()), _CHECK, from_zero=True)
        square, energy = float(c.dot(self.r)), float(self.b.dot(self.x))
        has_failed = self.ksp.getConvergedReason() < 0 or square < 0.0 or energy < 0.0
        self.error = np.inf if has_failed else size_ratio(float(np.sqrt(square)), float(np.sqrt(energy)))
        # 2. Correct the iterate
        if self.error > self.tolerance:
            norms = self.ksp.getConvergenceHistory()[1:]
            self.ended = _name(self.ksp.getConvergedReason()) if has_failed else ""
            self.x.axpy(1.0, c)
            self.r = self.b - self.A * self.x
            self.residuals.extend(float(norm) for norm in norms)
            self.residuals[-1], self.size = float(self.r.norm()), self._measured()
        c.destroy()

    def _solve(self, b: Any, x: Any, size: float, most: int, *, from_zero: bool) -> None:
        self.ksp.setConvergenceHistory(most + 1, reset=True)
        self.ksp.setTolerances(rtol=0.0, atol=size, divtol=1e10, max_it=most)
        self.ksp.setInitialGuessNonzero(not from_zero)
        failure = None
        try:
            self.ksp.solve(b, x)
        except petsc().Error as error:  # prefer a callback's exception to PETSc's error number
            failure = error.__cause__ or error
        if failure is not None:  # outside the handler, to avoid a circular cause
            raise failure

    def _measured(self) -> float:
        if self.measure is None:
            return size_ratio(float(self.r.norm()), self.first)
        return self.measure(entries(self.r))

    def history(self) -> History:
        """Return the result of the solve: x, residuals, reason for the end, and error estimate."""
        test_results = (self.size <= self.tolerance, self.error <= self.tolerance)
        ended: Any = "met" if self.right else (self.ended or "most iterations")
        energy_text = f", energy error about {self.error:.1e}" if np.isfinite(self.error) else ""
        reason_text = next((text for name, text in _WHY.values() if name == self.ended), "")
        sizes = f"relative residual {self.size:.1e}{energy_text} after {self.done} iterations"
        return History(
            entries(self.x),
            frozen_float(self.residuals),
            self.right,
            MET if self.right else f"{reason_text}{sizes}, required {self.tolerance:.1e}",
            self.error if np.isfinite(self.error) else None,
            tuple(name for name, ok in zip(TESTS, test_results, strict=True) if ok),
            ended,
            relative_residual=self.size,
        )


def _name(reason: int) -> str:
    """Convert PETSc's reason for the end of an iteration to agglo's."""
    reasons = petsc().KSP.ConvergedReason
    return next(
        (ended for name, (ended, _) in _WHY.items() if getattr(reasons, name) == reason), "stagnation"
    )
