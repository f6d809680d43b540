"""Measure PolyDG assembly in unknowns per CPU second, next to vectorised numpy.

    python tests/benchmarks/assembly.py [--cells N] [--degrees P ...] [--repeats N] [--reference-cells N]

Squares and random Voronoi cells on the unit square, one thread, process CPU seconds after a warm-up, best
repeat. Faces, areas and boxes of the mesh are available. ``kernels`` is ``discretise``: penalty, matrix and
right-hand side. ``numpy`` is only the matrix, by the reference implementation of the tests (quadrature
points, einsum, one sparse sum), on fewer cells because its memory use is far larger.

The second table has tetrahedra, cubes and Voronoi cells on the unit cube, a quarter as many, with the sharp
penalty. Voronoi cells are numbered along a curve, as in ``polydg_mg``, or (``scattered``) as generated.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import sys
import time
from collections.abc import Callable
from math import comb
from pathlib import Path
from typing import Any

import numpy as np

from agglo_core import Mesh, samples
from agglo_core.graph.ordering import curve_order
from agglo_core.problems import Diffusion
from agglo_polydg_mg.forms.assembly import discretise
from agglo_polydg_mg.forms.penalty import face_penalty

sys.path.insert(0, str(Path(__file__).parents[1] / "plugins"))
from test_polydg_kernels import reference_matrix

MESHES: dict[str, Callable[[int], Mesh]] = {
    "squares": lambda n: samples.squares(round(np.sqrt(n))),
    "voronoi": lambda n: samples.voronoi(n, seed=0),
}


def along_a_curve(mesh: Mesh) -> Mesh:
    """Return the mesh renumbered so that neighbours are close in memory."""
    return mesh.renumbered(curve_order(mesh.graph.centroids))


SOLIDS: dict[str, Callable[[int], Mesh]] = {
    "tetrahedra": lambda n: samples.tetrahedra(round((n / 6) ** (1 / 3))),
    "boxes": lambda n: samples.boxes(round(n ** (1 / 3))),
    "solids": lambda n: along_a_curve(samples.voronoi3d(n, seed=0)),
    "scattered": lambda n: samples.voronoi3d(n, seed=0),
}


def cpu(call: Callable[[], Any], repeats: int) -> float:
    """Return the minimum CPU seconds for a call."""
    found = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        found.append(time.process_time() - start)
    return min(found)


def ready(mesh: Mesh) -> Mesh:
    """Return the mesh with its cached geometry computed."""
    _ = mesh.cell_faces, mesh.cell_vertices, mesh.cell_measures, mesh.face_normals
    _ = mesh.boundary_loops if mesh.dim == 2 else None
    return mesh


def numpy_rate(mesh: Mesh, degree: int) -> float:
    """Return unknowns per second of the reference implementation."""
    sigma, kappa = face_penalty(mesh, degree), np.ones(mesh.n_cells)
    seconds = cpu(lambda: reference_matrix(mesh, degree, kappa, sigma), 1)
    return mesh.n_cells * (degree + 1) * (degree + 2) / 2 / seconds


def main() -> None:
    """Read the arguments, warm up and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, default=65_536)
    parser.add_argument("--reference-cells", type=int, default=16_384)
    parser.add_argument("--degrees", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    problem = Diffusion(source=8.0)
    # 2-D meshes: kernels and numpy.
    discretise(samples.voronoi(50), 2, problem)
    print(f"{'mesh':<10}{'cells':>8}{'p':>3}{'unknowns':>10}{'CPU s':>8}{'kernels M/s':>13}{'numpy M/s':>11}")
    for name, build in MESHES.items():
        mesh, small = ready(build(options.cells)), ready(build(options.reference_cells))
        for p in options.degrees:
            unknowns = mesh.n_cells * (p + 1) * (p + 2) // 2
            seconds = cpu(lambda mesh=mesh, p=p: discretise(mesh, p, problem), options.repeats)
            print(
                f"{name:<10}{mesh.n_cells:>8}{p:>3}{unknowns:>10}{seconds:>8.3f}"
                f"{unknowns / seconds / 1e6:>13.2f}{numpy_rate(small, p) / 1e6:>11.3f}",
                flush=True,
            )
    # 3-D meshes: kernels only.
    discretise(samples.voronoi3d(20), 1, problem, penalty="sharp")
    for name, build in SOLIDS.items():
        mesh = ready(build(options.cells // 4))
        for p in options.degrees:
            unknowns = mesh.n_cells * comb(p + 3, 3)
            seconds = cpu(
                lambda mesh=mesh, p=p: discretise(mesh, p, problem, penalty="sharp"), options.repeats
            )
            print(
                f"{name:<10}{mesh.n_cells:>8}{p:>3}{unknowns:>10}{seconds:>8.3f}"
                f"{unknowns / seconds / 1e6:>13.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
