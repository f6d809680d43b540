"""Compare the learned bisector with METIS, 2-means and sweeps.

    python tests/benchmarks/gnn.py [TABLE ...] [--seeds N] [--repeats N]

One thread, one process. ``bisection``: one split of a graph whose cells are ordered along a Morton curve,
including refinement (except for the paper's network), next to ``pymetis.part_graph(2)``; median wall
time of the repeats. ``ncut`` is cut length · √A (1/A₁ + 1/A₂), 4 for a halved square; ``degree`` is the
paper's normalised cut, which counts edges.
``recursion``: down to parts of about 10 cells, CPU seconds, METIS with the same part count.
``quality``: UF / CR / part count, mean over seeds and four values of h*. ``lookahead``: the same values
for ``gnn`` with candidates tried. ``sizes``: which method needs the fewest parts of a given size, in 2-D and
3-D: part count and CPU time over those of merged ``kmeans``, paired by mesh and size. ``±`` is the standard
error over the meshes.
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
from agglo_core.graph.functionals import normalised_cut
from agglo_core.graph.ordering import curve_order
from agglo_core.registry import default

Labels = NDArray[np.int64]
NAMES = ("kmeans", "sweep", "gnn")
OCTAVE = (0.71, 0.84, 1.0, 1.19)


def timed(call: Callable[[], Any], repeats: int, clock: Callable[[], float]) -> tuple[float, Any]:
    """Return the median seconds of a call, and its last result."""
    seconds = []
    for _ in range(repeats):
        start = clock()
        result = call()
        seconds.append(clock() - start)
    return float(np.median(seconds)), result


def length_cut(graph: Graph, sides: Labels) -> float:
    """Return cut length · √A (1/A₁ + 1/A₂)."""
    area = np.bincount(sides, graph.measures, minlength=2)
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    length = 0.5 * graph.interface[sides[rows] != sides[graph.indices]].sum()
    return float(length * np.sqrt(area.sum()) * (1 / area).sum())


def bisection(repeats: int) -> None:
    """Measure one split of 1k to 100k cells."""
    print("\none bisection, refinement included: milliseconds (ratio to METIS), ncut, degree ncut")
    refiner = default().build("refiner", "interface")
    seeds = np.zeros(1, np.uint64)
    for n in (1000, 5000, 20_000, 100_000):
        mesh = samples.voronoi(n, 7) if n <= 5000 else samples.random_triangles(n // 2, 7)
        graph = mesh.graph.subgraph(curve_order(mesh.graph.centroids), [0, mesh.n_cells])
        adjacency = pymetis.CSRAdjacency(graph.indptr, graph.indices)

        def metis(adjacency: Any = adjacency) -> Labels:
            return np.array(pymetis.part_graph(2, adjacency).vertex_part)

        # METIS as reference.
        base, sides = timed(metis, repeats, time.perf_counter)
        print(f"{graph.n:7d} METIS  {base * 1e3:7.3f}        {row(graph, sides)}")
        # Own bisectors with refinement.
        for name in NAMES:
            tool = default().build("bisector", name)

            def ours(tool: Any = tool, graph: Graph = graph) -> Labels:
                return refiner.refine(graph, frozen_int(tool.bisect_level(graph, seeds)), seeds, Target())

            ours()
            seconds, sides = timed(ours, repeats, time.perf_counter)
            ratio = f"({base / seconds:.1f}x)"
            print(f"        {name:6} {seconds * 1e3:7.3f} {ratio:7}{row(graph, sides)}")
        for precision in ("single", "double"):  # torch network for the paper: only frame and forward pass
            paper = default().build("bisector", "gnn_paper", precision=precision)
            paper.bisect_level(graph, seeds)
            call = partial(paper.bisect_level, graph, seeds)
            seconds, sides = timed(call, min(repeats, 5), time.perf_counter)
            ratio, sides = f"({base / seconds:.2f}x)", frozen_int(np.asarray(sides) >= 0.5)
            print(f"        paper {seconds * 1e3:8.3f} {ratio:7}{row(graph, sides)} {precision}")


def row(graph: Graph, sides: Labels) -> str:
    """Format both normalised cuts."""
    return f"{length_cut(graph, sides):6.2f} {normalised_cut(graph, sides):8.4f}"


def recursion(repeats: int) -> None:
    """Measure whole hierarchies, one size per mesh."""
    print("\nrecursion to h*: CPU seconds, UF / CR, parts; METIS at the number of parts of gnn")
    for name, mesh, h_star in (
        ("Voronoi 5k", samples.voronoi(5000, 11), 0.085),
        ("20k triangles", samples.random_triangles(10_000, 11), 0.042),
        ("100k triangles", samples.random_triangles(50_000, 11), 0.019),
    ):
        graph, parts = mesh.graph, 0
        # Own bisectors down to h*.
        for bisector in NAMES:

            def ours(bisector: str = bisector, graph: Graph = graph, h_star: float = h_star) -> Labels:
                return agglo.agglomerate(graph, bisector=bisector, h_star=h_star).levels[0]

            ours()
            seconds, labels = timed(ours, repeats, time.process_time)
            parts = int(labels.max()) + 1
            print(f"{name:15}{bisector:16} {seconds:8.4f}  {shape(mesh, labels)}")
        # METIS with the part count of gnn.
        adjacency = pymetis.CSRAdjacency(graph.indptr, graph.indices)
        for title, recursive in (("METIS recursive", True), ("METIS k-way", False)):

            def metis(recursive: bool = recursive, parts: int = parts, adjacency: Any = adjacency) -> Labels:
                found = pymetis.part_graph(parts, adjacency, recursive=recursive).vertex_part
                return np.unique(found, return_inverse=True)[1]

            base, labels = timed(metis, min(repeats, 3), time.process_time)
            print(f"{name:15}{title:16} {base:8.4f}  {shape(mesh, labels)}  gnn {base / seconds:.2f}x faster")


def shape(mesh: Mesh, labels: Labels) -> str:
    """Format mean UF, mean CR and the part count."""
    found = agglo.quality(mesh, labels, metrics=("UF", "CR"))
    return f"{found['UF'].mean():.3f}/{found['CR'].mean():.3f}/{labels.max() + 1}"


def families(seeds: int) -> list[tuple[str, list[tuple[Mesh, dict[str, float]]]]]:
    """Return meshes and targets for each table row."""
    small = np.sqrt(2) / 4
    fresh = range(5000, 5000 + seeds)
    tables = {
        "Delaunay 286": ([samples.random_triangles(128, s) for s in fresh], small),
        "Voronoi 256": ([samples.voronoi(256, s) for s in fresh], small),
        "Delaunay 4k, 16-24 cells": ([samples.random_triangles(2000, s) for s in fresh], 0.14),
        "Voronoi 4k, 16-24 cells": ([samples.voronoi(4000, s) for s in fresh], 0.14),
        "Delaunay 4k, 60-100 cells": ([samples.random_triangles(2000, s) for s in fresh], 0.28),
        "Voronoi 4k, 60-100 cells": ([samples.voronoi(4000, s) for s in fresh], 0.28),
        "Delaunay 4k, 300 cells": ([samples.random_triangles(2000, s) for s in fresh], 0.56),
        "Voronoi 4k, 300 cells": ([samples.voronoi(4000, s) for s in fresh], 0.56),
    }
    rows = [
        (name, [(mesh, {"h_star": h * f}) for mesh in meshes for f in OCTAVE])
        for name, (meshes, h) in tables.items()
    ]
    rows += [(f"squares {n}", [(samples.squares(n), {"h_star": small})]) for n in (16, 20, 24)]
    rows += [("triangles 128", [(samples.paper("triangles"), {"h_star": small})])]
    brain = samples.brain()
    width = float(brain.graph.diameters()[0])
    rows += [("brain, 0.2 D", [(brain, {"h_star": width * 0.2 * f}) for f in OCTAVE])]
    rows += [("brain, 16-24 cells", [(brain, {"h_star": width * 0.055 * f}) for f in (0.9, 1.0, 1.1)])]
    return rows


def averages(cases: list[tuple[Mesh, dict[str, float]]], bisector: Any) -> tuple[float, float, float, float]:
    """Return mean UF, CR, part count, and cells per part over all cases."""
    found = []
    for mesh, target in cases:
        choice = ("gnn", {"lookahead": bisector}) if isinstance(bisector, int) else bisector
        labels = agglo.agglomerate(mesh, bisector=choice, **target).levels[0]
        values = agglo.quality(mesh, labels, metrics=("UF", "CR"))
        parts = float(labels.max() + 1)
        found.append((values["UF"].mean(), values["CR"].mean(), parts, mesh.n_cells / parts))
    uf, cr, parts, cells = np.mean(found, axis=0)
    return float(uf), float(cr), float(parts), float(cells)


def quality(seeds: int) -> None:
    """Print the table of UF / CR / parts."""
    print(
        f"\nUF/CR/parts, {seeds} seeds\n{'':28}" + "".join(f"{name:24}" for name in NAMES) + "cells per part"
    )
    for title, cases in families(seeds):
        found = [averages(cases, name) for name in NAMES]
        cells = "".join(f"{uf:.3f}/{cr:.3f}/{parts:<11.1f}" for uf, cr, parts, _ in found)
        print(f"{title:28}{cells}{found[-1][3]:8.1f}")


def lookahead(seeds: int) -> None:
    """Print the results of gnn with 0, 5 and 20 candidates at h* = √2/4."""
    print(f"\nlookahead, UF/CR/parts, {seeds} seeds")
    target = {"h_star": float(np.sqrt(2) / 4)}
    fresh = range(5000, 5000 + seeds)
    for title, make, n in (
        ("Delaunay 286", samples.random_triangles, 128),
        ("Voronoi 256", samples.voronoi, 256),
    ):
        cases = [(make(n, seed), target) for seed in fresh]
        for count in (0, 5, 20):
            choice: Any = count or "gnn"
            averages(cases[:1], choice)
            start = time.process_time()
            uf, cr, parts, _ = averages(cases, choice)
            each = (time.process_time() - start) / len(cases)
            print(f"{title:14}{count:3d}  {uf:.3f}/{cr:.3f}/{parts:.1f}  {each:.3f} s a mesh")


BY_SIZE: dict[str, dict[str, Any]] = {
    "kmeans, merged": {"merge": True},
    "kmeans": {},
    "sweep, merged": {"bisector": "sweep", "merge": True},
    "gnn, merged": {"bisector": "gnn", "merge": True},
    "gnn lookahead=5, merged": {"bisector": ("gnn", {"lookahead": 5}), "merge": True},
    "k-way, merged": {"method": "kway", "merge": True},
    "quick, merged": {"method": "kway", "bisector": ("kmeans", {"effort": "quick"}), "merge": True},
    "fast, merged": {"method": "kway", "bisector": ("kmeans", {"effort": "fast"}), "merge": True},
}


def star(seed: int) -> Mesh:
    """Return the Voronoi cells within a star with smooth random outline."""
    mesh = samples.voronoi(8000, seed)
    x, y = (mesh.cell_centroids - 0.5).T
    angle, phases = np.arctan2(y, x), np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 3)
    waves = zip((0.10, 0.07, 0.05), (2, 3, 5), phases, strict=True)
    radius = 0.3 + sum(size * np.cos(count * angle + phase) for size, count, phase in waves)
    inside = np.flatnonzero(np.hypot(x, y) < radius)
    return Mesh.from_polygons(mesh.points, [mesh.cells[int(i)] for i in inside])


def agglomerates(seed: int) -> Mesh:
    """Return polyhedra of about 6 tetrahedra each."""
    return agglo.agglomerate(samples.random_tetrahedra(2600, seed), cells_per_part=6).mesh(0)


SIZED: dict[str, tuple[Callable[[int], Mesh], float]] = {
    "Voronoi": (lambda seed: samples.voronoi(4000, seed), 0.2),
    "Voronoi, small parts": (lambda seed: samples.voronoi(4000, seed), 0.08),
    "triangles": (lambda seed: samples.random_triangles(2000, seed), 0.2),
    "stars": (star, 0.2),
    "brain": (lambda seed: samples.brain(), 18.0),
    "tetrahedra": (lambda seed: samples.random_tetrahedra(700, seed), 0.4),
    "Voronoi 3-D": (lambda seed: samples.voronoi3d(2500, seed), 0.4),
    "hexahedra": (lambda seed: samples.boxes(10 + seed % 12), 0.4),
    "agglomerates": (agglomerates, 0.48),
}
"""Meshes by seed, and the middle of four sizes h* over an octave."""


def sizes(seeds: int) -> None:
    """Print part counts and times over those of merged k-means, for each family and method."""
    for title, (make, size) in SIZED.items():
        meshes = [make(seed) for seed in range(9700, 9700 + (1 if title == "brain" else seeds))]
        names = [name for name in BY_SIZE if meshes[0].dim == 2 or "lookahead" not in name]
        for name in names:
            by_size(meshes[0], 2.0 * size, name)  # compiles
        found = np.array(
            [[[by_size(mesh, f * size, name) for name in names] for f in OCTAVE] for mesh in meshes]
        )
        cells = meshes[0].n_cells / found[0, :, 0, 0].mean()
        print(
            f"\n{title}, {len(meshes)} meshes, {cells:.0f} cells per part\n{'':24}parts            time    UF"
        )
        parts, seconds = (found[..., k] / found[..., :1, k] for k in (0, 1))
        for k, name in enumerate(names):
            means = parts[..., k].mean(axis=1)
            error = f"± {means.std(ddof=1) / np.sqrt(len(means)):.3f}" if len(means) > 1 else " " * 7
            time_ratio, uf = np.median(seconds[..., k]), found[..., k, 2].mean()
            print(f"{name:24}{means.mean():.3f} {error} {time_ratio:7.2f} {uf:7.3f}", flush=True)


def by_size(mesh: Mesh, size: float, name: str) -> tuple[float, float, float]:
    """Return part count, CPU seconds and mean UF of one level."""
    start = time.process_time()
    labels = agglo.agglomerate(mesh, h_star=size, **BY_SIZE[name]).levels[0]
    seconds = time.process_time() - start
    uf = mesh.graph.part_diameters(frozen_int(labels)).mean() / size
    return float(labels.max() + 1), seconds, float(uf)


def main() -> None:
    """Read the arguments and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "tables", nargs="*", help="bisection, recursion, quality, lookahead, sizes; default all"
    )
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--repeats", type=int, default=25)
    options = parser.parse_args()
    tables = {
        "bisection": lambda: bisection(options.repeats),
        "recursion": lambda: recursion(min(options.repeats, 7)),
        "quality": lambda: quality(options.seeds),
        "lookahead": lambda: lookahead(2 * options.seeds),
        "sizes": lambda: sizes(options.seeds),
    }
    for name in options.tables or tables:
        tables[name]()


if __name__ == "__main__":
    main()
