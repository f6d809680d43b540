"""Stopping rules and restarts of conjugate gradients, and a probe for modes that b does not contain."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.multigrid.krylov.lanczos import failure
from agglo_core.multigrid.krylov.recursion import Recursion
from agglo_core.problems.iteration_history import Ended
from agglo_core.problems.residuals.backward_error import LIMIT
from agglo_core.problems.residuals.sizes import two_norm

_BEHIND = 0.3
"""Maximum lag behind the pace, relative to its iterations: about the iterations that slow levels can cost.

Larger: slow levels serve longer (benchmarks/time_steps.py).
"""
_LEAST_BEHIND = 2.0
"""Least maximum lag, because the first steps of a good preconditioner may reduce the residual little."""

Beta = Literal["flexible", "fletcher-reeves"]
Stop = Literal["energy", "residual", "both"]

Request = tuple[Literal["A", "M", "|A|"], Float]
"""Requested product: operator and vector ``(n,)``. ``|A|`` requests |A| |x| or a lower bound."""

Steps = Generator[Request, Float, None]
"""Iteration that yields requests and receives products."""

SAID = MappingProxyType[Ended, str](
    {
        "indefinite matrix": "the matrix is not positive definite: ",
        "singular matrix": "the matrix is numerically singular, and b is not in its range: ",
        "indefinite preconditioner": "the preconditioner is not positive definite: ",
        "loss of conjugacy": "the preconditioner is not symmetric, or not precise enough: ",
        "preconditioner not finite": "the preconditioner returned values that are not finite: ",
        "matrix not finite": "the matrix product returned values that are not finite: ",
        "stagnation": "rounding prevents a further decrease of b − A x: ",
        "underflow": "r·r is too small for floating-point numbers; scale b: ",
    }
)
"""Explanations of each end for reasons."""


@dataclass(frozen=True)
class Rules:
    """Parameters of the iteration, see :func:`agglo_core.multigrid.krylov.pcg.pcg`."""

    tolerance: float
    most: int
    beta: Beta
    stop: Stop
    probe: bool
    pace: float | None = None

    def exhausted(self, residuals: Sequence[float], size: float) -> bool:
        """Return True at the maximum number of iterations, or too far behind the pace.

        Parameters
        ----------
        residuals : sequence of float
            2-norms so far.
        size : float
            Relative size of the last residual.
        """
        steps = len(residuals) - 1
        if self.pace is None or not steps or size <= self.tolerance:
            return steps >= self.most
        left = np.log(size / self.tolerance) / np.log(1.0 / self.tolerance)
        late = steps + left * self.pace > self.pace + max(_BEHIND * self.pace, _LEAST_BEHIND)
        return steps >= self.most or bool(late)


Iterate = tuple[float, Float, Float]
"""Relative size of b − A x, x, and b − A x."""


@dataclass(eq=False)
class Restarts:
    """Record of restarts from b − A x, made when the recursive residual has drifted away from it.

    Attributes
    ----------
    best : tuple
        Iterate with smallest residual among the restarts.
    patience : int
        Number of successive restarts allowed without gain, because rounding differs between restarts.
    """

    best: Iterate = (np.inf, frozen_float([]), frozen_float([]))
    patience: int = 2
    _bound: float = np.inf
    _idle: int = 0

    def add(self, iterate: Iterate, bound: float = 1.0) -> bool:
        """Record a restart with its error bound, and return True if restarts no longer reduce the error.

        Where rounding prevents further reduction, residual and error bound go up and down.
        """
        idle = iterate[0] > 0.5 * self.best[0] and bound > 0.5 * self._bound
        self._idle, self._bound = (self._idle + 1 if idle else 0), min(bound, self._bound)
        if iterate[0] < self.best[0]:
            self.best = iterate
        return self._idle >= self.patience


_MORE = 4
"""Maximum steps of a probe beyond twice the iterations done (benchmarks/constants.py)."""
_FALL = 1e-4
"""Reduction of z·r that ends a probe: then every mode with an average share has been seen.

Smaller: a more reliable eigenvalue, for more steps.
Benchmark: benchmarks/constants.py.
"""


def probe_ritz_value(n: int, done: int) -> Generator[Request, Float, float]:
    """Estimate the smallest Ritz value of M A by conjugate gradients from a random vector ``(n,)``.

    The step count is at most four plus twice the iterations ``done``, and much smaller for a good M. No
    mode can hide by its absence from b. If the vector leads to a null vector of A, the steps are repeated
    from a random vector in the range of A.

    Returns
    -------
    float
        Approximate eigenvalue, extrapolated by the reduction over the second half of the steps, or 0 if A
        or M is not positive definite.
    """
    most, start = _MORE + 2 * done, np.random.default_rng(n).normal(size=n)
    least = yield from _smallest_ritz_value(start, most)
    if least is None:
        least = yield from _smallest_ritz_value((yield "A", start), most)
    return least or 0.0


def _smallest_ritz_value(r: Float, most: int) -> Generator[Request, Float, float | None]:
    """Return the smallest Ritz value, 0 for indefinite operators, or None if A has a null vector."""
    cg = Recursion(np.zeros(len(r)), r)
    cg.precondition((yield "M", r))
    cg.restart()
    first = cg.zr
    for _ in range(most):
        if not cg.zr > 0.0:
            return 0.0
        Ap = yield "A", cg.p
        if cg.curve(Ap) and failure(cg.p, Ap, (yield "|A|", cg.p)) == "singular matrix":
            return None
        if not cg.curvature > 0.0:
            return 0.0
        cg.move(Ap)
        cg.precondition((yield "M", cg.r))
        cg.turn()
        if abs(cg.zr) <= _FALL * first:
            break
    return cg.ritz.refresh()


def is_rounding(r: Float, x: Float, b: Float) -> Generator[Request, Float, bool]:
    """Return True if rounding of x and A explains the residual r = b − A x."""
    magnitudes = yield "|A|", x
    return two_norm(r) <= 0.5 * LIMIT * two_norm(magnitudes + np.abs(b))
