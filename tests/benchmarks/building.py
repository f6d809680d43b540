"""Measure building and coarsening relative to a sort of the same faces: CPU seconds, ratios, memory per cell.

    python tests/benchmarks/building.py [--cells N] [--solids N] [--repeats R] [--meshes NAME ...] [--memory]

Steps: from arrays (points and loops) to Mesh, from Mesh to Graph, then coarsening of both to parts of 16
cells. ``sort`` is the reference: one ``np.lexsort`` of all half-edges by their end points (in 3-D: of all
half-faces by their three lowest points), in random order. One thread, CPU seconds, the best of alternating
repeats; other times are multiples of ``sort``. ``G/M`` is ``Graph.coarsen`` over ``Mesh.coarsen``. With
``--memory`` each mesh is also built in a child process, and a second line shows by how much each step raised
the peak of resident memory, in bytes per cell.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import multiprocessing
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agglo_core import Mesh, samples
from agglo_core.mesh.elements import polyhedra_from_elements

PART = 16


class Bare(NamedTuple):
    """Function that builds the mesh from arrays, points of each half-face, and labels of parts."""

    make: Callable[[], Mesh]
    faces: NDArray[np.int64]
    labels: NDArray[np.int64]


def boxes_of(mesh: Mesh) -> NDArray[np.int64]:
    """Return parts of about 16 cells with centroids in the same box of a grid."""
    low, high = mesh.cell_centroids.min(axis=0), mesh.cell_centroids.max(axis=0)
    side = max(1, round((mesh.n_cells / PART) ** (1 / mesh.dim)))
    place = np.minimum(((mesh.cell_centroids - low) / (high - low) * side).astype(int), side - 1)
    return np.unique(place @ side ** np.arange(mesh.dim), return_inverse=True)[1]


def plane(mesh: Mesh) -> Bare:
    """Prepare a 2-D mesh as loops."""
    loops, points = mesh.boundary_loops, mesh.points.copy()
    ends = np.append(loops.vertices[1:], 0)
    ends[loops.loop_offsets[1:] - 1] = loops.vertices[loops.loop_offsets[:-1]]
    cells = loops.loop_offsets.copy(), loops.vertices.copy()
    faces = np.sort(np.stack((loops.vertices, ends)), axis=0)
    return Bare(lambda: Mesh.from_polygons(points, cells), faces, boxes_of(mesh))


def tetrahedra(mesh: Mesh) -> Bare:
    """Prepare a mesh of tetrahedra as half-faces."""
    points, nodes = mesh.points.copy(), mesh.cell_vertices[1].reshape(-1, 4)
    a, b, c, d = (points[nodes[:, k]] for k in range(4))
    turned = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    nodes = np.where(turned[:, None], nodes[:, [1, 0, 2, 3]], nodes)
    solids = polyhedra_from_elements({"tetra": nodes})
    faces = np.sort(solids.vertices.reshape(-1, 3), axis=1).T
    return Bare(lambda: Mesh.from_polyhedra(points, tuple(solids)), faces, boxes_of(mesh))


def boxes(mesh: Mesh) -> Bare:
    """Prepare a mesh of boxes as half-faces."""
    corners = mesh.cell_vertices[1].reshape(-1, 8)[:, [0, 4, 6, 2, 1, 5, 7, 3]]
    solids = polyhedra_from_elements({"hexahedron": corners})
    points, faces = mesh.points.copy(), np.sort(solids.vertices.reshape(-1, 4), axis=1).T[:3]
    return Bare(lambda: Mesh.from_polyhedra(points, tuple(solids)), faces, boxes_of(mesh))


def cases(cells: int, solids: int, seed: int) -> Mapping[str, Callable[[], Bare]]:
    """Return functions for the meshes by name.

    Cell counts are approximate.
    """
    return {
        "voronoi": lambda: plane(samples.voronoi(cells, seed=seed)),
        "triangles": lambda: plane(samples.random_triangles(cells // 2, seed=seed)),
        "squares": lambda: plane(samples.squares(round(cells**0.5))),
        "tetrahedra": lambda: tetrahedra(samples.tetrahedra(max(2, round((solids / 6) ** (1 / 3))))),
        "boxes": lambda: boxes(samples.boxes(max(2, round(solids ** (1 / 3))))),
    }


def steps(bare: Bare) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield names and calls of the steps, each of which needs the previous steps."""
    faces = bare.faces[:, np.random.default_rng(0).permutation(bare.faces.shape[1])]
    yield "sort", lambda: np.lexsort(faces)
    made: list[Mesh] = []
    yield "mesh", lambda: made.append(bare.make())
    mesh = made[0]
    yield "graph", lambda: mesh.graph
    yield "Mesh.coarsen", lambda: mesh.coarsen(bare.labels)
    yield "Graph.coarsen", lambda: mesh.graph.coarsen(bare.labels)


