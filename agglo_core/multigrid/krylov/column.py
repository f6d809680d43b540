"""Preconditioned conjugate gradients for one right-hand side, and whether they may claim to have converged.

The iteration is a generator that yields the products it needs: those of several columns are made together.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.multigrid.krylov.curvatures import Curvatures, failure
from agglo_core.multigrid.krylov.ritz import RitzValue
from agglo_core.multigrid.krylov.stopping import SAID, Iterate, Restarts, Rules, Steps, is_rounding, probed
from agglo_core.problems.iteration_history import MET, TESTS, Ended, History
from agglo_core.problems.sizes import Measure, size_ratio, two_norm

_CONJUGATE = 0.3
"""|zᵢ₊₁·rᵢ| over zᵢ₊₁·rᵢ₊₁, 0 if M is linear and symmetric: above this a step is lost."""
_LOST = 4
"""Steps lost until an iteration is given up."""
_DIGIT = 0.01
"""A step by which z·r falls below this part, a digit of the error, is not lost whatever it is."""
_DRIFT = 0.1
"""Part of b − A x by which the residual of the recursion may differ from it; else it starts afresh."""
_LUCK = 2.0
"""Times the tolerance: what is larger does not pass the tests by another rounding of x."""
_STILL = 3
"""Steps that move x by less than rounding until an iteration is given up."""
_KNOWN = ("met", "most iterations", "stagnation")
"""Ends at which the coefficients tell the error."""


@dataclass(eq=False)
class Column:
    """Preconditioned conjugate gradients for one right-hand side ``b (n,)``, from ``x (n,)``.

    With z = M r, coefficients are those of the Lanczos process of M A, whose smallest Ritz value θ falls to
    the smallest eigenvalue. So ‖e‖_A² = r·A⁻¹r ≤ (z·r)² / (θ p·M⁻¹p), with p·M⁻¹p = z·r plus β² times that
    of the direction before (Meurant, Tichý, Numer. Algorithms 82, 2019).
    """

    b: Float
    x: Float
    rules: Rules
    measure: Measure
    energy: Measure
    ended: Ended = ""
    size: float = 1.0  # of the residual, relative
    residuals: list[float] = field(default_factory=list)
    gains: list[float] = field(default_factory=list)  # squares of the energy norms of the steps
    _base: Float | None = None  # x is this, unless it is None, and what was added since
    _added: Float = field(init=False)
    _error: float = np.inf  # in the energy norm, relative, as far as it is known
    _ritz: RitzValue = field(default_factory=RitzValue)
    _true: bool = True  # r is b − A x itself
    _afresh: bool = False  # and so far from that of the recursion that this has to start again
    _restarts: Restarts = field(default_factory=Restarts)
    _stuck: bool = False  # they gain nothing: x passes the tests now or never
    _scale: float = 0.0  # energy norm of x when last asked for
    _least: Iterate | None = None  # that of least residual
    _curvatures: Curvatures = field(default_factory=Curvatures)
    _length: float = 0.0  # of the last step, in units of its direction
    _moved: float = 0.0  # squares of the energy norms of all steps
    _still: int = 0
    _lost: int = 0
    _passed: int | None = None  # iterations when the tests were first passed
    _wait: int = 0  # iterations before they are asked again
    _certain: int = 0  # iterations up to which the last probe holds: twice those it came after

    @property
    def done(self) -> int:
        """Iterations so far."""
        return len(self.residuals) - 1

    def run(self) -> Steps:
        """Iterate until ``ended``."""
        yield from self._start()
        while not self.ended:
            if self._least is None or self.size < self._least[0]:
                self._least = (self.size, self.x, self.r)
            yield from self._step()
        if self._least is not None and (self._curvatures.flat or self.ended not in _KNOWN):
            yield from self._fall_back(self._least)
        if not self._true or self._still >= _STILL:
            yield from self._settle()
        if self.ended not in _KNOWN:
            self._error = np.inf

    def history(self) -> History:
        """What came of it."""
        error = self._error if np.isfinite(self._error) else None
        sizes = (self.size, self._error)
        tests = tuple(name for name, each in zip(TESTS, sizes, strict=True) if each <= self.rules.tolerance)
        met = self.ended == "met"
        reason = MET if met else self._reason(error)
        x, residuals, gains = (frozen_float(each) for each in (self.x, self.residuals, self.gains))
        found = History(x, residuals, met, reason, error, tests, self.ended, self.size, gains, self._scale)
        if not met or not self.done or self._length == 0.0:
            return found
        return replace(found, correction=frozen_float(self._length * self.p))

    def _reason(self, error: float | None) -> str:
        known = ", energy error unknown" if error is None else f", energy error about {error:.1e}"
        known = "" if self.rules.stop == "residual" else known
        sizes = f"relative residual {self.size:.1e}{known} after {self.done} iterations"
        return f"{SAID.get(self.ended, '')}{sizes}, wanted {self.rules.tolerance:.1e}"

    def _start(self) -> Steps:
        if not self.b.any():
            self.x = np.zeros(len(self.b))
        self.r = self.b - (yield "A", self.x) if self.x.any() else self.b
        self.residuals.append(two_norm(self.r))
        self.size = self.measure(self.r)
        if not np.isfinite(self.residuals[0]):
            self.ended = "matrix not finite"
        elif not self.r.any():
            self._error, self.ended = 0.0, "met"
        else:
            yield from self._precondition()
            self._begin()

    def _begin(self) -> None:
        """Take the preconditioned residual for the direction; what is added from now on is rounded once."""
        self.p, self.pp = self.z, self.zr
        self._base, self._added = (self.x if self.x.any() else None), np.zeros(len(self.b))
        self._ritz.restart()

    def _precondition(self) -> Steps:
        """z = M r; the end if z·r is not what a positive definite M makes it."""
        self.z = yield "M", self.r
        self.zr = float(self.z @ self.r)
        if not np.isfinite(self.zr):
            self.ended = "preconditioner not finite"
        elif not self.zr > 0.0 and self.r.any():
            tiny = not float(self.r @ self.r) > 0.0
            self.ended = "underflow" if tiny else "indefinite preconditioner"

    def _step(self) -> Steps:
        """One iteration."""
        if self._still >= _STILL or self.rules.exhausted(self.residuals, self.size):
            self.ended = "stagnation" if self._still >= _STILL else "most iterations"
            return
        Ap = yield "A", self.p
        curvature, along = float(self.p @ Ap), float(self.p @ self.r)
        if self._curvatures.add(curvature, self.pp):
            self.ended = failure(self.p, Ap, (yield "|A|", self.p))
            if self.ended:
                return
        step = along / curvature  # p·r is z·r, and if M is poor the step that takes most from ‖e‖_A
        self._length = step
        self._added = self._added + step * self.p
        self.x = self._added if self._base is None else self._base + self._added
        self._count(step * along, curvature)
        before, zr = self.r, self.zr
        yield from self._residual(before - step * Ap)
        if not self.ended:
            yield from self._precondition()
        if not self.ended:
            self._turn(before, zr, step)
        if not self.ended and self._afresh:
            yield from self._note_progress()
        if not self.ended and self._true and (self._stuck or self._passes()):
            yield from self._confirm()
        if not self.ended and self._stuck:
            self.ended = "stagnation"

    def _count(self, gain: float, curvature: float) -> None:
        """Take note of what a step took from ‖e‖_A², and of the Rayleigh quotient of its direction."""
        self.gains.append(gain)
        self._moved += gain
        self._still = self._still + 1 if gain <= np.finfo(float).eps ** 2 * self._moved else 0
        self._ritz.least = min(self._ritz.least, curvature / self.pp)

    def _residual(self, r: Float) -> Steps:
        """The residual of the recursion or, where the tests may be passed, b − A x itself."""
        length, self.size = two_norm(r), self.measure(r)
        self._true, self._afresh = self._near(length / self.residuals[-1]), False
        if self._true:
            exact = self.b - (yield "A", self.x)
            self._afresh = self._drifted(r, exact)
            r, length, self.size = exact, two_norm(exact), self.measure(exact)
        self.r = r
        self.residuals.append(length)
        if not np.isfinite(length):
            self.ended = "matrix not finite"

    def _note_progress(self) -> Steps:
        """b − A x has become another than that of the recursion: give up if x has come no nearer."""
        self._stuck = self._restarts.add((self.size, self.x, self.r), self._bound())
        self._estimate()
        if not (self._stuck or self._small(_LUCK)):
            self._stuck = yield from is_rounding(self.r, self.x, self.b)
        if self._stuck and self._restarts.best[1] is not self.x:
            self.size, self.x, self.r = self._restarts.best
            self.residuals[-1] = two_norm(self.r)
            yield from self._precondition()
            self._begin()

    def _drifted(self, r: Float, exact: Float) -> bool:
        return not two_norm(exact - r) <= _DRIFT * two_norm(exact)

    def _near(self, fall: float) -> bool:
        """Whether x may pass the tests, the residual being ``fall`` times as long as the last."""
        count = len(self.residuals)
        if count & (count - 1) == 0:
            self._scale = self.energy(self.x)
        tolerance, stop = self.rules.tolerance, self.rules.stop
        size = max(self._scale, float(np.sqrt(self._moved)))
        small = self.size <= tolerance or stop == "energy"
        close = self._bound() * fall <= 2.0 * tolerance * size or stop == "residual"
        return count >= self._wait and small and close

    def _bound(self) -> float:
        """‖e‖_A at most, as far as θ is known."""
        if not self.zr:
            return 0.0
        return self.zr / float(np.sqrt(self._ritz.least * self.pp)) if self._ritz.least > 0.0 else np.inf

    def _turn(self, before: Float, zr: float, step: float) -> None:
        """The next direction; ``before`` and ``zr`` are r and z·r before the step."""
        cross = float(self.z @ before)
        self._lost += abs(cross) > _CONJUGATE * self.zr and self.zr > _DIGIT * zr
        if self._lost >= _LOST:
            self.ended = "loss of conjugacy"
        elif self._afresh or not step > 0.0:
            self._begin()
        else:
            self._ritz.add(step, self.zr / zr)
            beta = (self.zr - cross if self.rules.beta == "flexible" else self.zr) / zr
            self.p, self.pp = self.z + beta * self.p, self.zr + beta**2 * self.pp

    def _passes(self) -> bool:
        """Whether x passes the tests, and did so a tenth of the iterations ago."""
        self._estimate()
        if not self._small():
            self._passed, self._wait = None, self.done + 1 + self.done // 20
            return False
        self._passed = self.done if self._passed is None else self._passed
        self._wait = self._passed + self._passed // 10
        return self.done >= self._wait or not self.r.any()

    def _small(self, factor: float = 1.0) -> bool:
        most, stop = factor * self.rules.tolerance, self.rules.stop
        return (self.size <= most or stop == "energy") and (self._error <= most or stop == "residual")

    def _confirm(self) -> Steps:
        """End, unless the error is shown to be larger, or an eigenvalue to be smaller, than was thought."""
        if self.rules.stop != "residual" and self.r.any():
            yield from self._compare()
            if self.rules.probe and self._certain < self.done and self._small():
                self._certain = 2 * self.done
                least = yield from probed(len(self.b), self.done)
                if not least > 0.0:
                    self.ended = "indefinite preconditioner"
                    return
                self._ritz.least = min(self._ritz.least, least)
            self._estimate()
        if self._small():
            self.ended = "met"

    def _compare(self) -> Steps:
        """‖e‖_A ≥ r·r / (r·Ar)^½ whatever M is: where that is above the bound, θ is too large."""
        Ar = yield "A", self.r
        length = max(0.0, float(self.r @ Ar)) ** 0.5
        least = float(self.r @ self.r) / length if length > 0.0 else 0.0
        self._ritz.least *= min(1.0, self._bound() / least) ** 2 if least else 1.0
        self._estimate()

    def _estimate(self) -> None:
        self._ritz.refresh()
        self._scale = self.energy(self.x)
        self._error = size_ratio(self._bound(), self._scale)

    def _fall_back(self, least: Iterate) -> Steps:
        """Return to the iterate of least residual, as later ones may follow a null vector of A."""
        if not least[0] >= self.size:
            (self.size, self.x, self.r), self._true = least, False
        if self.ended == "singular matrix" and (yield from is_rounding(self.r, self.x, self.b)):
            self.ended = "stagnation"  # the load is in the range of A as far as it can be

    def _settle(self) -> Steps:
        """b − A x for an iterate at which the iteration was ended, and the error if that is known."""
        exact = self.b - (yield "A", self.x)
        drifted = self._drifted(self.r, exact)
        self.r, self.size, self._true = exact, self.measure(exact), True
        self.residuals[-1] = two_norm(exact)
        self._error = np.inf
        if drifted and self.ended == "loss of conjugacy":
            self.ended = "stagnation"  # it is rounding, not the preconditioner
        if self.ended == "stagnation":
            yield from self._precondition()
            self._begin()
        if not drifted or self.ended == "stagnation":
            self._estimate()
