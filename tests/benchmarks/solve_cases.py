"""Meshes and problems for the solver benchmarks."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import Delaunay

sys.path.append(str(Path(__file__).parents[1]))  # for the meshes of the tests

from solid_meshes import wedge_layers

from agglo_core import Mesh, agglomerate, samples
from agglo_core.mesh.elements import polyhedra_from_elements
from agglo_core.problems import Diffusion


def side(cells: int) -> int:
    """Return the cells per side in a square grid."""
    return max(2, round(np.sqrt(cells)))


def graded(cells: int, ratio: float) -> Mesh:
    """Return squares graded along x, where the last column is ``ratio`` times as wide as the first."""
    n = side(cells)
    even = samples.squares(n)
    x, y = even.points.T
    layers = np.expm1(np.log(ratio) * x) / np.expm1(np.log(ratio))
    return Mesh.from_polygons(np.column_stack((layers, y)), even.boundary_loops.vertices.reshape(-1, 4))


def squeezed(cells: int, ratio: float) -> Mesh:
    """Return Voronoi cells squeezed along y."""
    mesh = samples.voronoi(cells, seed=0)
    loops = mesh.boundary_loops
    return Mesh.from_polygons(mesh.points * [1.0, ratio], (loops.loop_offsets, loops.vertices))


def edge(cells: int, each: int = 1) -> int:
    """Return the cubes per edge of a grid with ``cells`` cells, ``each`` of them per cube."""
    return max(2, round((cells / each) ** (1 / 3)))


def slivers(n: int) -> Mesh:
    """Return about ``n`` Delaunay tetrahedra of random points, including very flat cells."""
    rng, per_edge = np.random.default_rng(0), edge(n, 7)
    inside, grid = rng.random((per_edge**3, 3)), np.array(list(product(range(per_edge), repeat=3)))
    outer = (grid == 0) | (grid == per_edge - 1)
    moves = np.where(outer, 0.0, rng.uniform(-0.3, 0.3, grid.shape))
    surface = ((grid + moves) / (per_edge - 1))[outer.any(axis=1)]
    points = np.concatenate((inside, surface))
    cells = Delaunay(points).simplices.astype(np.int64)
    volumes = np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]])
    cells[volumes < 0.0] = cells[volumes < 0.0][:, [0, 2, 1, 3]]
    kept = cells[np.abs(volumes) > 1e-10]
    return Mesh.from_polyhedra(points, polyhedra_from_elements({"tetra": kept}))


def lumps(n: int) -> Mesh:
    """Return ``n`` agglomerates of eight tetrahedra."""
    fine = samples.tetrahedra(edge(8 * n, 6))
    how: Any = {"bisector": "coordinate", "refiners": (), "polish": False}
    return fine.coarsen(agglomerate(fine, cells_per_part=8, **how).levels[0])


def half(n: int) -> int:
    """Return the number of points for about ``n`` triangles."""
    return max(8, n // 2)


MESHES: Mapping[str, Callable[[int], Mesh]] = {
    "squares": lambda n: samples.squares(side(n)),
    "triangles": lambda n: samples.triangles(side(n // 2)),
    "voronoi": lambda n: samples.voronoi(n, seed=0),
    "random": lambda n: samples.random_triangles(half(n), seed=0),
    "boxes": lambda n: samples.boxes(edge(n)),
    "tetrahedra": lambda n: samples.tetrahedra(edge(n, 6)),
    "solids": lambda n: samples.voronoi3d(n, seed=0),
    "lumps": lumps,
    "slivers": slivers,
    "wedges": lambda n: wedge_layers(edge(n // 2, 6), 10, 1e-5, 0),
    "squeezed": lambda n: squeezed(n, 1e-3),
    "graded": lambda n: graded(n, 1e3),
    "layers": lambda n: graded(n, 1e6),
    "halves": lambda n: samples.voronoi(n, seed=0),
    "checks": lambda n: samples.voronoi(n, seed=0),
    "jumps": lambda n: samples.voronoi(n, seed=0),
    "contrasts": lambda n: samples.voronoi(n, seed=0),
}
"""Meshes by name.

Grading is 1e3, and 1e6 for ``layers``. Voronoi cells have κ of 1 and 1e6 by halves, as a checkerboard, or
(``contrasts``) at random per cell; on ``jumps`` κ is log-uniform in 1e±3 per cell; ``squeezed`` cells are
1e-3 times as high as wide.
"""
SOLID = ("boxes", "tetrahedra", "solids", "lumps", "slivers", "wedges")
"""3-D meshes: ``solids`` are Voronoi cells, ``lumps`` agglomerates of eight tetrahedra, ``wedges`` ten layers
of height 1e-5 under tetrahedra."""


def problem_on(name: str, mesh: Mesh) -> Diffusion:
    """Return the problem for a mesh."""
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
