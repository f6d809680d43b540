"""Measure the wall time of a whole run with one thread and with several, stage by stage.

    python tests/benchmarks/threads.py [--cells N] [--threads T] [--repeats N] [--meshes NAME ...]

From arrays to files: mesh, dual graph, N/16 parts, their quality and coarse mesh, VTU. Results must be
equal. Times are medians of alternating repeats, each without derived data at its start. ``alone`` is the
share of CPU time in which only the calling thread works, and ``at best`` the resulting ratio for an ideal
distribution of the rest on idle processors: on a busy machine these two are the meaningful values.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import gc
import hashlib
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import agglo_core as agglo
from agglo_core import Mesh, samples
from agglo_core.arrays import Float, Int
from agglo_core.measure import measure_levels
from agglo_core.threads import using_threads

MESHES: dict[str, Callable[[int, int], Mesh]] = {
    "triangles": lambda cells, seed: samples.random_triangles(cells // 2, seed=seed),
    "voronoi": lambda cells, seed: samples.voronoi(cells, seed=seed),
}


class Loops(NamedTuple):
    """Mesh as arrays of a user."""

    points: Float
    offsets: Int
    vertices: Int

    @classmethod
    def of(cls, mesh: Mesh) -> Loops:
        """Return the loops of a 2-D mesh."""
        loops = mesh.boundary_loops
        return cls(mesh.points, loops.loop_offsets, loops.vertices)


class Cost(NamedTuple):
    """Seconds of a stage: wall time, CPU time, and CPU time of the calling thread."""

    wall: float
    cpu: float
    alone: float


def stages(loops: Loops, folder: Path, seen: dict[str, str]) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield names and calls, each of which needs the previous calls.

    At the end ``seen`` has digests of the results.
    """
    made: dict[str, Any] = {}

    def keep(name: str, call: Callable[[], Any]) -> tuple[str, Callable[[], Any]]:
        return name, lambda: made.update({name: call()})

    yield keep("mesh", lambda: Mesh.from_polygons(loops.points, (loops.offsets, loops.vertices)))
    mesh = made["mesh"]
    yield keep("graph", lambda: mesh.graph)
    parts = mesh.n_cells // 16
    yield keep("agglomerate", lambda: agglo.agglomerate(mesh, n_parts=parts))
    yield keep("measure", lambda: measure_levels(mesh, made["agglomerate"]))
    yield keep("write", lambda: agglo.write(str(folder / "out.vtu"), mesh, made["agglomerate"]))
    level, graph = made["measure"][0], made["graph"]
    arrays = {
        "faces": (mesh.face_vertices, mesh.face_cells),
        "graph": (graph.indptr, graph.indices, graph.interface, graph.centroids, graph.measures),
        "labels": (level.labels,),
        "metrics": tuple(level.values.values()),
        "files": tuple(np.fromfile(file, np.uint8) for file in sorted(folder.iterdir())),
    }
    seen.update({name: digest(each) for name, each in arrays.items()})


def digest(arrays: tuple[Any, ...]) -> str:
    """Return a hash of arrays."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(np.ascontiguousarray(array).data)
    return found.hexdigest()


def run(loops: Loops, threads: int) -> tuple[dict[str, Cost], dict[str, str]]:
    """Return the costs of all stages, and digests of the results."""
    costs, seen = {}, {}
    with tempfile.TemporaryDirectory() as folder, using_threads(threads):
        for name, call in stages(loops, Path(folder), seen):
            gc.collect()
            clocks = time.perf_counter, time.process_time, time.thread_time
            before = [clock() for clock in clocks]
            call()
            costs[name] = Cost(*(clock() - start for clock, start in zip(clocks, before, strict=True)))
    costs["all"] = Cost(*np.sum(list(costs.values()), axis=0).tolist())
    return costs, seen


def compare(loops: Loops, threads: int, repeats: int) -> None:
    """Print the table.

    Raises AssertionError if results differ.
    """
    costs: dict[int, list[dict[str, Cost]]] = {1: [], threads: []}
    wanted: dict[str, str] = {}
    for _ in range(repeats):
        for count, rows in costs.items():
            row, seen = run(loops, count)
            rows.append(row)
            wanted = wanted or seen
            assert seen == wanted, [name for name in seen if seen[name] != wanted[name]]
    print(
        f"{'':12}{'wall 1':>9}{f'wall {threads}':>9}{'ratio':>8}{'cpu 1':>9}{f'cpu {threads}':>9}"
        f"{'alone':>8}{'at best':>9}"
    )
    for name in costs[1][0]:
        one, more = (Cost(*np.median([row[name] for row in costs[n]], axis=0)) for n in (1, threads))
        best = (more.alone + (more.cpu - more.alone) / threads) / one.cpu
        print(
            f"{name:12}{one.wall:9.3f}{more.wall:9.3f}{more.wall / one.wall:8.2f}{one.cpu:9.3f}"
            f"{more.cpu:9.3f}{more.alone / more.cpu:8.0%}{best:9.2f}",
            flush=True,
        )


def main() -> None:
    """Read the arguments, warm up and print a table per mesh."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, default=1_000_000)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--meshes", nargs="+", choices=MESHES, default=list(MESHES))
    options = parser.parse_args()
    for name in options.meshes:
        run(Loops.of(MESHES[name](1000, 0)), 1)
        loops = Loops.of(MESHES[name](options.cells, options.seed))
        print(f"\n{name}, {len(loops.offsets) - 1} cells, median of {options.repeats}")
        compare(loops, options.threads, options.repeats)


if __name__ == "__main__":
    main()
