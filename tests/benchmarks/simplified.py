"""Measure simplified coarse meshes: saved faces, and faster assembly of PolyDG.

    python tests/benchmarks/simplified.py [--meshes NAME ...] [--coarser K ...] [--tolerances T ...]

Each mesh is coarsened to K cells per part by the default strategy, and simplified. Columns: faces and
vertices in use (the unknowns in the lowest-order virtual element method), largest change in a cell measure,
interfaces kept unchanged, CPU seconds to simplify, and CPU seconds of the assembly (p = 2, C = 10) relative
to the original mesh, as medians of ``--repeat`` alternating runs in this process.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

import agglo_core as agglo
from agglo_core import Diffusion, Mesh, samples
from agglo_core.registry import default

MESHES: dict[str, Callable[[], Mesh]] = {
    "voronoi": lambda: samples.voronoi(20_000, seed=7),
    "brain": samples.brain,
    "triangles": lambda: samples.random_triangles(10_000, seed=7),
    "squares": lambda: samples.squares(140),
}


def fresh(mesh: Mesh) -> Mesh:
    """Return a copy of the mesh without derived data."""
    return Mesh(mesh.points, mesh.face_offsets, mesh.face_vertices, mesh.face_cells)


def assembly(meshes: list[Mesh], repeat: int) -> list[float]:
    """Return the median CPU seconds of the assembly on each mesh, including derived data."""
    how = default().build("discretisation", "polydg", degree=2, penalty=10.0, scaled_basis=False)
    taken = []
    for turn in range(repeat + 1):
        for k, mesh in enumerate(map(fresh, meshes)):
            start = time.process_time()
            how.assemble(Diffusion(source=1.0), mesh)
            taken.append((k, time.process_time() - start) if turn else (-1, 0.0))  # the first run compiles
    return [float(np.median([each for k, each in taken if k == own])) for own in range(len(meshes))]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--meshes", nargs="+", choices=MESHES, default=list(MESHES))
    parser.add_argument("--coarser", nargs="+", type=int, default=[4, 64])
    parser.add_argument("--tolerances", nargs="+", type=float, default=[0.0, 0.02, 0.05, 0.1])
    parser.add_argument("--repeat", type=int, default=5)
    given = parser.parse_args()
    print("mesh        cells  tolerance    faces  vertices  change  held back  seconds  assembly")
    few = samples.voronoi(60, seed=0)
    few.coarsen(np.arange(60) // 10).simplified(0.1)  # compiles
    for name in given.meshes:
        fine = MESHES[name]()
        for level in agglo.agglomerate(fine, cells_per_part=tuple(given.coarser), seed=0).levels:
            show(name, fine.coarsen(level), given.tolerances, given.repeat)


def show(name: str, mesh: Mesh, tolerances: list[float], repeat: int) -> None:
    """Print a line for the original mesh, and a line per tolerance."""
    made, seconds = [], []
    for tolerance in tolerances:
        again = fresh(mesh)
        start = time.process_time()
        made.append(again.simplified(tolerance))
        seconds.append(time.process_time() - start)
    taken = assembly([mesh, *made], repeat)
    used = len(np.unique(mesh.face_vertices))
    print(f"{name:10} {mesh.n_cells:6} {'as it is':>10} {mesh.n_faces:8} {used:9}")
    for k, (tolerance, simple) in enumerate(zip(tolerances, made, strict=True)):
        record = simple.simplification
        change = float(np.abs(record.measure_change / mesh.cell_measures).max())
        print(
            f"{'':17} {tolerance:10g} {simple.n_faces:8} {simple.n_points:9} {change:7.3f} "
            f"{record.held_back:10} {seconds[k]:8.3f} {taken[k + 1] / taken[0]:9.2f}"
        )


if __name__ == "__main__":
    main()
