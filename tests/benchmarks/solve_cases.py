"""Meshes and problems of the benchmark of solvers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from agglo_core import Mesh, samples
from agglo_core.problems import Diffusion


def side(cells: int) -> int:
    """Cells along a side of a square grid."""
    return max(2, round(np.sqrt(cells)))


def graded(cells: int, ratio: float) -> Mesh:
    """Squares drawn together towards one side, the last of them ``ratio`` times as wide as the first."""
    n = side(cells)
    even = samples.squares(n)
    x, y = even.points.T
    layers = np.expm1(np.log(ratio) * x) / np.expm1(np.log(ratio))
    return Mesh.from_polygons(np.column_stack((layers, y)), even.boundary_loops.vertices.reshape(-1, 4))


def half(n: int) -> int:
    """Points of about twice as many triangles."""
    return max(8, n // 2)


MESHES: Mapping[str, Callable[[int], Mesh]] = {
    "squares": lambda n: samples.squares(side(n)),
    "triangles": lambda n: samples.triangles(side(n // 2)),
    "voronoi": lambda n: samples.voronoi(n, seed=0),
    "random": lambda n: samples.random_triangles(half(n), seed=0),
    "graded": lambda n: graded(n, 1e3),
    "layers": lambda n: graded(n, 1e6),
    "halves": lambda n: samples.voronoi(n, seed=0),
    "checks": lambda n: samples.voronoi(n, seed=0),
    "jumps": lambda n: samples.voronoi(n, seed=0),
    "contrasts": lambda n: samples.voronoi(n, seed=0),
}
"""Meshes by name: graded by 1e3 and, ``layers``, by 1e6; Voronoi cells with κ of 1 and 1e6 by halves, as a
checkerboard and, ``contrasts``, cell by cell at random; on ``jumps`` log-uniform in 1e±3 cell by cell."""


def problem_on(name: str, mesh: Mesh) -> Diffusion:
    """The problem that goes with a mesh."""
    rng = np.random.default_rng(0)
    kappa: Any = 1.0
    if name == "jumps":
        kappa = 10.0 ** rng.uniform(-3, 3, mesh.n_cells)
    centres = mesh.cell_centroids
    if name == "halves":
        kappa = np.where(centres[:, 0] < 0.5, 1.0, 1e6)
    if name == "checks":
        kappa = np.where((centres * 8).astype(int).sum(axis=1) % 2, 1e6, 1.0)
    if name == "contrasts":
        kappa = np.where(rng.random(mesh.n_cells) < 0.5, 1.0, 1e6)
    return Diffusion(kappa=kappa, source=8.0)
