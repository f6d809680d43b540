"""What the parts of preconditioned conjugate gradients share: options, requests, how an end is called."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np

from agglo_core.arrays import Float
from agglo_core.problems.iteration_history import Ended

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
