"""Small discretisation with cell values by two-point fluxes, for tests of user components."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from two_point_flux import TwoPointFlux

from agglo_core import Hierarchy, Mesh, MeshError, OptionError
from agglo_core.problems import Diffusion, Samples, System

__all__ = ["Bare", "CellValues", "Fluxes", "Ring"]

Array = NDArray[np.float64]


class CellValues:
    """One value per cell on a 2-D mesh with convex cells."""

    accepts: ClassVar[tuple[str, ...]] = ("diffusion",)

    def check(self, problem: Diffusion, mesh: Mesh) -> None:
        """Refuse 3-D meshes."""
        if mesh.dim != 2:
            raise MeshError("cell values are for the plane")

    def assemble(self, problem: Diffusion, mesh: Mesh) -> System:
        """Return the two-point flux system."""
        whole = Hierarchy(mesh, mesh.graph, [np.zeros(mesh.n_cells, int)], [{}], nested=True)
        solved = TwoPointFlux(most=0).solve(problem, whole)
        return System(solved.A, solved.b, np.arange(mesh.n_cells + 1), mesh)

    def coarse_operator(self, problem: Diffusion, mesh: Mesh, labels: NDArray[np.int64]) -> object:
        """Assemble on the coarse mesh."""
        return self.assemble(problem, mesh.coarsen(labels)).A

    def project(self, mesh: Mesh, function: Callable[[Array], Array]) -> Array:
        """Return the values at the centroids."""
        return function(mesh.cell_centroids)

    def evaluate(self, mesh: Mesh, x: Array, points: Array) -> Array:
        """Return the value of the cell with the nearest centroid."""
        apart = points[:, None] - mesh.cell_centroids
        return x[np.linalg.norm(apart, axis=2).argmin(axis=1)]

    def sample(self, mesh: Mesh, x: Array) -> Samples:
        """Sample each cell by a fan of triangles."""
        offsets, vertices = mesh.cell_vertices
        cells = np.repeat(np.arange(mesh.n_cells), np.diff(offsets))
        fans = [(a, k, k + 1) for a, b in pairwise(offsets) for k in range(a + 1, b - 1)]
        around = np.array(_around(mesh, offsets, vertices))
        return Samples(cells, mesh.points[around], np.array(fans), x[cells])

    def errors(self, problem: Diffusion, mesh: Mesh, x: Array) -> dict[str, float]:
        """Return L2 and maximum errors at the centroids."""
        if problem.exact is None:
            return {}
        gap = x - problem.exact(mesh.cell_centroids)
        return {"l2": float(np.sqrt(mesh.cell_measures @ gap**2)), "max": float(abs(gap).max())}

    def load(self, problem: Diffusion, mesh: Mesh, b: Array) -> Array:
        """Return the load without Dirichlet data."""
        return np.broadcast_to(problem.source, mesh.n_cells) * mesh.cell_measures if problem.dirichlet else b

    def residual_measure(self, problem: Diffusion, mesh: Mesh, b: Array) -> Callable[[Array], float]:
        """Return the relative maximum norm, which differs from the 2-norm."""
        return lambda r: float(abs(r).max() / abs(b).max())


def _around(mesh: Mesh, offsets: NDArray[np.int64], vertices: NDArray[np.int64]) -> list[int]:
    """Return the vertices of each cell in angular order."""
    order: list[int] = []
    for cell, (a, b) in enumerate(pairwise(offsets)):
        x, y = (mesh.points[vertices[a:b]] - mesh.cell_centroids[cell]).T
        order += vertices[a:b][np.argsort(np.arctan2(y, x))].tolist()
    return order


class Fluxes(TwoPointFlux):
    """Two-point fluxes with a discretisation, so that the meaning of the unknowns is known."""

    accepts: ClassVar[tuple[str, ...]] = ("diffusion", "linear")
    discretisation = CellValues()


class Bare(TwoPointFlux):
    """Two-point fluxes without a discretisation."""


@dataclass(frozen=True)
class Ring:
    """Kind of problem without a solver."""

    kind: ClassVar[str] = "ring"

    turns: int = 1

    @classmethod
    def from_table(cls, table: dict[str, object], mesh: Mesh, folder: Path) -> Ring:
        """Read the only key, ``turns``."""
        if set(table) != {"turns"} or not isinstance(table["turns"], int):
            raise OptionError("turns must be a whole number, and the only key")
        return cls(table["turns"])

    @classmethod
    def example(cls, mesh: Mesh) -> Ring:
        """Return a problem with one turn."""
        return cls()