def best_of(bare: Bare, repeats: int) -> dict[str, float]:
    """Return the minimum CPU seconds of each step."""
    best: dict[str, float] = {}
    for _ in range(repeats):
        for name, call in steps(bare):
            start = time.process_time()
            call()
            seconds = time.process_time() - start
            best[name] = min(seconds, best.get(name, seconds))
    return best


def peaks(make: Callable[[], Bare]) -> dict[str, float]:
    """Return the increase of peak memory per step, in bytes per cell."""
    bare, found = make(), {}
    cells = len(bare.labels)
    for name, call in steps(bare):
        with open("/proc/self/clear_refs", "w") as file:  # reset the peak to the present size
            file.write("5")
        before = resident("VmRSS")
        call()
        found[name] = (resident("VmHWM") - before) / cells
    return found


def resident(key: str) -> float:
    """Return present (VmRSS) or peak (VmHWM) process memory in bytes."""
    with open("/proc/self/status") as file:
        return next(1024.0 * int(line.split()[1]) for line in file if line.startswith(key))


def _send_peaks(pipe: Any, name: str, cells: int, solids: int, seed: int) -> None:
    warm_up()
    pipe.send(peaks(cases(cells, solids, seed)[name]))


def memory(name: str, cells: int, solids: int, seed: int) -> dict[str, float]:
    """Return the peaks for a mesh, measured in a child process."""
    ours, theirs = multiprocessing.Pipe()
    os.environ["MALLOC_MMAP_THRESHOLD_"] = "65536"  # freed arrays are returned to the system
    process = multiprocessing.get_context("spawn").Process(
        target=_send_peaks, args=(theirs, name, cells, solids, seed)
    )
    process.start()
    found: dict[str, float] = ours.recv()
    process.join()
    return found


def warm_up() -> None:
    """Compile all kernels."""
    for make in cases(100, 60, 0).values():
        best_of(make(), 1)


def main() -> None:
    """Read the arguments, warm up and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, default=200_000, help="of plane meshes")
    parser.add_argument("--solids", type=int, default=100_000, help="cells of 3-D meshes")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--meshes", nargs="+", default=None)
    parser.add_argument("--memory", action="store_true")
    options = parser.parse_args()
    warm_up()
    sizes = options.cells, options.solids, options.seed
    names = ("mesh", "graph", "Mesh.coarsen", "Graph.coarsen")
    print(f"{'':12}{'cells':>9}{'sort s':>9}" + "".join(f"{name:>15}" for name in names) + f"{'G/M':>8}")
    for case, make in cases(*sizes).items():
        if options.meshes and case not in options.meshes:
            continue
        bare = make()
        best = best_of(bare, options.repeats)
        line = f"{case:12}{len(bare.labels):9d}{best['sort']:9.3f}"
        line += "".join(f"{best[name] / best['sort']:15.3f}" for name in names)
        print(line + f"{best['Graph.coarsen'] / best['Mesh.coarsen']:8.2f}", flush=True)
        if options.memory:
            found = memory(case, *sizes)
            print(f"{'  bytes/cell':30}" + "".join(f"{found[name]:15.0f}" for name in names), flush=True)


if __name__ == "__main__":
    main()
