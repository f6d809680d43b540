"""Stopping rules of conjugate gradients, with restarts and a probe for modes that b hides."""

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

TRIAL = 5
"""Iterations after which the pace is judged."""

Beta = Literal["flexible", "fletcher-reeves"]
Stop = Literal["energy", "residual", "both"]

Request = tuple[Literal["A", "M", "|A|"], Float]
"""A product that is needed: the operator, and the vector ``(n,)``; ``|A|`` asks for |A| |x|, or less."""

Steps = Generator[Request, Float, None]
"""Of an iteration: it is sent the products that it asks for."""

SAID = MappingProxyType[Ended, str](
    {
        "indefinite matrix": "the matrix is not positive definite: ",
        "singular matrix": "the matrix is singular, to rounding, and the load is not in its range: ",
        "indefinite preconditioner": "the preconditioner is not positive definite: ",
        "loss of conjugacy": "the preconditioner is not symmetric, or not precise enough: ",
        "preconditioner not finite": "the preconditioner gave values that are not finite: ",
        "matrix not finite": "the matrix gave values that are not finite: ",
        "stagnation": "rounding lets b − A x fall no further: ",
        "underflow": "r·r is too small for floating-point numbers, scale b: ",
    }
)
"""Ends, as people are told of them."""


@dataclass(frozen=True)
class Rules:
    """Until when, and how, to iterate; see :func:`agglo_core.multigrid.krylov.pcg.pcg`."""

    tolerance: float
    most: int
    beta: Beta
    stop: Stop
    probe: bool
    pace: float | None = None

    def exhausted(self, residuals: Sequence[float], size: float) -> bool:
        """Whether the iteration is too long, or its first steps are too slow.

        Parameters
        ----------
        residuals : sequence of float
            2-norms so far.
        size : float
            Relative size of the last one.
        """
        done = len(residuals) - 1
        if self.pace is None or done != TRIAL or size <= self.tolerance:
            return done >= self.most
        fall = np.log(residuals[0] / residuals[-1]) / done
        return done >= self.most or not fall * max(self.pace - done, 0.0) >= np.log(size / self.tolerance)


Iterate = tuple[float, Float, Float]
"""The relative size of b − A x, x and b − A x."""


@dataclass(eq=False)
class Restarts:
    """Restarts from b − A x, where the residual of the recursion has become another vector.

    Attributes
    ----------
    best : tuple
        The iterate of least residual among them.
    patience : int
        Restarts in a row that may gain nothing: rounding differs from one to the next.
    """

    best: Iterate = (np.inf, frozen_float([]), frozen_float([]))
    patience: int = 2
    _bound: float = np.inf
    _idle: int = 0

    def add(self, iterate: Iterate, bound: float = 1.0) -> bool:
        """Record a restart, and a bound of its error if known; return whether these gain nothing any more.

        Where rounding lets neither the residual nor the bound of the error fall they go up and down.
        """
        idle = iterate[0] > 0.5 * self.best[0] and bound > 0.5 * self._bound
        self._idle, self._bound = (self._idle + 1 if idle else 0), min(bound, self._bound)
        if iterate[0] < self.best[0]:
            self.best = iterate
        return self._idle >= self.patience


_MORE = 4
"""Steps of a probe beyond twice the iterations done."""
_FALL = 1e-4
"""Part of its start to which z·r has to fall: by then every mode with a share like others' was seen."""


def probed(n: int, done: int) -> Generator[Request, Float, float]:
    """Smallest Ritz value of M A after some steps from a random vector ``(n,)``.

    Steps are at most four beyond twice the iterations ``done``; if M is good they end long before. No mode
    can hide because b lacks it. Where that vector leads to a null vector of A, the steps are repeated
    from a random vector in the range of A.

    Returns
    -------
    float
        An eigenvalue nearly, taken to fall by once more what it fell by in the latter half of the steps; 0 if
        A or M is found not to be positive definite.
    """
    most, start = _MORE + 2 * done, np.random.default_rng(n).normal(size=n)
    least = yield from _smallest_ritz_value(start, most)
    if least is None:
        least = yield from _smallest_ritz_value((yield "A", start), most)
    return least or 0.0


def _smallest_ritz_value(r: Float, most: int) -> Generator[Request, Float, float | None]:
    """Smallest Ritz value from a residual; 0 for indefinite operators, None where A has a null vector."""
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
    """Whether the residual r = b − A x is no more than what rounding to x and to entries of A makes of it."""
    magnitudes = yield "|A|", x
    return two_norm(r) <= 0.5 * LIMIT * two_norm(magnitudes + np.abs(b))
