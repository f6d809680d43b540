"""Measure roundness, balance and cost of parts: recursions, k-way partitions, annealing, METIS.

    python tests/benchmarks/roundness.py [--seeds N] [--large] [--only NAME ...]

Means over random meshes: part count K, UF, CR, CRc, mean and largest diameter over the size h*, CPU seconds.
The size is √2/4 on meshes of about 256 cells, 0.2 of the diameter on the brain, and otherwise the diagonal
of a square with 16 mean cells. Counts are exact: 25, 40 for the brain, or a part per 16 cells. METIS only
supports counts: for a size it uses the part count of ``good``, and its parts may be wider. ``--large`` adds
100,000 cells.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import agglo_core as agglo
from agglo_core import Mesh, samples
from agglo_core.errors import AggloError

Labels = NDArray[np.int64]
SMALL = 2**0.5 / 4
METHODS: dict[str, dict[str, Any]] = {
    "recursive": {"bisector": "kmeans"},
    "k-way": {"bisector": "kmeans", "method": "kway"},
    "fast": {"bisector": ("kmeans", {"effort": "fast", "objective": "roundness"}), "method": "kway"},
    "good": {"bisector": ("kmeans", {"effort": "good", "objective": "roundness"}), "method": "kway"},
    "best": {"bisector": ("kmeans", {"effort": "best", "objective": "roundness"}), "method": "kway"},
    "METIS": {"bisector": "metis", "method": "kway", "polish": False},
}


class Task(NamedTuple):
    """Mesh by seed, target size or part count, and number of meshes."""

    mesh: Callable[[int], Mesh]
    size: Callable[[Mesh], float] | None = None
    parts: Callable[[Mesh], int] | None = None
    seeds: int = 100


def of_sixteen(mesh: Mesh) -> float:
    """Return the diagonal of a square with 16 mean cells."""
    return float(np.sqrt(32.0 * mesh.graph.measures.sum() / mesh.n_cells))


def fifth(mesh: Mesh) -> float:
    """Return a fifth of the domain diameter."""
    return 0.2 * float(mesh.graph.part_diameters(np.zeros(mesh.n_cells, np.int64))[0])


def sixteenth(mesh: Mesh) -> int:
    """Return the part count with 16 cells on average."""
    return round(mesh.n_cells / 16)


def small_triangles(seed: int) -> Mesh:
    """Return 286 triangles."""
    return samples.random_triangles(128, seed=seed)


TASKS = {
    "random triangles": Task(small_triangles, lambda _: SMALL),
    "Voronoi": Task(lambda seed: samples.voronoi(256, seed=seed), lambda _: SMALL),
    "paper's squares": Task(lambda _: samples.paper("squares"), lambda _: SMALL, seeds=1),
    "paper's triangles": Task(lambda _: samples.paper("triangles"), lambda _: SMALL, seeds=1),
    "4k triangles": Task(lambda seed: samples.random_triangles(2000, seed=seed), of_sixteen, seeds=3),
    "4k Voronoi": Task(lambda seed: samples.voronoi(4000, seed=seed), of_sixteen, seeds=3),
    "brain": Task(lambda _: samples.brain(), fifth, seeds=3),
    "brain, K = 40": Task(lambda _: samples.brain(), parts=lambda _: 40, seeds=3),
    "random triangles, K = 25": Task(small_triangles, parts=lambda _: 25),
    "Voronoi, K = 25": Task(lambda seed: samples.voronoi(256, seed=seed), parts=lambda _: 25),
    "4k triangles, N / 16": Task(
        lambda seed: samples.random_triangles(2000, seed=seed), parts=sixteenth, seeds=3
    ),
    "4k Voronoi, N / 16": Task(lambda seed: samples.voronoi(4000, seed=seed), parts=sixteenth, seeds=3),
}
LARGE = Task(lambda seed: samples.random_triangles(50_000, seed=seed), of_sixteen, seeds=1)


def figures(mesh: Mesh, labels: Labels, size: float) -> list[float]:
    """Return K, mean UF, CR and CRc, mean and largest diameter over the size."""
    values = agglo.quality(mesh, labels, metrics=("UF", "CR", "CRc"))
    widths = mesh.graph.part_diameters(labels) / size
    means = [float(each.mean()) for each in values.values()]
    return [float(len(widths)), *means, float(widths.mean()), float(widths.max())]


def rows_of(task: Task, seed: int, methods: list[str]) -> Iterator[tuple[str, list[float]]]:
    """Yield name and figures of each method on a mesh."""
    mesh, parts = task.mesh(seed), None
    assert mesh.graph.n
    for name in methods:
        size = task.size(mesh) if task.size else np.sqrt(2.0 * mesh.graph.measures.sum() / task.parts(mesh))
        target = {"n_parts": task.parts(mesh)} if task.parts else {"h_star": size}
        if name == "METIS" and task.size:
            if parts is None:
                continue
            target = {"n_parts": parts}
        start = time.process_time()
        try:
            labels = agglo.agglomerate(mesh, seed=seed, **METHODS[name], **target).levels[0]
        except AggloError as error:  # METIS is optional
            print(f"{name}: {error}")
            continue
        seconds = time.process_time() - start
        parts = int(labels.max()) + 1 if name == "good" else parts
        yield name, [*figures(mesh, labels, size), seconds]


def print_table(title: str, task: Task, seeds: list[int], methods: list[str]) -> None:
    """Print a table of means, with a line per method."""
    found: dict[str, list[list[float]]] = {}
    for seed in seeds[: task.seeds]:
        for name, row in rows_of(task, seed, methods):
            found.setdefault(name, []).append(row)
    print(f"\n{title}, {len(seeds[: task.seeds])} meshes or seeds")
    heads = ("K", "UF", "CR", "CRc", "d/h*", "max", "CPU s")
    print(f"{'':>10}{''.join(f'{head:>9}' for head in heads)}")
    for name, rows in found.items():
        k, *rest = np.mean(rows, axis=0)
        print(f"{name:>10}{k:9.1f}{''.join(f'{value:9.3f}' for value in rest)}", flush=True)


def main() -> None:
    """Print a table per task."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--large", action="store_true")
    parser.add_argument("--only", nargs="*", default=[], help="parts of the names of tasks")
    parser.add_argument("--methods", nargs="*", default=list(METHODS), choices=list(METHODS))
    options = parser.parse_args()
    for name in options.methods:  # compiles
        list(rows_of(Task(lambda seed: samples.voronoi(200, seed=seed), lambda _: 0.4), 0, [name]))
        list(rows_of(Task(lambda seed: samples.voronoi(200, seed=seed), parts=lambda _: 9), 0, [name]))
    fresh = int(np.random.SeedSequence().generate_state(1)[0]) % 10**6
    seeds = [fresh + place for place in range(options.seeds)]
    tasks = TASKS | ({"100k triangles": LARGE} if options.large else {})
    for title, task in tasks.items():
        if not options.only or any(each in title for each in options.only):
            print_table(title, task, seeds, options.methods)


if __name__ == "__main__":
    main()
