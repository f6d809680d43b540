"""Plan the work: full or quick."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from agglo_core.authoring import PluginError, default
from agglo_paper.work.grids import FAMILIES, GRIDS
from agglo_paper.work.measures import SOLVER
from agglo_paper.work.strategies import Strategy


@dataclass(frozen=True)
class Plan:
    """Columns and amounts of work.

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
        """Columns that can be computed here."""
        return [each for each in self.columns if not each.problem]

    @property
    def printed(self) -> list[Strategy]:
        """The paper's own columns."""
        return list(self.columns[:3])

    @property
    def compared(self) -> list[Strategy]:
        """Columns compared with printed numbers: the paper's own, and `gnn` against its GNN."""
        return [*self.columns[:3], *(each for each in self.usable if each.name == "gnn")]

    @property
    def others(self) -> list[Strategy]:
        """All other columns."""
        return [each for each in self.columns if each not in self.compared]

    def problems(self) -> list[str]:
        """Return the reasons for missing columns, one sentence each."""
        return [f"{each.name} is not available ({each.problem})" for each in self.columns if each.problem]


def full(columns: Sequence[Strategy]) -> Plan:
    """Return the full plan: the paper's 21 meshes with 25 to 5000 cells, then up to 100,000."""
    cells = [25, *range(250, 5001, 250), 10_000, 20_000, 50_000, 100_000]
    return Plan(columns, 20, GRIDS, 3, FAMILIES, 50, cells, 20, 0.5, _solver_package())


def quick(columns: Sequence[Strategy]) -> Plan:
    """Return the quick plan: all tables with fewer rows and repetitions."""
    few = ("triangles", "squares"), 2, ("Voronoi",), 2
    return Plan(columns, 2, *few, (25, 500), 3, 0.1, _solver_package())


def _solver_package() -> str:
    try:
        record = default().record("solver", SOLVER)
    except PluginError:
        return ""
    usable = record.state == "ok" and record.component is not None
    return record.component.target.split(".")[0] if usable and record.component else ""
