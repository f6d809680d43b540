"""Problems a Solver takes and what it gives back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from agglo_core.arrays import Float, Int

__all__ = ["Diffusion", "Linear", "Problem", "Solution"]

Field = float | Float | Callable[[Float], Float]
"""A number, one value per cell ``(n,)``, or a callable of points ``(q, d)`` returning ``(q,)``."""


@dataclass(frozen=True, eq=False)
class Diffusion:
    """Find u with −∇·(κ∇u) = f, given Dirichlet and Neumann data by boundary tag.

    Attributes
    ----------
    kappa, source : Field
        Diffusion coefficient (positive) and right-hand side f.
    dirichlet, neumann : mapping of boundary tag value to Field
        Boundary values u and outward fluxes κ ∂u/∂n. If both are empty u = 0 on the whole boundary.
        Otherwise faces whose tag stands in neither are insulated, and every component of the domain needs
        a tag in ``dirichlet``: with fluxes alone u is known only up to a constant.
    exact : callable, optional
        The solution, when known, for error norms.
    """

    kappa: Field = 1.0
    source: Field = 1.0
    dirichlet: Mapping[int, Field] = field(default_factory=dict)
    neumann: Mapping[int, Field] = field(default_factory=dict)
    exact: Callable[[Float], Float] | None = None


@dataclass(frozen=True, eq=False)
class Linear:
    """Solve A x = b, the unknowns of cell c being ``block_offsets[c]:block_offsets[c + 1]``."""

    A: Any
    b: Float
    block_offsets: Int


Problem = Diffusion | Linear


@dataclass(frozen=True, eq=False)
class Solution:
    """A solution ``x`` of ``A x = b`` and how it was reached.

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
