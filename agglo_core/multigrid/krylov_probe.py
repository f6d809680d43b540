"""What an iteration asks of A and M besides its own products before it ends."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from agglo_core.arrays import Float
from agglo_core.multigrid.krylov_rules import Request
from agglo_core.problems.backward_error import LIMIT
from agglo_core.problems.ritz import RitzValue
from agglo_core.problems.sizes import two_norm

__all__ = ["is_rounding", "probed"]

_FALL = 1e-4
"""Part of its start to which z·r has to fall: by then every mode with a share like others' was seen."""


def probed(n: int, most: int) -> Generator[Request, Float, float]:
    """Smallest Ritz value of M A after up to ``most`` steps from a random vector ``(n,)``.

    No mode can hide because b lacks it.

    Returns
    -------
    float
        An eigenvalue nearly, taken to fall by once more what it fell by in the latter half of the steps; 0 if
        A or M is found not to be positive definite.
    """
    r = np.random.default_rng(n).normal(size=n)
    z = yield "M", r
    first = rho = float(z @ r)
    p, ritz = z, RitzValue()
    for _ in range(most):
        if not rho > 0.0:
            return 0.0
        Ap = yield "A", p
        curvature = float(p @ Ap)
        if not curvature > 0.0:
            return 0.0
        step = rho / curvature
        r = r - step * Ap
        z = yield "M", r
        rho, before = float(z @ r), rho
        ritz.add(step, max(rho, 0.0) / before)
        if abs(rho) <= _FALL * first:
            break
        p = z + (rho / before) * p
    return ritz.refresh()


def is_rounding(r: Float, x: Float, b: Float) -> Generator[Request, Float, bool]:
    """Whether the residual r = b − A x is no more than what rounding to x and to entries of A makes of it."""
    magnitudes = yield "|A|", x
    return two_norm(r) <= 0.5 * LIMIT * two_norm(magnitudes + np.abs(b))
