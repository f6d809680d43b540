"""What each kind of component must offer. Nobody inherits anything: having the method is enough.

A *part* is a (block, label) pair: labels are local to their block. A *level* is a block-diagonal
:class:`~agglo_core.graph.Graph` whose blocks are the pieces of one recursion depth. The law every
component obeys: **a level is its blocks** — what happens to one block never depends on the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, UInt64

if TYPE_CHECKING:
    from agglo_core.graph import Graph
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh
    from agglo_core.problems import Problem, Solution

__all__ = [
    "Aiming",
    "Bisector",
    "ConnectivityFixer",
    "LevelBisector",
    "Partitioner",
    "QualityMetric",
    "Refiner",
    "Sides",
    "Solver",
    "Target",
]

Sides = NDArray[Any]
"""``(n,)`` integers or booleans in {0, 1}, or floats in [0, 1]: the probability of side 1."""


@dataclass(frozen=True)
class Target:
    """What the parts must satisfy: a count, or a mesh size.

    Attributes
    ----------
    parts : int, optional
        Number of parts wanted of the whole graph.
    h_star : float, optional
        Largest diameter allowed for a part, in the units of the graph.
    """

    parts: int | None = None
    h_star: float | None = None


@runtime_checkable
class Bisector(Protocol):
    """The simple road: split one connected graph in two."""

    def bisect(self, graph: Graph, rng: np.random.Generator) -> Sides:
        """Return the side of each node, shape ``(n,)``; both sides non-empty for n >= 2."""
        ...


@runtime_checkable
class LevelBisector(Protocol):
    """The fast road: split every block of a level in one call."""

    def bisect_level(self, level: Graph, seeds: UInt64) -> Sides:
        """Return the side of each node, shape ``(n,)``; ``seeds`` is ``(B,)``."""
        ...


@runtime_checkable
class Aiming(Protocol):
    """Optional: a bisector that wants to know what the pieces are to become."""

    def aim(self, target: Target) -> LevelBisector | Bisector:
        """Return the bisector for pieces that are to meet ``target``: itself if that is the same for it.

        Called before pieces are split. Nested sizes are then met one after the other, the coarsest first.
        """
        ...


@runtime_checkable
class Partitioner(Protocol):
    """Optional: direct k-way partition of one connected graph."""

    def partition(self, graph: Graph, target: Target, seed: int) -> Int:
        """Return labels ``(n,)`` in ``0..target.parts-1``; gaps and disconnected parts are repaired."""
        ...


@runtime_checkable
class Refiner(Protocol):
    """Improves labels without emptying a part or raising any part's number of components.

    ``objective`` says what never gets worse: ``"interface"`` (total length), ``"cut"`` (number of
    dual edges), ``"compactness"`` (moment of inertia), ``"balance"`` (largest part) or ``"diameter"``
    (largest diameter).
    """

    objective: str

    def refine(self, graph: Graph, labels: Int, seeds: UInt64, target: Target) -> Int:
        """Return new labels ``(n,)`` whose declared objective is no worse."""
        ...


@runtime_checkable
class ConnectivityFixer(Protocol):
    """Makes every part connected, keeping the label set of each block."""

    def fix(self, graph: Graph, labels: Int) -> Int:
        """Return new labels ``(n,)``; the identity on labels whose parts are all connected."""
        ...


@runtime_checkable
class QualityMetric(Protocol):
    """One number per agglomerate.

    ``homogeneity`` is the power of a length the values scale with: 0 for ratios, 1 for lengths.
    """

    better: Literal["high", "low"]
    bounds: tuple[float, float]
    homogeneity: int

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the value of each agglomerate, shape ``(k,)`` for labels ``0..k-1``."""
        ...


@runtime_checkable
class Solver(Protocol):
    """Solves a problem with the help of a hierarchy of coarse meshes.

    One that promises ``symmetric`` also has ``aspreconditioner(problem, hierarchy)``, which returns a
    ``scipy.sparse.linalg.LinearOperator``.
    """

    def solve(self, problem: Problem, hierarchy: Hierarchy) -> Solution:
        """Return the solution with its convergence history."""
        ...
