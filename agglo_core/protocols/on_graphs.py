"""Protocols of bisectors, refiners and fixers, and their target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, UInt64

if TYPE_CHECKING:
    from agglo_core.graph import Graph


@dataclass(frozen=True)
class Target:
    """Target of a split or refinement: a part count, a maximum diameter, or both.

    Attributes
    ----------
    parts : int, optional
        Part count of the whole graph.
    h_star : float, optional
        Maximum part diameter, in the graph's units.

    Examples
    --------
    >>> from agglo_core.protocols import Target
    >>> Target(parts=8)
    Target(parts=8, h_star=None)
    """

    parts: int | None = None
    h_star: float | None = None


Sides = NDArray[Any]
"""``(n,)`` integers or booleans in {0, 1}, or floats in [0, 1]: the probability of side 1."""


@runtime_checkable
class Bisector(Protocol):
    """Simple protocol of a bisector: split one connected graph in two.

    With ``needs_points = True``, a run on a graph whose points all coincide is refused.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.protocols import Bisector
    >>> class Halves:
    ...     def bisect(self, graph, rng):
    ...         return np.arange(graph.n) >= graph.n // 2
    >>> isinstance(Halves(), Bisector)
    True
    >>> Halves().bisect(agglo.samples.squares(2).graph, np.random.default_rng(0))
    array([False, False,  True,  True])
    """

    def bisect(self, graph: Graph, rng: np.random.Generator) -> Sides:
        """Return the side per node, shape ``(n,)``.

        Both sides are non-empty for n >= 2.
        """


@runtime_checkable
class LevelBisector(Protocol):
    """Fast protocol of a bisector: split every block of a block-diagonal graph in one call.

    Examples
    --------
    >>> from agglo_core.authoring import split_at_median
    >>> from agglo_core.protocols import LevelBisector
    >>> class LeftRight:
    ...     def bisect_level(self, level, seeds):
    ...         return split_at_median(level, level.centroids[:, 0], level.centroids)
    >>> isinstance(LeftRight(), LevelBisector)
    True
    >>> LeftRight().bisect_level(agglo.samples.squares(2).graph, seeds=[0])
    array([0, 1, 0, 1])
    """

    def bisect_level(self, level: Graph, seeds: UInt64) -> Sides:
        """Return the side per node, shape ``(n,)``.

        ``seeds`` is ``(B,)``, one per block.
        """


@runtime_checkable
class UnevenBisector(Protocol):
    """Optional protocol: a bisector that splits off a given share of the mass.

    A piece of three parts is best split 1 : 2. ``bisect_shares`` is called for such pieces, ``bisect_level``
    or
    ``bisect`` for all others. Without this method, cuts are moved afterwards.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.authoring import split_at_median
    >>> from agglo_core.protocols import UnevenBisector
    >>> class LeftRight:
    ...     def bisect_level(self, level, seeds):
    ...         return split_at_median(level, level.centroids[:, 0], level.centroids)
    ...
    ...     def bisect_shares(self, level, seeds, shares):
    ...         return split_at_median(level, level.centroids[:, 0], level.centroids, shares)
    >>> isinstance(LeftRight(), UnevenBisector)
    True
    >>> LeftRight().bisect_shares(agglo.samples.strip(6).graph, [0], np.array([1 / 3]))
    array([0, 0, 1, 1, 1, 1])
    """

    def bisect_shares(self, level: Graph, seeds: UInt64, shares: Float) -> Sides:
        """Return the side per node, shape ``(n,)``.

        One side of block b holds ``shares[b] < 1/2``.

        The share refers to ``level.mass``; either side may be the lighter side.
        """


@runtime_checkable
class TargetAware(Protocol):
    """Optional protocol: a bisector whose splits depend on the target of the run.

    Examples
    --------
    >>> from agglo_core.protocols import Target, TargetAware
    >>> class Counting:
    ...     parts = None
    ...
    ...     def for_target(self, target):
    ...         aware = Counting()
    ...         aware.parts = target.parts
    ...         return aware
    >>> isinstance(Counting(), TargetAware), Counting().for_target(Target(parts=8)).parts
    (True, 8)
    """

    def for_target(self, target: Target) -> LevelBisector | Bisector:
        """Return the bisector for pieces with this ``target``, or ``self``.

        It is called before pieces are split. Nested sizes are then met in turn, the coarsest first.
        """


@runtime_checkable
class Partitioner(Protocol):
    """Optional protocol: direct k-way partition of a connected graph.

    The partition is refined unless ``final_parts = True``.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.protocols import Partitioner, Target
    >>> class Runs:
    ...     def partition(self, graph, target, seed):
    ...         return np.arange(graph.n) * target.parts // graph.n
    >>> isinstance(Runs(), Partitioner)
    True
    >>> Runs().partition(agglo.samples.squares(2).graph, Target(parts=2), seed=0)
    array([0, 0, 1, 1])
    """

    def partition(self, graph: Graph, target: Target, seed: int) -> Int:
        """Return labels ``(n,)``: ``0..target.parts-1`` for a target count, ``0..n-1`` for a target size.

        Faults are repaired.
        """


@runtime_checkable
class Refiner(Protocol):
    """Component that improves labels, without emptying a part or splitting a part into more components.

    ``objective`` names the value that never gets worse: one of
    :data:`agglo_core.graph.objectives.OBJECTIVES`, such as ``"interface"`` (total length) or
    ``"compactness"`` (moment of inertia), or a metric, summed over the parts.

    An optional attribute ``tests_moves = True`` declares that no move disconnects or empties a part, or makes
    a part wider than ``target.h_star``. Finished levels are then not tested again, so a false declaration
    leaves disconnected or wide parts.

    Examples
    --------
    >>> from agglo_core.protocols import Refiner
    >>> class Content:
    ...     objective = "interface"
    ...
    ...     def refine(self, graph, labels, seeds, target):
    ...         return labels  # no worse
    >>> isinstance(Content(), Refiner)
    True
    """

    objective: str

    def refine(self, graph: Graph, labels: Int, seeds: UInt64, target: Target) -> Int:
        """Return new labels ``(n,)``, with a declared objective that is no worse."""


@runtime_checkable
class ConnectivityFixer(Protocol):
    """Component that makes every part connected, and keeps each block's label set.

    Examples
    --------
    >>> from agglo_core import authoring
    >>> from agglo_core.protocols import ConnectivityFixer
    >>> class LargestStays:
    ...     def fix(self, graph, labels):
    ...         return authoring.ConnectivityFixer().fix(graph, labels)
    >>> isinstance(LargestStays(), ConnectivityFixer)
    True
    """

    def fix(self, graph: Graph, labels: Int) -> Int:
        """Return new labels ``(n,)``, unchanged if all parts are connected."""
