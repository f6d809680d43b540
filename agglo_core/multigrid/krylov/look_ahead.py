"""Plain conjugate gradients that estimate the error of an iterate from some further iterations."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.multigrid.krylov.lanczos import failure
from agglo_core.multigrid.krylov.recursion import Recursion
from agglo_core.multigrid.krylov.stopping import SAID, Restarts
from agglo_core.problems.iteration_history import MET, TESTS, Ended, History, iterated
from agglo_core.problems.residuals.backward_error import explain_joints, magnitudes
from agglo_core.problems.residuals.row_scales import lifted, penalised_rows, row_measure, row_sizes
from agglo_core.problems.residuals.sizes import Measure, energy_of_solution, size_ratio, two_norm
from agglo_core.progress import Notify, ignore_progress

_ILL_CONDITIONED = "the matrix is singular, or nearly so: "
_AHEAD = 10
"""Minimum look-ahead in iterations, and divisor of the iteration number for larger look-aheads.

A longer look-ahead gives a sharper estimate of the energy error, for more iterations.
Benchmark: benchmarks/constants.py.
"""


def conjugate_gradients(
    A: Any,
    b: Float,
    tolerance: float = 1e-6,
    most: int = 10_000,
    measure: Measure | None = None,
    energy: Measure | None = None,
    notify: Notify = ignore_progress,
) -> History:
    """Run plain conjugate gradients from 0 until residual and energy error are at most ``tolerance``.

    Parameters
    ----------
    A : (n, n) sparse
    b : (n,) float
    tolerance : float
    most : int
        Maximum number of iterations.
    measure : callable, optional
        Residual measure. Default: :func:`~agglo_core.problems.residuals.row_scales.row_measure`.
    energy : callable, optional
        Function of x: the norm to compare ‖e‖_A with, for the error e. Default: (b·x)^½.
    notify : callable, optional
        Receives the iteration progress, see :func:`iterated`.

    Notes
    -----
    If the recursive residual is small enough, b − A x is computed, and the iteration continues for some steps
    with coefficients that give ‖e‖_A. These steps are not counted if x is accepted. If b − A x differs, the
    recursion restarts from b − A x, and ends when restarts gain nothing. Hence the count is the number of the
    first accepted iterate, as in the paper's tables, while :func:`~agglo_core.multigrid.krylov.pcg.pcg`
    counts all iterations.

    Values imposed by diagonal penalties are eliminated first, unless ``measure`` or ``energy`` is given
    (:func:`~agglo_core.problems.residuals.row_scales.lifted`). Rows with penalties are scaled to the size of
    other rows, because such large numbers leave no digits to the others.

    As in MATLAB's ``pcg``, an iteration without convergence returns the iterate with smallest residual, and
    its number is the length of the history. ``reason`` gives the number of iterations done.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from agglo_core.multigrid.krylov.look_ahead import conjugate_gradients
    >>> A = sparse.diags_array([1.0, 2.0, 4.0]).tocsr()
    >>> history = conjugate_gradients(A, np.ones(3))
    >>> history.x.round(6), history.iterations, history.converged
    (array([1.  , 0.5 , 0.25]), 3, True)
    """
    if measure is None and energy is None:
        offset, load = lifted(A, b)
        tests = row_measure(A, load), energy_of_solution(load)
        history = conjugate_gradients(A, load, tolerance, most, *tests, notify)
        return replace(history, x=frozen_float(offset + history.x)) if offset.any() else history
    # 1. Start from 0, with the row weights as preconditioner.
    weights = _weights(A)
    cg = Recursion(np.zeros(len(b)), b.copy())
    cg.precondition(_weigh_residual(weights, cg.r))
    cg.restart()
    look_ahead = _LookAhead(
        A, b, weights, tolerance, measure or row_measure(A, b), energy or energy_of_solution(b)
    )
    residuals, sizes, best, smallest = [_length(cg, weights)], [look_ahead.measure(cg.r)], cg.x, 0
    gains: list[float] = []
    look_ahead.met, look_ahead.ended = not b.any(), "underflow" if b.any() and not cg.zr else ""
    # 2. Iterate until the look-ahead accepts or gives up.
    while not (look_ahead.met or look_ahead.ended) and (len(gains) < most or look_ahead.x is not None):
        Ap = A @ cg.p
        look_ahead.ended = _breakdown(A, cg, Ap)
        if look_ahead.ended:
            break
        cg.move(Ap)
        cg.precondition(_weigh_residual(weights, cg.r))
        cg.turn()
        residuals.append(_length(cg, weights))
        gains.append(cg.gain)
        sizes.append(look_ahead.check(cg, len(gains)))
        if sizes[-1] < sizes[smallest]:
            best, smallest = cg.x, len(sizes) - 1
        notify(*iterated(len(gains), sizes[-1], tolerance))
    # 3. Converged: cut the history at the accepted iterate.
    if look_ahead.met:
        x = cg.x if look_ahead.x is None else look_ahead.x
        norms = frozen_float(residuals[: look_ahead.at + 1])
        won = frozen_float(gains[: look_ahead.at])
        norm = look_ahead.energy_norm
        return History(
            frozen_float(x), norms, True, MET, look_ahead.error, TESTS, "met", gains=won, energy_norm=norm
        )
    exact = b - A @ best  # may differ from the recursive residual by rounding
    size = max(sizes[smallest], look_ahead.measure(exact))
    reason = look_ahead.reason(size, smallest, len(gains)) + explain_joints(A)
    norms = frozen_float([*residuals[:smallest], max(residuals[smallest], float(np.linalg.norm(exact)))])
    passed = TESTS[: size <= tolerance]
    return History(
        frozen_float(best), norms, False, reason, None, passed, look_ahead.ended or "most iterations"
    )


def _breakdown(A: Any, cg: Recursion, Ap: Float) -> Ended:
    """Return the reason why no step along p is possible, or an empty text if it is."""
    if cg.curve(Ap):
        ended = failure(cg.p, Ap, magnitudes(A, cg.p))
        if ended in ("singular matrix", "indefinite matrix"):
            return ended
    return "" if cg.curvature > 0.0 else "indefinite matrix"


@dataclass(eq=False)
class _LookAhead:
    """Acceptance test of an iterate, by the error that the following steps reveal.

    The candidate ``x`` is the iterate of iteration ``at``, with energy norm ``energy_norm``. Its error is the
    sum of the reductions of ‖e‖_A² by later steps and the bound at the last step.
    """

    A: Any
    b: Float
    weights: Float | None
    tolerance: float
    measure: Measure
    energy: Measure
    met: bool = False
    ended: Ended = ""
    error: float = np.inf
    x: Float | None = None
    at: int = 0
    energy_norm: float = 0.0
    _text: str = ""  # text of the reason, if not determined by ``ended``
    _gained: float = 0.0
    _drift: float = 0.0
    _restarts: Restarts = field(default_factory=lambda: Restarts(patience=1))

    def check(self, cg: Recursion, done: int) -> float:
        """Judge the iterate after step ``done``, and return its residual size.

        The residual is computed as b − A x where this decides.
        """
        # 1. With a candidate: add the gain, and decide after the look-ahead.
        size = self.measure(cg.r)
        if self.x is not None:
            self._gained += cg.gain
            if done >= self.at + max(_AHEAD, self.at // _AHEAD) or not cg.zr:
                self._decide(cg)
        # 2. Without candidate: compute b − A x if x is likely accurate.
        elif size <= self.tolerance and self._likely(cg):
            exact = self.b - self.A @ cg.x
            size = max(size, self.measure(exact))
            self._drift = float(np.linalg.norm(exact - cg.r))
            if size <= self.tolerance:
                self.x, self.at, self._gained = cg.x, done, 0.0
                if not cg.zr:
                    self._decide(cg)
            else:
                self._restart(cg, exact)
        return size

    def _likely(self, cg: Recursion) -> bool:
        """Return True if the error bound of the iterate is within the tolerance."""
        if self.energy_norm and not size_ratio(cg.error_bound(), self.energy_norm) <= self.tolerance:
            return False  # by an earlier, larger Ritz value
        if not self._has_spectrum(cg):
            return False
        self.energy_norm = self.energy(cg.x)
        self.error = size_ratio(cg.error_bound(), self.energy_norm)
        return self.error <= self.tolerance

    def _decide(self, cg: Recursion) -> None:
        """Accept the candidate iterate if its error is within the tolerance, otherwise discard it."""
        if not self._has_spectrum(cg):
            return
        rounding = self._drift / float(np.sqrt(cg.ritz.least))
        error = float(np.sqrt(self._gained + cg.error_bound() ** 2)) + rounding
        self.error = size_ratio(error, self.energy_norm)
        self.met = self.error <= self.tolerance
        if not self.met:
            self.x = None
            if size_ratio(rounding, self.energy_norm) > 0.5 * self.tolerance:
                self._restart(cg, self.b - self.A @ cg.x)

    def _has_spectrum(self, cg: Recursion) -> bool:
        """Update the smallest Ritz value, and end the iteration unless it is positive."""
        if not cg.ritz.refresh() > 0.0:
            self.ended, self._text = "singular matrix", _ILL_CONDITIONED
        return not self.ended

    def _restart(self, cg: Recursion, exact: Float) -> None:
        """Restart from b − A x, and end the iteration if the previous restart has gained nothing."""
        cg.r = exact
        cg.precondition(_weigh_residual(self.weights, exact))
        cg.restart()
        if self._restarts.add((self.measure(exact), cg.x, exact)):
            self.ended = "stagnation"

    def reason(self, size: float, at: int, done: int) -> str:
        """Return a text that describes an iteration without convergence."""
        near = f", energy error about {self.error:.1e}" if size <= self.tolerance else ""
        wanted = f"smallest relative residual {size:.1e} in iteration {at} of {done}{near}"
        return f"{self._text or SAID.get(self.ended, '')}{wanted}, required {self.tolerance:.1e}"


def _weights(A: Any) -> Float | None:
    """Return weights ``(n,)`` that scale penalty rows to the size of other rows, None without penalties."""
    rows = penalised_rows(A)
    if not len(rows):
        return None
    sizes = row_sizes(A)
    others = np.delete(sizes, rows)
    weights = np.ones(len(sizes))
    weights[rows] = np.median(others if len(others) else sizes) / sizes[rows]
    return frozen_float(weights)


def _weigh_residual(weights: Float | None, r: Float) -> Float:
    return r if weights is None else frozen_float(weights * r)


def _length(cg: Recursion, weights: Float | None) -> float:
    """Return ‖r‖, which is (z·r)^½ without weights."""
    return float(np.sqrt(cg.zr)) if weights is None else two_norm(cg.r)
