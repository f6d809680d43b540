"""What an iteration asks of A and M besides its own products before it ends."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from agglo_core.arrays import Float
from agglo_core.multigrid.krylov.rules import Request
from agglo_core.problems.backward_error import LIMIT
from agglo_core.problems.curvatures import Curvatures, failure
from agglo_core.problems.ritz import RitzValue
from agglo_core.problems.sizes import two_norm

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
    z = yield "M", r
    first = rho = float(z @ r)
    p, pp, curvatures, ritz = z, rho, Curvatures(), RitzValue()
    for _ in range(most):
        if not rho > 0.0:
            return 0.0
        Ap = yield "A", p
        curvature = float(p @ Ap)
        if curvatures.add(curvature, pp) and failure(p, Ap, (yield "|A|", p)) == "singular matrix":
            return None
        if not curvature > 0.0:
            return 0.0
        step = rho / curvature
        r = r - step * Ap
        z = yield "M", r
        rho, before = float(z @ r), rho
        ritz.add(step, max(rho, 0.0) / before)
        if abs(rho) <= _FALL * first:
            break
        p, pp = z + (rho / before) * p, rho + (rho / before) ** 2 * pp
    return ritz.refresh()


def is_rounding(r: Float, x: Float, b: Float) -> Generator[Request, Float, bool]:
    """Whether the residual r = b − A x is no more than what rounding to x and to entries of A makes of it."""
    magnitudes = yield "|A|", x
    return two_norm(r) <= 0.5 * LIMIT * two_norm(magnitudes + np.abs(b))
