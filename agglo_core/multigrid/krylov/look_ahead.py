"""Plain conjugate gradients: the baseline for every method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.multigrid.krylov.curvatures import Curvatures, failure
from agglo_core.multigrid.krylov.ritz import RitzValue
from agglo_core.problems.backward_error import joints_told, magnitudes
from agglo_core.problems.iteration_history import MET, TESTS, Ended, History, iterated
from agglo_core.problems.row_scales import lifted, penalised_rows, row_measure, row_sizes
from agglo_core.problems.sizes import Measure, energy_of_solution, size_ratio, two_norm
from agglo_core.progress import Tell, to_nobody

_INDEFINITE = "the matrix is not positive definite: "
_SINGULAR = "the matrix is singular, to rounding, and the load is not in its range: "
_ILL_CONDITIONED = "the matrix is singular, or nearly so: "
_AHEAD = 10
"""Iterations to go on for, and that part of those done, before an iterate is judged."""
_UNDERFLOW = "r·r is too small for floating-point numbers, scale b: "
_ROUNDING = "rounding lets b − A x fall no further: "
_ENDED: Mapping[str, Ended] = MappingProxyType(
    {
        "": "most iterations",
        _INDEFINITE: "indefinite matrix",
        _SINGULAR: "singular matrix",
        _ILL_CONDITIONED: "singular matrix",
        _UNDERFLOW: "underflow",
        _ROUNDING: "stagnation",
    }
)

_WHY: Mapping[str, str] = MappingProxyType({"singular matrix": _SINGULAR, "indefinite matrix": _INDEFINITE})


def conjugate_gradients(
    A: Any,
    b: Float,
    tolerance: float = 1e-6,
    most: int = 10_000,
    measure: Measure | None = None,
    energy: Measure | None = None,
    tell: Tell = to_nobody,
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
        Of residuals; by default :func:`~agglo_core.problems.row_scales.row_measure`.
    energy : callable, optional
        Of x: the norm that ‖e‖_A is compared with, e being the error; by default (b·x)^½.
    tell : callable, optional
        Told how far the iteration has come, see :func:`iterated`.

    Notes
    -----
    Where the recursion's residual is small enough b − A x is computed, and the iteration goes on a little, so
    that its coefficients tell ‖e‖_A; these further iterations are not counted if x is right. If b − A x turns
    out to be another vector the iteration starts afresh from it, and is given up once that gains nothing.

    Values imposed by penalties on the diagonal are taken out of the system first, unless ``measure`` or
    ``energy`` is given (:func:`~agglo_core.problems.row_scales.lifted`). Rows with penalties are scaled to
    the size of the others, as products with such numbers leave no digits to the others.

    As in MATLAB's ``pcg``, an iteration that does not converge returns the iterate of smallest residual,
    whose number is the length of the history; ``reason`` says how many iterations were done.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from agglo_core.authoring import conjugate_gradients
    >>> A = sparse.diags_array([1.0, 2.0, 4.0]).tocsr()
    >>> history = conjugate_gradients(A, np.ones(3))
    >>> history.x.round(6), history.iterations, history.converged
    (array([1.  , 0.5 , 0.25]), 3, True)
    """
    if measure is None and energy is None:
        offset, load = lifted(A, b)
        tests = row_measure(A, load), energy_of_solution(load)
        history = conjugate_gradients(A, load, tolerance, most, *tests, tell)
        return replace(history, x=frozen_float(offset + history.x)) if offset.any() else history
    claim = _Claim(A, b, tolerance, measure or row_measure(A, b), energy or energy_of_solution(b))
    run = _Run(A, np.zeros(len(b)), b.copy(), _weights(A))
    residuals, sizes, best, smallest = [run.length()], [claim.measure(run.r)], run.x, 0
    gains: list[float] = []
    claim.met, claim.why = not b.any(), _UNDERFLOW if b.any() and not run.rho else ""
    while not (claim.met or claim.why) and (len(residuals) <= most or claim.x is not None):
        claim.why = run.step()
        if claim.why:
            break
        residuals.append(run.length())
        gains.append(run.gain)
        sizes.append(claim.check(run))
        if sizes[-1] < sizes[smallest]:
            best, smallest = run.x, len(sizes) - 1
        tell(*iterated(len(residuals) - 1, sizes[-1], tolerance))
    if claim.met:
        x = run.x if claim.x is None else claim.x
        kept = frozen_float(residuals[: claim.at + 1])
        won = frozen_float(gains[: claim.at])
        return History(
            frozen_float(x), kept, True, MET, claim.error, TESTS, "met", gains=won, energy_norm=claim.scale
        )
    true = b - A @ best  # which rounding may keep from what the recursion has
    size = max(sizes[smallest], claim.measure(true))
    reason = claim.failed(size, smallest, len(sizes) - 1) + joints_told(A)
    kept = frozen_float([*residuals[:smallest], max(residuals[smallest], float(np.linalg.norm(true)))])
    passed = TESTS[: size <= tolerance]
    return History(frozen_float(best), kept, False, reason, None, passed, _ENDED[claim.why])


