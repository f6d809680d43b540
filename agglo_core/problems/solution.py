"""What a solver gives back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from agglo_core.arrays import Float

__all__ = ["Solution"]


@dataclass(frozen=True, eq=False)
class Solution:
    """A solution ``x`` of ``A x = b`` and how it was reached.

    Matrices are sparse, arrays or ``scipy.sparse.linalg.LinearOperator``.
    ``operators`` lists ``(A, P)`` per level, finest first; ``residuals`` are the 2-norms ‖b − A x‖
    after each iteration, the first one before any.
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
