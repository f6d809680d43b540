"""Extent of the computations: full, or quick with fewer rows and repetitions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from agglo_core.authoring import PluginError, default
from agglo_paper.work.grids import FAMILIES, GRIDS
from agglo_paper.work.measures import SOLVER
from agglo_paper.work.strategies import Strategy


@dataclass(frozen=True)
class Plan:
    """Methods (table columns), meshes and repetitions of the computations.

    Attributes
    ----------
    columns : sequence of Strategy
    repeats : int
        Renumberings or seeds for a varying strategy.
    grids : sequence of str
        Grids in the multigrid tables.
    degrees : int
        Largest polynomial degree.
    families : sequence of str
        Fresh mesh families, with ``fresh`` meshes each.
    cells : sequence of int
        Mesh sizes in the runtime figure, with up to ``runs`` runs in ``seconds`` each.
    solver : str
        Package with the paper's solver; empty if unavailable.
    """

    columns: Sequence[Strategy]
    repeats: int
    grids: Sequence[str]
    degrees: int
    families: Sequence[str]
    fresh: int
    cells: Sequence[int]
    runs: int
    seconds: float
    solver: str

    @property
    def usable(self) -> list[Strategy]:
        """Methods that are available in this installation."""
        return [each for each in self.columns if not each.problem]

    @property
    def printed(self) -> list[Strategy]:
        """The three methods for which the paper prints numbers."""
        return list(self.columns[:3])

    @property
    def compared(self) -> list[Strategy]:
        """Methods compared with printed numbers: the paper's own, and `gnn` with the numbers of its GNN."""
        return [*self.columns[:3], *(each for each in self.usable if each.name == "gnn")]

    @property
    def others(self) -> list[Strategy]:
        """All methods that are not compared with printed numbers."""
        return [each for each in self.columns if each not in self.compared]

    def problems(self) -> list[str]:
        """Return the reasons why methods are unavailable, one sentence each."""
        return [f"{each.name} is not available ({each.problem})" for each in self.columns if each.problem]


def full(columns: Sequence[Strategy]) -> Plan:
    """Return the full extent, with run times on the paper's 21 mesh sizes to 5000 cells, then to 100,000."""
    cells = [25, *range(250, 5001, 250), 10_000, 20_000, 50_000, 100_000]
    return Plan(columns, 20, GRIDS, 3, FAMILIES, 50, cells, 20, 0.5, _solver_package())


def quick(columns: Sequence[Strategy]) -> Plan:
    """Return the quick extent: all tables, with fewer rows and repetitions."""
    few = ("triangles", "squares"), 2, ("Voronoi",), 2
    return Plan(columns, 2, *few, (25, 500), 3, 0.1, _solver_package())


def _solver_package() -> str:
    try:
        record = default().record("solver", SOLVER)
    except PluginError:
        return ""
    usable = record.state == "ok" and record.component is not None
    return record.component.target.split(".")[0] if usable and record.component else ""