@dataclass(eq=False)
class _Run:
    """The recursion: iterate, its residual, direction, r·r, what the last step took from ‖e‖_A².

    With ``weights (n,)`` w it is that of W^½ A W^½, and products of residuals are r·W r.
    """

    A: Any
    x: Float
    r: Float
    weights: Float | None = None
    ritz: RitzValue = field(default_factory=RitzValue)
    curvatures: Curvatures = field(default_factory=Curvatures)

    def __post_init__(self) -> None:
        self.gain, self.done = 0.0, 0
        self._begin()

    def _begin(self) -> None:
        self.p = self._weighted()
        self.rho = float(self.r @ self.p)

    def _weighted(self) -> Float:
        return self.r if self.weights is None else frozen_float(self.weights * self.r)

    def length(self) -> float:
        """‖r‖."""
        return float(np.sqrt(self.rho)) if self.weights is None else two_norm(self.r)

    def _size(self) -> float:
        """p·p, or p·W⁻¹p."""
        return float(self.p @ (self.p if self.weights is None else self.p / self.weights))

    def step(self) -> str:
        """Make an iteration; return why it cannot be made, or nothing."""
        Ap = self.A @ self.p
        curvature = float(self.p @ Ap)
        if self.curvatures.add(curvature, self._size()):
            why = _WHY.get(failure(self.p, Ap, magnitudes(self.A, self.p)), "")
            if why:
                return why
        if not curvature > 0.0:
            return _INDEFINITE
        alpha = self.rho / curvature
        self.gain, self.done = alpha * self.rho, self.done + 1
        self.x, self.r = self.x + alpha * self.p, self.r - alpha * Ap
        z = self._weighted()
        self.rho, before = float(self.r @ z), self.rho
        self.p = z + (self.rho / before) * self.p
        self.ritz.add(alpha, self.rho / before)
        return ""

    def restart(self, r: Float) -> None:
        """Go on from another residual of the same iterate."""
        self.r = r
        self._begin()
        self.ritz.restart()

    def energy_error(self) -> float:
        """‖e‖_A ≤ r·r / (θ p·p)^½, θ the smallest eigenvalue (Meurant, Tichý, Numer. Algorithms 82, 2019)."""
        return self.rho / float(np.sqrt(self.ritz.least * self._size())) if self.rho else 0.0


@dataclass(eq=False)
class _Claim:
    """Whether an iteration may be called converged: ``met`` says so, ``why`` says that it never will.

    An iterate ``x``, the one with the number ``at`` and the energy norm ``scale``, is looked at from some
    iterations further on.
    """

    A: Any
    b: Float
    tolerance: float
    measure: Measure
    energy: Measure
    met: bool = False
    why: str = ""
    error: float = np.inf
    x: Float | None = None
    at: int = 0
    scale: float = 0.0
    _gained: float = 0.0
    _drift: float = 0.0
    _replaced: float = np.inf

    def check(self, run: _Run) -> float:
        """Size of the residual after a step, the true one where that decides."""
        size = self.measure(run.r)
        if self.x is not None:
            self._gained += run.gain
            if run.done >= self.at + max(_AHEAD, self.at // _AHEAD) or not run.rho:
                self._decide(run)
        elif size <= self.tolerance and self._likely(run):
            true = self.b - self.A @ run.x
            size = max(size, self.measure(true))
            self._drift = float(np.linalg.norm(true - run.r))
            if size <= self.tolerance:
                self.x, self.at, self._gained = run.x, run.done, 0.0
                if not run.rho:
                    self._decide(run)
            else:
                self._replace(run, true)
        return size

    def _likely(self, run: _Run) -> bool:
        if self.scale and not size_ratio(run.energy_error(), self.scale) <= self.tolerance:
            return False  # even by a Ritz value from before
        if not run.ritz.refresh() > 0.0:
            self.why = _ILL_CONDITIONED
            return False
        self.scale = self.energy(run.x)
        self.error = size_ratio(run.energy_error(), self.scale)
        return self.error <= self.tolerance

    def _decide(self, run: _Run) -> None:
        if not run.ritz.refresh() > 0.0:
            self.why = _ILL_CONDITIONED
            return
        rounding = self._drift / float(np.sqrt(run.ritz.least))
        error = float(np.sqrt(self._gained + run.energy_error() ** 2)) + rounding
        self.error = size_ratio(error, self.scale)
        self.met = self.error <= self.tolerance
        if not self.met:
            self.x = None
            if size_ratio(rounding, self.scale) > 0.5 * self.tolerance:
                self._replace(run, self.b - self.A @ run.x)

    def _replace(self, run: _Run, true: Float) -> None:
        """Start afresh from the true residual, unless that has been done and gained nothing."""
        size = self.measure(true)
        self.why = _ROUNDING if size > 0.5 * self._replaced else ""
        self._replaced = size
        run.restart(true)

    def failed(self, size: float, at: int, done: int) -> str:
        """The reason of an iteration that has not converged."""
        near = f", energy error about {self.error:.1e}" if size <= self.tolerance else ""
        wanted = f"smallest relative residual {size:.1e} in iteration {at} of {done}{near}"
        return f"{self.why}{wanted}, wanted {self.tolerance:.1e}"


def _weights(A: Any) -> Float | None:
    """Weights ``(n,)`` that scale rows with penalties to the size of the others; None without such rows."""
    rows = penalised_rows(A)
    if not len(rows):
        return None
    sizes = row_sizes(A)
    others = np.delete(sizes, rows)
    weights = np.ones(len(sizes))
    weights[rows] = np.median(others if len(others) else sizes) / sizes[rows]
    return frozen_float(weights)
