"""Compare partition speed, memory and quality with METIS, PyAMG, scikit-learn and coordinate bisection.

    python tests/benchmarks/partition.py [CELLS ...] [--meshes NAME ...] [--rivals NAME ...] [--repeats N]

Parts of 16 cells on average (32 in 3-D), one thread, process CPU seconds of a call that follows an equal one
without a clock, so that every method finds its code and memory in the caches. All methods start from the dual
graph. ``ratio`` is the median over the repeats of the CPU time divided by that of recursive
``pymetis`` in the same repeat. ``J`` is the mean k-means energy of the parts, 1 for a disk or ball.
``B/cell`` is the peak of Python and numpy allocations during a separate call. The row "h* 2, 4, 8" makes
three nested levels by size, and METIS makes as many parts as the finest level. The last line of each mesh
shows the growth of the default time with the number of cells.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import time
import tracemalloc
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any

import numpy as np
import pymetis
from numpy.typing import NDArray

import agglo_core as agglo
from agglo_core import Graph, Mesh, samples

Labels = NDArray[np.int64]
Method = Callable[[Graph, int], Labels]
DEFAULT, SIZES, REFERENCE = "agglo (default)", "agglo, h* 2, 4, 8", "METIS recursive"
MESHES: Mapping[str, Callable[[int], Mesh]] = {
    "triangles": lambda n: samples.random_triangles(n // 2, seed=0),
    "voronoi": lambda n: samples.voronoi(n, seed=0),
    "tetrahedra": lambda n: samples.tetrahedra(max(1, round((n / 6) ** (1 / 3)))),
}


def pipeline(**options: Any) -> Method:
    """Return a method that runs the agglo pipeline with these options."""

    def run(graph: Graph, parts: int) -> Labels:
        return agglo.agglomerate(graph, n_parts=parts, **options).levels[0]

    return run


def metis(recursive: bool) -> Method:
    """Return a method that calls METIS directly, without weights and repair."""

    def run(graph: Graph, parts: int) -> Labels:
        adjacency = pymetis.CSRAdjacency(graph.indptr, graph.indices)
        result = pymetis.part_graph(parts, adjacency, recursive=recursive)
        return np.unique(result.vertex_part, return_inverse=True)[1]

    return run


def lloyd(graph: Graph, parts: int) -> Labels:
    """Run Lloyd aggregation of PyAMG on the dual graph, with centroid distances as edge lengths."""
    from pyamg.aggregation import lloyd_aggregation
    from scipy import sparse

    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    apart = np.linalg.norm(graph.centroids[rows] - graph.centroids[graph.indices], axis=1)
    matrix = sparse.csr_matrix((apart, graph.indices, graph.indptr.astype(np.int32)), (graph.n, graph.n))
    aggregates = lloyd_aggregation(matrix, ratio=parts / graph.n, measure=None)[0]
    return np.unique(aggregates.indices, return_inverse=True)[1]


METHODS: Mapping[str, Method] = {
    DEFAULT: pipeline(),
    "agglo, polish=False": pipeline(polish=False),
    SIZES: lambda graph, parts: agglo.agglomerate(graph, h_factor=(2, 4, 8)).levels[0],
    REFERENCE: metis(recursive=True),
    "METIS k-way": metis(recursive=False),
    "PyAMG Lloyd": lloyd,
    "coordinate bisection": pipeline(bisector="coordinate", refiners=(), polish=False),
    "scikit-learn 2-means": pipeline(bisector="kmeans_sklearn", refiners=(), polish=False),
}
SLOW = {"PyAMG Lloyd": 100_000, "scikit-learn 2-means": 10_000}
"""Slow methods: maximum number of cells, in a single run without another before it."""


def cpu(call: Callable[[], Any]) -> tuple[float, Any]:
    """Return CPU seconds and result for a call."""
    start = time.process_time()
    result = call()
    return time.process_time() - start, result


def peak(call: Callable[[], Any]) -> int:
    """Return the peak of allocated bytes during a call."""
    tracemalloc.start()
    try:
        call()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def energy(graph: Graph, labels: Labels) -> float:
    """Return the mean moment of inertia of the parts, relative to a disk or ball of equal measure."""
    measures, d = np.bincount(labels, graph.measures), graph.dim
    centre = np.stack([np.bincount(labels, graph.measures * x) for x in graph.centroids.T], axis=1)
    squares = ((graph.centroids - (centre / measures[:, None])[labels]) ** 2).sum(axis=1)
    ball = {2: 1 / (2 * np.pi), 3: 0.6 * (0.75 / np.pi) ** (2 / 3)}[d]
    return float((np.bincount(labels, graph.measures * squares) / (ball * measures ** (1 + 2 / d))).mean())


def roundness(mesh: Mesh, labels: Labels) -> float:
    """Return the mean CR of at most 10,000 parts, or nan in 3-D."""
    if mesh.dim == 3:
        return float("nan")
    chosen = np.random.default_rng(0).permutation(int(labels.max()) + 1)[:10_000]
    number = np.full(int(labels.max()) + 1, -1)
    number[chosen] = np.arange(len(chosen))
    cells, loops = np.flatnonzero(number[labels] >= 0), mesh.boundary_loops
    alone = [loops.vertices[loops.loop_offsets[c] : loops.loop_offsets[c + 1]] for c in cells]
    piece = Mesh.from_polygons(mesh.points, alone)
    return float(agglo.quality(piece, number[labels[cells]], metrics=("CR",))["CR"].mean())


def connected(graph: Graph, labels: Labels) -> float:
    """Return the percentage of connected parts."""
    found = np.unique(np.stack((labels, graph.components(labels))), axis=1)[0]
    return 100.0 * float((np.bincount(found) == 1).mean())


def compare(name: str, cells: int, names: list[str], repeats: int) -> tuple[int, float]:
    """Print the table of methods for a mesh.

    Returns cells and CPU seconds of the default.
    """
    mesh = MESHES[name](cells)
    graph = mesh.graph
    _ = mesh.h  # for targets by size
    parts = round(graph.n / (16 if mesh.dim == 2 else 32))
    # Run all methods in each repeat; slow methods run once.
    names = [each for each in names if graph.n <= 1.1 * SLOW.get(each, graph.n)]
    times: dict[str, list[float]] = {each: [] for each in names}
    labels: dict[str, Labels] = {}
    finest: list[float] = []
    for _ in range(repeats):
        for each in names:
            if each not in SLOW or not times[each]:
                given = mesh if each == SIZES else graph
                if each not in SLOW:
                    METHODS[each](given, parts)  # type: ignore[arg-type]
                seconds, labels[each] = cpu(lambda each=each, given=given: METHODS[each](given, parts))
                times[each].append(seconds)
        if SIZES in names:
            finest.append(cpu(lambda: METHODS[REFERENCE](graph, int(labels[SIZES].max()) + 1))[0])
    # Ratios are taken repeat by repeat, memory in a separate call.
    print(f"\n{graph.n} {name} into {parts} parts; median of {repeats}, one thread")
    print(f"{'':24}{'CPU s':>9}{'ratio':>8}{'parts':>8}{'CR':>7}{'J':>7}{'connected %':>13}{'B/cell':>8}")
    for each in names:
        beside = finest if each == SIZES else times[REFERENCE]
        ratio = np.median([mine / theirs for mine, theirs in zip(times[each], beside, strict=False)])
        given = mesh if each == SIZES else graph
        memory = peak(lambda each=each, given=given: METHODS[each](given, parts)) if each not in SLOW else 0
        print(
            f"{each:24}{np.median(times[each]):9.3f}{ratio:8.3f}{labels[each].max() + 1:8d}"
            f"{roundness(mesh, labels[each]):7.3f}{energy(graph, labels[each]):7.3f}"
            f"{connected(graph, labels[each]):13.2f}{memory / graph.n:8.0f}"
        )
    return graph.n, float(min(times[DEFAULT]))


def main() -> None:
    """Read the arguments, warm up and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cells", nargs="*", type=int, default=[10_000, 100_000])
    parser.add_argument("--meshes", nargs="*", choices=sorted(MESHES), default=list(MESHES))
    parser.add_argument("--rivals", nargs="*", choices=sorted(METHODS), default=None)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    names = [
        each
        for each in METHODS
        if (each in {DEFAULT, REFERENCE} or options.rivals is None or each in options.rivals)
        and (each != "PyAMG Lloyd" or find_spec("pyamg"))
    ]
    for kind in options.meshes:
        small = MESHES[kind](500)
        for each in names:
            METHODS[each](small if each == SIZES else small.graph, 60)  # type: ignore[arg-type]
        found = [compare(kind, cells, names, options.repeats) for cells in sorted(options.cells)]
        if len(found) > 1:
            (n, first), (m, last) = found[0], found[-1]
            power = np.log(last / first) / np.log(m / n)
            print(f"from {n} to {m} {kind} the time of the default grows like N^{power:.2f}")


if __name__ == "__main__":
    main()
