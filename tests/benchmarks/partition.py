"""Partition speed and quality beside METIS, scikit-learn and coordinate bisection.

    python tests/benchmarks/partition.py [CELLS ...] [--build CELLS] [--sklearn-cells N] [--repeats N]

Random Delaunay triangles, parts of 16 cells on average, one thread, CPU seconds of this process after a
warm-up. Everybody starts from the dual graph. ``ratio`` is the median over the repeats of the CPU time
divided by that of ``pymetis`` recursive in the same repeat. The last table builds Mesh and Graph from
bare arrays, by default of a million triangles.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pymetis
from numpy.typing import NDArray

import agglo_core as agglo
from agglo_core import Graph, Mesh, samples

Labels = NDArray[np.int64]
Method = Callable[[Graph, int], Labels]
REFERENCE = "METIS recursive"
CELLS_PER_PART = 16


def pipeline(**options: Any) -> Method:
    """A method that runs agglo's pipeline with these options."""

    def run(graph: Graph, parts: int) -> Labels:
        return agglo.agglomerate(graph, n_parts=parts, **options).levels[0]

    return run


def metis(recursive: bool) -> Method:
    """A method that calls METIS itself: no weights, no repair."""

    def run(graph: Graph, parts: int) -> Labels:
        adjacency = pymetis.CSRAdjacency(graph.indptr, graph.indices)
        result = pymetis.part_graph(parts, adjacency, recursive=recursive)
        return np.unique(result.vertex_part, return_inverse=True)[1]

    return run


METHODS: Mapping[str, Method] = {
    "agglo kmeans (default)": pipeline(),
    REFERENCE: metis(recursive=True),
    "METIS k-way": metis(recursive=False),
    "coordinate bisection": pipeline(bisector="coordinate", refiners=()),
    "scikit-learn 2-means": pipeline(bisector="kmeans_sklearn", refiners=()),
}


def cpu(call: Callable[[], Any]) -> tuple[float, Any]:
    """CPU seconds of a call, and its result."""
    start = time.process_time()
    result = call()
    return time.process_time() - start, result


def quality(mesh: Mesh, labels: Labels) -> tuple[float, float, float]:
    """Mean CR (of 300 parts), per cent of connected parts, mean UF."""
    k = int(labels.max()) + 1
    chosen = np.random.default_rng(0).permutation(k)[:300]
    ratios = agglo.quality(*parts_alone(mesh, labels, chosen), metrics=("CR",))["CR"]
    found = np.unique(np.stack((labels, mesh.graph.components(labels))), axis=1)[0]
    diameters = mesh.graph.part_diameters(labels)
    whole = 100.0 * (np.bincount(found, minlength=k) == 1).mean()
    return float(ratios.mean()), float(whole), float(diameters.mean() / diameters.max())


def parts_alone(mesh: Mesh, labels: Labels, chosen: Labels) -> tuple[Mesh, Labels]:
    """Mesh of the cells of the chosen parts, and their labels 0, 1, …"""
    number = np.full(int(labels.max()) + 1, -1)
    number[chosen] = np.arange(len(chosen))
    cells = np.flatnonzero(number[labels] >= 0)
    loops = mesh.boundary_loops.vertices.reshape(-1, 3)[cells]
    return Mesh.from_polygons(mesh.points, loops), number[labels[cells]]


def compare(cells: int, repeats: int, sklearn_cells: int) -> None:
    """Print the table of all methods on about ``cells`` random triangles."""
    mesh = samples.random_triangles(cells // 2, seed=0)
    graph = mesh.graph
    parts = round(graph.n / CELLS_PER_PART)
    names = [name for name in METHODS if "scikit" not in name or graph.n <= sklearn_cells * 1.1]
    times: dict[str, list[float]] = {name: [] for name in names}
    labels: dict[str, Labels] = {}
    for _ in range(repeats):
        for name in names:
            if name == "scikit-learn 2-means" and times[name]:
                continue  # it takes its time; once is enough
            seconds, labels[name] = cpu(lambda name=name: METHODS[name](graph, parts))
            times[name].append(seconds)
    print(f"\n{graph.n} random triangles into {parts} parts; median of {repeats}, one thread")
    print(f"{'':24}{'CPU s':>9}{'ratio':>8}{'parts':>8}{'CR':>8}{'connected %':>13}{'UF':>8}")
    for name in names:
        ratio = np.median(
            [mine / theirs for mine, theirs in zip(times[name], times[REFERENCE], strict=False)]
        )
        roundness, whole, uniformity = quality(mesh, labels[name])
        print(
            f"{name:24}{np.median(times[name]):9.3f}{ratio:8.3f}{labels[name].max() + 1:8d}"
            f"{roundness:8.4f}{whole:13.2f}{uniformity:8.4f}"
        )


def build(cells: int, repeats: int) -> None:
    """Print the table from bare arrays to Mesh and Graph, beside one call of METIS."""
    sample = samples.random_triangles(cells // 2, seed=1)
    points, loops = sample.points, sample.boundary_loops.vertices.reshape(-1, 3)
    parts = round(sample.n_cells / CELLS_PER_PART)
    rows: dict[str, list[float]] = {"arrays to Mesh": [], "Mesh to Graph": [], "default pipeline": []}
    for _ in range(repeats):
        seconds, mesh = cpu(lambda: Mesh.from_polygons(points, loops))
        rows["arrays to Mesh"].append(seconds)
        seconds, graph = cpu(lambda mesh=mesh: mesh.graph)
        rows["Mesh to Graph"].append(seconds)
        seconds, _ = cpu(lambda graph=graph: METHODS["agglo kmeans (default)"](graph, parts))
        rows["default pipeline"].append(seconds)
    reference, _ = cpu(lambda: METHODS[REFERENCE](sample.graph, parts))
    print(f"\n{sample.n_cells} random triangles from arrays; {parts} parts; median of {repeats}, one thread")
    print(f"{'':24}{'CPU s':>9}{'ratio':>8}")
    medians = {name: float(np.median(values)) for name, values in rows.items()}
    medians["arrays to Graph"] = medians["arrays to Mesh"] + medians["Mesh to Graph"]
    for name, seconds in [*medians.items(), (REFERENCE, reference)]:
        print(f"{name:24}{seconds:9.3f}{seconds / reference:8.3f}")


def main() -> None:
    """Read the arguments, warm up, print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cells", nargs="*", type=int, default=[10_000, 100_000])
    parser.add_argument("--build", type=int, default=1_000_000, help="triangles of the last table")
    parser.add_argument("--sklearn-cells", type=int, default=10_000, help="scikit-learn up to this size")
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    small = samples.random_triangles(500)
    for method in METHODS.values():
        method(small.graph, 60)
    quality(small, METHODS[REFERENCE](small.graph, 60))
    for cells in options.cells:
        compare(cells, options.repeats, options.sklearn_cells)
    build(options.build, max(1, options.repeats // 2))


if __name__ == "__main__":
    main()
