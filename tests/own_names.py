"""User components of nearly every kind, with names unknown to other registries."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from agglo_core import Component, Mesh, Registry, samples

__all__ = ["MINE", "Asks"]

HERE = __name__


class Tiny:
    """Format that stores only the number of squares per side."""

    suffixes = (".tiny",)
    lossless = False

    def read(self, path: Path) -> Mesh:
        return samples.squares(int(path.read_text()))

    def read_hierarchy(self, path: Path) -> tuple[Mesh, None]:
        return self.read(path), None

    def write(self, path: Path, mesh: Mesh, hierarchy: object = None) -> None:
        path.write_text(str(round(mesh.n_cells**0.5)))


class Crowd:
    """Squared number of cells per part."""

    better, bounds, homogeneity = "low", (1.0, float("inf")), 0

    def measure(self, mesh: Mesh, labels: np.ndarray) -> np.ndarray:
        return np.bincount(labels) ** 2.0

    def changes(self, graph: object, labels: np.ndarray, cells: np.ndarray, parts: np.ndarray) -> np.ndarray:
        sizes = np.bincount(labels)
        return np.where(labels[cells] == parts, 0.0, 2.0 * (sizes[parts] - sizes[labels[cells]] + 1))


class OneSided:
    """Bisector that leaves one side empty, so that the fallback is used."""

    def bisect(self, graph: object, rng: object) -> np.ndarray:
        return np.zeros(graph.n, int)  # type: ignore[attr-defined]


class Strips:
    """Direct partition into three strips, to be completed by bisection."""

    def partition(self, graph: object, target: object, seed: int) -> np.ndarray:
        return np.arange(graph.n) * 3 // graph.n  # type: ignore[attr-defined]


class Free:
    """Constraint that forbids nothing."""

    def forbidden(self, graph: object) -> np.ndarray:
        return np.zeros(len(graph.indices), bool)  # type: ignore[attr-defined]


class Note:
    """Report section with one sentence."""

    title = "A note of mine"

    def html(self, mesh: Mesh, runs: object) -> str:
        return "<p>noted</p>"


class Asks:
    """Refiner that does nothing and keeps its registry."""

    objective = "crowd"

    def __init__(self, rounds: int = 1, *, registry: Registry | None = None) -> None:
        self.registry = registry

    def refine(self, graph: object, labels: np.ndarray, seeds: object, target: object) -> np.ndarray:
        return labels


def patch(n: int = 6) -> Mesh:
    """``n`` by ``n`` squares."""
    return samples.squares(n)


MINE = [
    Component("bisector", "one_sided", f"{HERE}:OneSided", fallback="straight"),
    Component("bisector", "strips", f"{HERE}:Strips"),
    Component("bisector", "straight", "agglo_core.split.geometric:InertialBisection"),
    Component("refiner", "asks", f"{HERE}:Asks"),
    Component("refiner", "downhill", "agglo_core.refine.descent:DescentRefiner"),
    Component("fixer", "joins", "agglo_core.refine.connectivity:ConnectivityFixer"),
    Component("metric", "crowd", f"{HERE}:Crowd"),
    Component("format", "tiny", f"{HERE}:Tiny"),
    Component("sample", "patch", f"{HERE}:patch"),
    Component("problem", "heating", "agglo_core.problems.diffusion:Diffusion"),
    Component("problem", "eight", "agglo_core.problems.diffusion:constant"),
    Component("smoother", "jacobi", "agglo_core.multigrid.smoothers.level_smoothers:BlockJacobi"),
    Component("transfer", "inject", "agglo_core.multigrid.coarsening.transfers:Injection"),
    Component("coarse_operator", "products", "agglo_core.multigrid.coarse_operators:Galerkin"),
    Component("coarse_solver", "eliminate", "agglo_core.multigrid.coarse_solve:Elimination"),
    Component("constraint", "free", f"{HERE}:Free"),
    Component("section", "note", f"{HERE}:Note"),
]
"""Declarations of these components."""
