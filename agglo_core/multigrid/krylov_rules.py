"""What the parts of preconditioned conjugate gradients share: options, requests, how an end is called."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from agglo_core.arrays import Float
from agglo_core.problems.iteration_history import Ended

__all__ = ["SAID", "Beta", "Request", "Rules", "Steps", "Stop"]

Beta = Literal["flexible", "fletcher-reeves"]
Stop = Literal["energy", "residual", "both"]

Request = tuple[Literal["A", "M", "|A|"], Float]
"""A product that is needed: the operator, and the vector ``(n,)``; ``|A|`` asks for |A| |x|, or less."""

Steps = Generator[Request, Float, None]
"""Of an iteration: it is sent the products that it asks for."""

SAID = MappingProxyType[Ended, str](
    {
        "indefinite matrix": "the matrix is not positive definite: ",
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
    """Until when, and how, to iterate; see :func:`agglo_core.multigrid.krylov.pcg`."""

    tolerance: float
    most: int
    beta: Beta
    stop: Stop
    probe: bool
