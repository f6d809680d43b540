"""Compare all 3-D bisectors by quality and time of their parts, and ``gnn`` with METIS and ``sweep``.

    python tests/benchmarks/solid_parts.py [bisection] [recursion] [quality] [--seeds N] [--repeats N]

One thread, one process. ``bisection``: one split, including refinement, next to ``pymetis.part_graph(2)``;
median wall time; ``ncut`` is the area of the cut times ∛V (1/V₁ + 1/V₂). ``recursion``: N/32 parts, CPU time
relative to ``sweep``, with and without polish, and recursive METIS relative to this time. ``quality``: part
count, UF, CR, CRc, J, area between parts relative to ``sweep``, and CPU seconds; for N/32 parts and for
sizes 3 h and 6 h, where h is the largest cell diameter. Lines in capitals are other programs without our
refinement: METIS with the part count of ``gnn``, and recursive 2-means of scikit-learn.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pymetis
from numpy.typing import NDArray

import agglo_core as agglo
from agglo_core import Graph, Mesh, Target, samples
from agglo_core.arrays import frozen_int
from agglo_core.graph.ordering import curve_order
from agglo_core.registry import default

Labels = NDArray[np.int64]
Maker = Callable[[], Labels]
OURS = ("coordinate", "inertial", "sweep", "gnn", "kmeans", "kmeans_sklearn", "metis", "spectral")
METRICS = ("UF", "CR", "CRc", "J")
FAMILIES: dict[str, Callable[[int], Mesh]] = {
    "tetrahedra": lambda seed: samples.random_tetrahedra(2000, seed),
    "hexahedra": lambda seed: samples.boxes(18 + seed % 3),
    "Voronoi": lambda seed: samples.voronoi3d(4000, seed),
}


def timed(call: Maker, repeats: int, clock: Callable[[], float]) -> tuple[float, Labels]:
    """Return the median seconds of a call after a first call, and its last result."""
    seconds, found = [], call()
    for _ in range(repeats):
        start = clock()
        found = call()
        seconds.append(clock() - start)
    return float(np.median(seconds)), found


def between(graph: Graph, labels: Labels) -> float:
    """Return the area between parts."""
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    return 0.5 * float(graph.interface[labels[rows] != labels[graph.indices]].sum())


def raw_metis(graph: Graph, parts: int, recursive: bool) -> Maker:
    """Return a METIS partition of the same graph.

    Empty parts are dropped.
    """
    adjacency = pymetis.CSRAdjacency(graph.indptr, graph.indices)

    def call() -> Labels:
        found = pymetis.part_graph(parts, adjacency, recursive=recursive).vertex_part
        return np.unique(found, return_inverse=True)[1].astype(np.int64)

    return call


def ours(graph: Any, bisector: str, **options: Any) -> Labels:
    """Return the labels of one level."""
    return agglo.agglomerate(graph, bisector=bisector, **options).levels[0]


def large_meshes() -> dict[str, Mesh]:
    """Return the meshes for timings."""
    return {
        "Voronoi": samples.voronoi3d(6000, 7),
        "hexahedra": samples.boxes(30),
        "tetrahedra": samples.random_tetrahedra(6000, 7),
        "tetrahedra ": samples.random_tetrahedra(20_000, 7),
    }


def bisection(repeats: int) -> None:
    """Measure one split."""
    print("\none bisection, refinement included: ms (times faster than METIS), ncut")
    refiner, seeds = default().build("refiner", "interface"), np.zeros(1, np.uint64)
    for title, mesh in large_meshes().items():
        graph = mesh.graph.subgraph(curve_order(mesh.graph.centroids), [0, mesh.n_cells])
        base, sides = timed(raw_metis(graph, 2, True), repeats, time.perf_counter)
        print(f"{title:12}{graph.n:8,d}  METIS  {base * 1e3:8.2f}          {normalised(graph, sides):6.3f}")
        for name in ("kmeans", "sweep", "gnn"):
            tool = default().build("bisector", name)

            def split(tool: Any = tool, graph: Graph = graph) -> Labels:
                return refiner.refine(graph, frozen_int(tool.bisect_level(graph, seeds)), seeds, Target())

            seconds, sides = timed(split, repeats, time.perf_counter)
            times = f"({base / seconds:.1f}x)"
            print(f"{'':22}{name:7}{seconds * 1e3:8.2f} {times:8} {normalised(graph, sides):6.3f}")


def normalised(graph: Graph, sides: Labels) -> float:
    """Return area of the cut · ∛V (1/V₁ + 1/V₂), which is 4 for a halved cube."""
    volume = np.bincount(sides, graph.measures, minlength=2)
    return float(between(graph, sides) * np.cbrt(volume.sum()) * (1 / volume).sum())


def recursion(repeats: int) -> None:
    """Measure N/32 parts."""
    print("\nN/32 parts: CPU ms (over sweep), the same without polishing, times faster than METIS recursive")
    for title, mesh in large_meshes().items():
        graph, parts = mesh.graph, mesh.n_cells // 32
        metis, _ = timed(raw_metis(graph, parts, True), min(repeats, 5), time.process_time)
        bases: list[float] = []
        for name in ("sweep", "gnn", "kmeans"):
            calls = [partial(ours, graph, name, n_parts=parts, polish=polish) for polish in (True, False)]
            found = [timed(call, repeats, time.process_time)[0] for call in calls]
            bases = bases or found
            cells = "".join(
                f"{one * 1e3:9.2f} ({one / base:.2f})" for one, base in zip(found, bases, strict=True)
            )
            print(f"{title:12}{graph.n:8,d}  {name:7}{cells}  {metis / found[0]:.1f}x")


def quality(seeds: int) -> None:
    """Print the table of part quality."""
    for title, make in FAMILIES.items():
        meshes = [make(seed) for seed in range(5000, 5000 + seeds)]
        for goal in ("N/32", "3 h", "6 h"):
            print(f"\n{title}, {np.mean([mesh.n_cells for mesh in meshes]):.0f} cells, {goal}")
            heads = "".join(f"{name:>8}" for name in METRICS)
            print(f"{'':20}{'K':>8}{heads}{'area':>8}{'CPU s':>9}")
            found = {name: np.zeros(len(METRICS) + 3) for name in lines(meshes[0], goal, 1)}
            for mesh in meshes:
                parts = int(ours(mesh, "gnn", **target(mesh, goal)).max()) + 1
                for name, call in lines(mesh, goal, parts).items():
                    found[name] += np.array(measured(mesh, call)) / seeds
            base = found["sweep"][-2]
            for name, (count, *values, area, seconds) in found.items():
                cells = "".join(f"{value:8.3f}" for value in values)
                print(f"{name:20}{count:8.1f}{cells}{area / base:8.3f}{seconds:9.4f}")


def target(mesh: Mesh, goal: str) -> dict[str, Any]:
    """Return the target as keywords of ``agglomerate``."""
    return {"n_parts": mesh.n_cells // 32} if goal == "N/32" else {"h_factor": float(goal[0])}


def lines(mesh: Mesh, goal: str, parts: int) -> dict[str, Maker]:
    """Return the methods of all table lines."""
    options = target(mesh, goal)
    calls: dict[str, Maker] = {name: partial(ours, mesh, name, **options) for name in OURS}
    calls["K-MEANS recursive"] = partial(ours, mesh, "kmeans_sklearn", refiners=(), polish=False, **options)
    calls["METIS recursive"] = raw_metis(mesh.graph, parts, True)
    calls["METIS k-way"] = raw_metis(mesh.graph, parts, False)
    return calls


def measured(mesh: Mesh, call: Maker) -> list[float]:
    """Return the part count, metrics, area between parts, and CPU seconds."""
    seconds, labels = timed(call, 1, time.process_time)
    values = agglo.quality(mesh, labels, metrics=METRICS)
    means = [float(np.mean(values[name])) for name in METRICS]
    return [float(labels.max() + 1), *means, between(mesh.graph, labels), seconds]


def main() -> None:
    """Read the arguments and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("tables", nargs="*", help="bisection, recursion, quality; default all")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=15)
    options = parser.parse_args()
    tables = {
        "bisection": lambda: bisection(options.repeats),
        "recursion": lambda: recursion(options.repeats),
        "quality": lambda: quality(options.seeds),
    }
    for name in options.tables or tables:
        tables[name]()


if __name__ == "__main__":
    main()
