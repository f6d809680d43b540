"""Measure agglomeration and metrics on meshes of unusual shape, relative to plain meshes of equal size.

    python tests/benchmarks/pathologies.py [--repeats N] [--tetrahedra CELLS]

Process CPU seconds per cell (for a single cell: per edge), minimum over the repeats after a warm-up.
``ratio`` is relative to a plain mesh with about as many cells (squares, or the same Voronoi cells
unstretched) in the same run. Agglomeration makes N/16 parts with default components; quality uses the
default metrics. The last table compares bisectors on tetrahedra with recursive METIS.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pymetis

import agglo_core as agglo
from agglo_core import Mesh, samples
from agglo_core.agglomeration.levels.polishing import merge_parts
from agglo_core.arrays import Float

CELLS_PER_PART = 16
Work = Callable[[Mesh], Any]


def outline(radius: float, n: int) -> Float:
    """Return ``n`` points on a circle."""
    angle = 2 * np.pi * np.arange(n) / n
    return radius * np.stack((np.cos(angle), np.sin(angle)), axis=1)


def hub(n: int) -> Mesh:
    """Return a round cell surrounded by ``n`` neighbours."""
    i, j = np.arange(n), np.roll(np.arange(n), -1)
    ring = np.stack((i, n + i, n + j, j), axis=1)
    loops = np.concatenate((i, ring.ravel()))
    offsets = np.concatenate(([0], n + 4 * np.arange(n + 1)))
    return Mesh.from_polygons(np.concatenate((outline(1.0, n), outline(1.1, n))), (offsets, loops))


def ragged_cell(n: int) -> Mesh:
    """Return a nearly round cell with ``n`` edges."""
    noise = np.random.default_rng(0).standard_normal((n, 1))
    return Mesh.from_polygons(outline(1.0, n) * (1 + 1e-3 * noise), [range(n)])


def crescent(n: int) -> Mesh:
    """Return a thin curved cell with ``n`` edges."""
    half = np.pi * np.linspace(0, 1, n // 2)
    arc = np.stack((np.cos(half), np.sin(half)), axis=1)
    return Mesh.from_polygons(np.concatenate((arc, 0.95 * arc[::-1])), [range(2 * (n // 2))])


def stretched(mesh: Mesh, aspect: float) -> Mesh:
    """Return the mesh stretched by ``aspect`` along x."""
    loops = mesh.boundary_loops
    return Mesh.from_polygons(mesh.points * [aspect, 1.0], (loops.loop_offsets, loops.vertices))


def polyomino(places: Float) -> Mesh:
    """Return unit squares with lower left corners ``places (n, 2)``."""
    corners = (places[:, None] + np.array([(0, 0), (1, 0), (1, 1), (0, 1)])).reshape(-1, 2)
    points, loops = np.unique(corners, axis=0, return_inverse=True)
    return Mesh.from_polygons(points.astype(float), loops.reshape(-1, 4))


def comb(teeth: int, length: int) -> Mesh:
    """Return a spine of squares with a tooth of ``length`` squares at every other square."""
    spine = np.stack((np.arange(2 * teeth), np.zeros(2 * teeth)), axis=1)
    tooth = np.stack((np.repeat(2 * np.arange(teeth), length), np.tile(1 + np.arange(length), teeth)), axis=1)
    return polyomino(np.concatenate((spine, tooth)))


def chain(n: int) -> Mesh:
    """Return a strip of ``n`` rectangles with slowly decreasing widths."""
    x = np.concatenate(([0.0], np.cumsum(np.linspace(1.1, 1.0, n))))
    points = np.concatenate((np.stack((x, 0 * x), axis=1), np.stack((x, 0 * x + 1), axis=1)))
    i = np.arange(n)
    return Mesh.from_polygons(points, np.stack((i, i + 1, n + 2 + i, n + 1 + i), axis=1))


def plain(n: int) -> Mesh:
    """Return a square grid of about ``n`` cells."""
    return samples.squares(max(2, round(n**0.5)))


# -- timed functions --------------------------------------------------------------------------------
def agglomerate(mesh: Mesh) -> Any:
    """Agglomerate with default components."""
    return agglo.agglomerate(mesh, n_parts=max(2, mesh.n_cells // CELLS_PER_PART)).levels[0]


def refined(mesh: Mesh) -> Any:
    """Polish parts of METIS k-way by ``interface``."""
    parts = max(2, mesh.n_cells // CELLS_PER_PART)
    options = {"method": "kway", "bisector": "metis", "post_refiners": ("interface",)}
    return agglo.agglomerate(mesh, n_parts=parts, **options).levels[0]


def quality(mesh: Mesh) -> Any:
    """Evaluate the default metrics of agglomerates."""
    return agglo.quality(mesh, agglomerate(mesh))


def cells(mesh: Mesh) -> Any:
    """Evaluate the default metrics of the cells."""
    return agglo.quality(mesh, np.arange(mesh.n_cells))


def size(mesh: Mesh) -> Any:
    """Compute the mesh size."""
    return mesh.h


def merge(mesh: Mesh) -> Any:
    """Merge single cells in pairs."""
    graph = mesh.graph
    limit = 2.5 * float(np.sqrt(graph.measures.mean()))
    return merge_parts(graph, np.zeros(graph.n, np.int64), np.arange(graph.n), limit, lambda done, text: None)


def voronoi(n: int) -> Mesh:
    """Return random Voronoi cells."""
    return samples.voronoi(n, seed=0)


# name, mesh, plain mesh with a given number of cells, timed function, True to count edges
ROWS: list[tuple[str, Callable[[], Mesh], Callable[[int], Mesh], Work, bool]] = [
    ("hub, 40,000 neighbours: agglomerate, quality", lambda: hub(40_000), plain, quality, False),
    ("hub, 40,000 neighbours: METIS k-way, interface", lambda: hub(40_000), plain, refined, False),
    ("hub, 40,000 neighbours: h", lambda: hub(40_000), plain, size, False),
    ("ragged round cell, 4,000 edges: quality", lambda: ragged_cell(4000), plain, cells, True),
    ("crescent, 4,000 edges: quality", lambda: crescent(4000), plain, cells, True),
    ("squares x 1000: quality of cells", lambda: stretched(plain(5000), 1000.0), plain, cells, False),
    ("Voronoi x 1000: quality of cells", lambda: stretched(voronoi(5000), 1000.0), voronoi, cells, False),
    ("Voronoi x 1000: agglomerate, quality", lambda: stretched(voronoi(5000), 1e3), voronoi, quality, False),
    ("comb, 400 teeth of 20: agglomerate, quality", lambda: comb(400, 20), plain, quality, False),
    ("comb, 400 teeth of 100: agglomerate, quality", lambda: comb(400, 100), plain, quality, False),
    ("chain of 4,000 cells: merge", lambda: chain(4000), plain, merge, False),
]  # fmt: skip


def fresh(mesh: Mesh) -> Mesh:
    """Return a copy of the mesh that has only its graph computed."""
    copy = Mesh(mesh.points, mesh.face_offsets, mesh.face_vertices, mesh.face_cells)
    _ = copy.graph
    return copy


def seconds(mesh: Mesh, work: Work, repeats: int) -> float:
    """Return the minimum CPU seconds of ``work`` on fresh copies."""
    times = []
    for _ in range(repeats):
        copy = fresh(mesh)
        start = time.process_time()
        work(copy)
        times.append(time.process_time() - start)
    return min(times)


def table(repeats: int) -> None:
    """Print a line per pathology."""
    print(f"{'':50}{'cells':>8}{'CPU s':>9}{'plain':>9}{'ratio':>8}")
    for name, make, usual, work, by_edge in ROWS:
        work(usual(100))
        mesh = make()
        units = len(mesh.cell_faces[1]) if by_edge else mesh.n_cells
        other = usual(units // 4 if by_edge else units)
        others = len(other.cell_faces[1]) if by_edge else other.n_cells
        mine, theirs = seconds(mesh, work, repeats), seconds(other, work, repeats)
        ratio = (mine / units) / (theirs / others)
        print(f"{name:50}{mesh.n_cells:8d}{mine:9.4f}{theirs:9.4f}{ratio:8.2f}", flush=True)


def solids(count: int, repeats: int) -> None:
    """Compare bisectors on tetrahedra with recursive METIS."""
    graph = samples.tetrahedra(max(2, round((count / 6) ** (1 / 3)))).graph
    parts = graph.n // CELLS_PER_PART
    adjacency = pymetis.CSRAdjacency(graph.indptr, graph.indices)
    rows: dict[str, Callable[[], Any]] = {
        "METIS recursive": lambda: pymetis.part_graph(parts, adjacency, recursive=True),
        **{
            name: lambda name=name: agglo.agglomerate(graph, n_parts=parts, bisector=name)
            for name in ("kmeans", "metis", "sweep", "inertial")
        },
    }
    print(f"\n{graph.n} tetrahedra into {parts} parts{'':18}{'CPU s':>9}{'ratio':>17}")
    times: dict[str, list[float]] = {name: [] for name in rows}
    for _ in range(repeats):
        for name, run in rows.items():
            start = time.process_time()
            run()
            times[name].append(time.process_time() - start)
    for name, spent in times.items():
        print(f"{name:58}{min(spent):9.3f}{min(spent) / min(times['METIS recursive']):17.2f}", flush=True)


def main() -> None:
    """Read the arguments and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--tetrahedra", type=int, default=100_000)
    options = parser.parse_args()
    table(options.repeats)
    agglo.agglomerate(samples.tetrahedra(3), n_parts=10, bisector="sweep")
    solids(options.tetrahedra, options.repeats)


if __name__ == "__main__":
    main()
