"""What a solver gives back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from agglo_core.arrays import Float

__all__ = ["Lifting", "Solution"]


@dataclass(frozen=True, eq=False)
class Lifting:
    """What was solved in place of ``A x = b``: x = offset + rest, ``A rest = load``.

    ``load (n,)`` is b − A offset, and the residual of x is load − A rest: both without the digits that are
    lost where the offset is far above the rest.
    """

    offset: Float
    rest: Float
    load: Float


@dataclass(frozen=True, eq=False)
class Solution:
    """A solution ``x`` of ``A x = b`` and how it was reached.

    Matrices are sparse, arrays or ``scipy.sparse.linalg.LinearOperator``.
    ``operators`` lists ``(A, P)`` per level, finest first; ``residuals`` are the 2-norms ‖b − A x‖
    after each iteration, the first one before any.

    What a solver need not tell: ``tests``, which of the tests ``"residual"`` and ``"energy error"`` x has
    passed; ``energy_error``, an estimate of the error in the energy norm relative to that of the solution;
    ``lifting``, if an offset was taken out of x (``residuals`` are then those of the rest).
    """

    x: Float
    A: Any
    b: Float
    operators: list[tuple[Any, Any]]
    residuals: Float
    converged: bool
    reason: str
    iterations: int
    seconds: Mapping[str, float]
    energy_error: float | None = None
    tests: tuple[str, ...] = ()
    lifting: Lifting | None = None
