"""Preconditioned conjugate gradients for one right-hand side, with stopping tests and restarts.

The iteration is a generator that yields requests for products, so that products of several columns are
computed together.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.multigrid.krylov.lanczos import failure
from agglo_core.multigrid.krylov.recursion import Recursion
from agglo_core.multigrid.krylov.stopping import (
    SAID,
    Iterate,
    Restarts,
    Rules,
    Steps,
    is_rounding,
    probe_ritz_value,
)
from agglo_core.problems.iteration_history import MET, TESTS, Ended, History
from agglo_core.problems.residuals.sizes import Measure, size_ratio, two_norm

_CONJUGATE = 0.3
"""Bound of |zᵢ₊₁·rᵢ| / zᵢ₊₁·rᵢ₊₁, which is 0 for linear symmetric M. Above, a step is lost.
Benchmark: benchmarks/constants.py."""
_LOST = 4
"""Number of lost steps, in total, that ends the iteration (benchmarks/constants.py)."""
_DIGIT = 0.01
"""A step that reduces z·r below this factor, a digit of the error, is never lost.
Benchmark: benchmarks/constants.py."""
_DRIFT = 0.1
"""Maximum relative drift of the recursive residual from b − A x. Above, the recursion restarts.
Benchmark: benchmarks/constants.py."""
_LUCK = 2.0
"""Sizes above this factor times the tolerance cannot pass the tests by a different rounding of x.
Benchmark: benchmarks/constants.py."""
_STILL = 3
"""Number of successive steps below rounding of x that ends the iteration (benchmarks/constants.py)."""
_KNOWN = ("met", "most iterations", "stagnation")
"""Ends for which the coefficients give the error."""


@dataclass(eq=False)
class Column:
    """Preconditioned conjugate gradients for one right-hand side ``b (n,)``, from ``start (n,)``.

    :class:`~agglo_core.multigrid.krylov.recursion.Recursion` makes the steps. Where the tests may be passed,
    b − A x replaces the recursive residual. If both differ much, the recursion restarts from b − A x.
    """

    b: Float
    start: Float
    rules: Rules
    measure: Measure
    energy: Measure
    ended: Ended = ""
    size: float = 1.0  # relative size of the residual
    residuals: list[float] = field(default_factory=list)
    gains: list[float] = field(default_factory=list)
    _cg: Recursion = field(init=False)
    _error: float = np.inf  # relative error in the energy norm, as far as known
    _energy_norm: float = 0.0  # energy norm of x when last computed
    _gained: float = 0.0  # sum of the gains
    _exact: bool = True  # the residual is b − A x itself
    _drifted: bool = False  # the exact residual differs too much: restart
    _restarts: Restarts = field(default_factory=Restarts)
    _stuck: bool = False  # restarts gain nothing: last chance for the tests
    _least: Iterate | None = None  # iterate with smallest residual
    _still: int = 0  # successive steps below rounding of x
    _lost: int = 0  # steps with loss of conjugacy
    _first_pass: int | None = None  # iteration when the tests were first passed
    _next_test: int = 0  # iteration of the next test
    _probed_until: int = 0  # validity of the last probe: twice its iteration

    @property
    def done(self) -> int:
        """Iteration count."""
        return len(self.residuals) - 1

    def run(self) -> Steps:
        """Run the iteration until ``ended`` gives a reason, and yield requests for matrix products."""
        yield from self._begin()
        while not self.ended:
            if self._least is None or self.size < self._least[0]:
                self._least = (self.size, self._cg.x, self._cg.r)
            yield from self._iterate()
        if self._least is not None and (self._cg.curvatures.flat or self.ended not in _KNOWN):
            yield from self._fall_back(self._least)
        if not self._exact or self._still >= _STILL:
            yield from self._settle()
        if self.ended not in _KNOWN:
            # Without reliable coefficients the error is unknown.
            self._error = np.inf

    def history(self) -> History:
        """Return the iteration history, with the last iterate and the outcome."""
        error = self._error if np.isfinite(self._error) else None
        sizes = (self.size, self._error)
        tests = tuple(name for name, value in zip(TESTS, sizes, strict=True) if value <= self.rules.tolerance)
        met = self.ended == "met"
        reason = MET if met else self._reason(error)
        x, residuals, gains = (frozen_float(value) for value in (self._cg.x, self.residuals, self.gains))
        norm = self._energy_norm
        outcome = History(x, residuals, met, reason, error, tests, self.ended, self.size, gains, norm)
        if not met or not self.done or self._cg.alpha == 0.0:
            return outcome
        return replace(outcome, correction=frozen_float(self._cg.alpha * self._cg.p))

    def _reason(self, error: float | None) -> str:
        known = ", energy error unknown" if error is None else f", energy error about {error:.1e}"
        known = "" if self.rules.stop == "residual" else known
        sizes = f"relative residual {self.size:.1e}{known} after {self.done} iterations"
        return f"{SAID.get(self.ended, '')}{sizes}, required {self.rules.tolerance:.1e}"

    # The iteration

    def _begin(self) -> Steps:
        """Compute the first residual and the first search direction."""
        x = self.start if self.b.any() else np.zeros(len(self.b))
        r = self.b - (yield "A", x) if x.any() else self.b
        self._cg = Recursion(x, r)
        self.residuals.append(two_norm(r))
        self.size = self.measure(r)
        if not np.isfinite(self.residuals[0]):
            self.ended = "matrix not finite"
        elif not r.any():
            self._error, self.ended = 0.0, "met"
        else:
            yield from self._precondition()
            self._cg.restart()

    def _iterate(self) -> Steps:
        """Make one step and apply the stopping tests, or end the iteration if no step is possible."""
        # 1. Limits on iterations and on steps without effect.
        cg = self._cg
        if self._still >= _STILL or self.rules.exhausted(self.residuals, self.size):
            self.ended = "stagnation" if self._still >= _STILL else "most iterations"
            return
        # 2. Curvature p·A p. A flat direction may be a null vector of A.
        Ap = yield "A", cg.p
        if cg.curve(Ap):
            self.ended = failure(cg.p, Ap, (yield "|A|", cg.p))
            if self.ended:
                return
        cg.ritz.least = min(cg.ritz.least, cg.curvature / cg.pp)  # θ is below every Rayleigh quotient
        cg.move(Ap, cg.along())
        self._count(cg.gain)
        yield from self._replace_residual()
        if not self.ended:
            yield from self._precondition()
        if not self.ended:
            self._turn()
        if not self.ended and self._drifted:
            yield from self._judge_restart()
        if not self.ended and self._exact and (self._stuck or self._passes()):
            yield from self._confirm()
        if not self.ended and self._stuck:
            self.ended = "stagnation"

    def _count(self, gain: float) -> None:
        """Record the reduction of ‖e‖_A² by a step."""
        self.gains.append(gain)
        self._gained += gain
        self._still = self._still + 1 if gain <= np.finfo(float).eps ** 2 * self._gained else 0

    def _precondition(self) -> Steps:
        """Compute z = M r, and end the iteration unless z·r > 0."""
        cg = self._cg
        cg.precondition((yield "M", cg.r))
        if not np.isfinite(cg.zr):
            self.ended = "preconditioner not finite"
        elif not cg.zr > 0.0 and cg.r.any():
            tiny = not float(cg.r @ cg.r) > 0.0
            self.ended = "underflow" if tiny else "indefinite preconditioner"

    def _turn(self) -> None:
        """Compute the next search direction, or end the iteration after too many losses of conjugacy."""
        cg, cross = self._cg, self._cg.cross()
        self._lost += abs(cross) > _CONJUGATE * cg.zr and cg.zr > _DIGIT * cg.zr_before
        if self._lost >= _LOST:
            self.ended = "loss of conjugacy"
        elif self._drifted or not cg.alpha > 0.0:
            cg.restart()
        else:
            cg.turn(cross if self.rules.beta == "flexible" else 0.0)

    # Residuals computed from x, and restarts

    def _replace_residual(self) -> Steps:
        """Replace the recursive residual by b − A x if x may pass the stopping tests."""
        cg = self._cg
        length, self.size = two_norm(cg.r), self.measure(cg.r)
        self._exact, self._drifted = self._near(length / self.residuals[-1]), False
        if self._exact:
            exact = self.b - (yield "A", cg.x)
            self._drifted = _differ(cg.r, exact)
            cg.r, length, self.size = exact, two_norm(exact), self.measure(exact)
        self.residuals.append(length)
        if not np.isfinite(length):
            self.ended = "matrix not finite"

    def _near(self, fall: float) -> bool:
        """Return True if x may pass the stopping tests, with ``fall`` times the last residual."""
        count = len(self.residuals)
        if count & (count - 1) == 0:
            self._energy_norm = self.energy(self._cg.x)
        tolerance, stop = self.rules.tolerance, self.rules.stop
        norm = max(self._energy_norm, float(np.sqrt(self._gained)))
        small = self.size <= tolerance or stop == "energy"
        close = self._cg.error_bound() * fall <= 2.0 * tolerance * norm or stop == "residual"
        return count >= self._next_test and small and close

    def _judge_restart(self) -> Steps:
        """Record a restart, and return to the best iterate if restarts no longer reduce the error."""
        cg = self._cg
        self._stuck = self._restarts.add((self.size, cg.x, cg.r), cg.error_bound())
        self._estimate()
        if not (self._stuck or self._small(_LUCK)):
            self._stuck = yield from is_rounding(cg.r, cg.x, self.b)
        if self._stuck and self._restarts.best[1] is not cg.x:
            self.size, cg.x, cg.r = self._restarts.best
            self.residuals[-1] = two_norm(cg.r)
            yield from self._precondition()
            cg.restart()

    # The tests

    def _passes(self) -> bool:
        """Return True if x passes the stopping tests, as did the iterate a tenth of the iterations before."""
        self._estimate()
        if not self._small():
            self._first_pass, self._next_test = None, self.done + 1 + self.done // 20
            return False
        self._first_pass = self.done if self._first_pass is None else self._first_pass
        self._next_test = self._first_pass + self._first_pass // 10
        return self.done >= self._next_test or not self._cg.r.any()

    def _small(self, factor: float = 1.0) -> bool:
        most, stop = factor * self.rules.tolerance, self.rules.stop
        return (self.size <= most or stop == "energy") and (self._error <= most or stop == "residual")

    def _confirm(self) -> Steps:
        """End as converged, unless extra products reveal a larger error or a smaller eigenvalue."""
        cg = self._cg
        if self.rules.stop != "residual" and cg.r.any():
            yield from self._compare()
            if self.rules.probe and self._probed_until < self.done and self._small():
                self._probed_until = 2 * self.done
                theta = yield from probe_ritz_value(len(self.b), self.done)
                if not theta > 0.0:
                    self.ended = "indefinite preconditioner"
                    return
                cg.ritz.least = min(cg.ritz.least, theta)
            self._estimate()
        if self._small():
            self.ended = "met"

    def _compare(self) -> Steps:
        """Lower the Ritz value θ if the error bound is below r·r / (r·Ar)^½ ≤ ‖e‖_A (for any M)."""
        cg = self._cg
        Ar = yield "A", cg.r
        length = max(0.0, float(cg.r @ Ar)) ** 0.5
        least = float(cg.r @ cg.r) / length if length > 0.0 else 0.0
        cg.ritz.least *= min(1.0, cg.error_bound() / least) ** 2 if least else 1.0
        self._estimate()

    def _estimate(self) -> None:
        """Estimate the relative error in the energy norm."""
        self._cg.ritz.refresh()
        self._energy_norm = self.energy(self._cg.x)
        self._error = size_ratio(self._cg.error_bound(), self._energy_norm)

    # After the end

    def _fall_back(self, least: Iterate) -> Steps:
        """Return to the iterate with smallest residual, as later iterates may follow a null vector of A."""
        cg = self._cg
        if not least[0] >= self.size:
            (self.size, cg.x, cg.r), self._exact = least, False
        if self.ended == "singular matrix" and (yield from is_rounding(cg.r, cg.x, self.b)):
            self.ended = "stagnation"  # the load lies in the range of A, up to rounding

    def _settle(self) -> Steps:
        """Compute b − A x for the last iterate, and estimate its error if the coefficients are reliable."""
        cg = self._cg
        exact = self.b - (yield "A", cg.x)
        differ = _differ(cg.r, exact)
        cg.r, self.size, self._exact = exact, self.measure(exact), True
        self.residuals[-1] = two_norm(exact)
        self._error = np.inf
        if differ and self.ended == "loss of conjugacy":
            self.ended = "stagnation"  # caused by rounding, not by the preconditioner
        if self.ended == "stagnation":
            yield from self._precondition()
            cg.restart()
        if not differ or self.ended == "stagnation":
            self._estimate()


def _differ(r: Float, exact: Float) -> bool:
    return not two_norm(exact - r) <= _DRIFT * two_norm(exact)
