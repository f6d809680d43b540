"""What a bisector offers that makes all splits of a run by itself."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

from agglo_core.arrays import Int, UInt64
from agglo_core.graph import Graph
from agglo_core.progress import Tell


class Growth(Protocol):
    """Pieces of a graph that are split again and again."""

    def split(self, quotas: Int, seeds: UInt64, tell: Tell) -> tuple[Int, Int]:
        """Split piece i, with the seed ``seeds[i]``, into ``quotas[i]`` connected pieces.

        Returns the new labels ``(n,)``, numbered by first node, which are the pieces of the next call; and
        for each depth the pieces split, the cells in them and the pieces that had to be mended,
        ``(depths, 3)``.
        ``tell`` is told which share of the work is done.
        """


@runtime_checkable
class GrowthToSize(Growth, Protocol):
    """Optional: growth that also stops at a size."""

    def split_to_size(self, limit: float, seeds: UInt64, tell: Tell) -> tuple[Int, Int]:
        """Split the pieces until none but single cells is wider than ``limit``; returns as ``split``."""


@runtime_checkable
class RestartedGrowth(Growth, Protocol):
    """Optional: growth that goes on from other pieces of its graph, and need not be made anew."""

    def restart(self, pieces: Int) -> None:
        """Let the connected ``pieces (n,)`` be those that the next call splits."""


@runtime_checkable
class Growing(Protocol):
    """Optional: a bisector that makes all splits of a run by itself, fixed and refined."""

    def grow(self, graph: Graph, pieces: Int, refiners: Sequence[Any], fixer: Any) -> Growth | None:
        """Growth of the connected ``pieces (n,)``, or None: then the driver asks depth by depth.

        The parts must be as good as those that ``bisect_level``, the refiners and the fixer make together; a
        bisector that cannot do what these components do returns None.
        """
