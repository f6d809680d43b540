"""Compare interface lengths at given balance: refiners ``balance`` and ``fm``, and METIS.

    python tests/benchmarks/interfaces.py [--cells N ...] [--parts K ...] [--meshes NAME ...] [--seeds N]

Means over N random meshes; K parts, by default parts of 16 cells and 20 parts. METIS counts edges, or weighs
edges by length (``lengths``). Its parts are made connected by the built-in fixer before ``fm``, but its own
row shows the original parts. Parts of ``kmeans``, with the default polish, are balanced first. ``interface``
and ``cut`` are relative to recursive METIS, ``apart`` is the number of disconnected parts, ``cells`` are the
smallest and largest part over the mean, and the coefficient of variation. CPU seconds, one thread, after a
warm-up; times of refiners exclude the partition.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import pymetis

import agglo_core as agglo
from agglo_core import Graph, samples
from agglo_core.arrays import Int
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.protocols import Target
from agglo_core.refine.balance import BalanceRefiner
from agglo_core.refine.fm import FMRefiner

MESHES: dict[str, Callable[[int, int], Graph]] = {
    "triangles": lambda cells, seed: samples.random_triangles(cells // 2, seed=seed).graph,
    "voronoi": lambda cells, seed: samples.voronoi(cells, seed=seed).graph,
}
REFINERS = {
    "fm": FMRefiner(),
    "fm:tolerance=0.1": FMRefiner(tolerance=0.1),
    "fm:objective=cut": FMRefiner(objective="cut"),
}


class Row(NamedTuple):
    """Figures of a partition."""

    interface: float
    cut: float
    apart: float
    least: float
    most: float
    variation: float
    seconds: float


def measured(graph: Graph, labels: Int, seconds: float) -> Row:
    """Measure interfaces, pieces and sizes of a partition."""
    cells = np.bincount(labels)
    pieces = len(np.unique(graph.components(labels)))
    return Row(
        OBJECTIVES["interface"](graph, labels),
        OBJECTIVES["cut"](graph, labels),
        pieces - len(cells),
        cells.min() / cells.mean(),
        cells.max() / cells.mean(),
        cells.std() / cells.mean(),
        seconds,
    )


def metis(graph: Graph, parts: int, recursive: bool, lengths: bool) -> tuple[Int, float]:
    """Return the labels of METIS, and CPU seconds."""
    adjacency = pymetis.CSRAdjacency(graph.indptr, graph.indices)
    weights = np.maximum(1, 1000.0 * graph.interface / graph.interface.mean()).astype(int)
    start = time.process_time()
    found = pymetis.part_graph(
        parts, adjacency, eweights=weights if lengths else None, recursive=recursive
    ).vertex_part
    return np.unique(found, return_inverse=True)[1], time.process_time() - start


def rows(graph: Graph, parts: int) -> Iterator[tuple[str, Row]]:
    """Yield each method of METIS and its refinements."""
    fixer = agglo.plugins.default().build("fixer", "connectivity")
    for recursive, lengths in ((True, False), (True, True), (False, False), (False, True)):
        title = f"METIS {'recursive' if recursive else 'k-way'}{', lengths' if lengths else ''}"
        labels, seconds = metis(graph, parts, recursive, lengths)
        yield title, measured(graph, labels, seconds)
        labels = fixer.fix(graph, labels)
        for name, refiner in REFINERS.items():
            after, seconds = refined(graph, labels, refiner)
            yield f"  + {name}", measured(graph, after, seconds)
    start = time.process_time()
    labels = agglo.agglomerate(graph, n_parts=parts).levels[0]
    yield "kmeans", measured(graph, labels, time.process_time() - start)
    for name, refiner in (("balance", BalanceRefiner()), ("balance + fm", FMRefiner())):
        labels, seconds = refined(graph, labels, refiner)
        yield f"  + {name}", measured(graph, labels, seconds)


def refined(graph: Graph, labels: Int, refiner: Any) -> tuple[Int, float]:
    """Return the labels after a refiner, and its CPU seconds."""
    start = time.process_time()
    after = refiner.refine(graph, labels, np.zeros(1, np.uint64), Target(parts=int(labels.max()) + 1))
    return after, time.process_time() - start


def main() -> None:
    """Print a table per mesh and part count."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, nargs="+", default=[100_000])
    parser.add_argument("--parts", type=int, nargs="+")
    parser.add_argument("--meshes", nargs="+", choices=MESHES, default=list(MESHES))
    parser.add_argument("--seeds", type=int, default=2)
    how = parser.parse_args()
    list(rows(samples.voronoi(500, seed=0).graph, 20))
    for name in how.meshes:
        for cells in how.cells:
            graphs = [MESHES[name](cells, 100 + seed) for seed in range(how.seeds)]
            for parts in how.parts or (graphs[0].n // 16, 20):
                print(f"\n{name}, {graphs[0].n:,} cells, {parts:,} parts, {how.seeds} meshes")
                print(f"{'':28}{'interface':>10}{'cut':>8}{'apart':>8}{'cells':>20}{'seconds':>10}")
                table = [list(rows(graph, parts)) for graph in graphs]
                for k, (title, _) in enumerate(table[0]):
                    found = np.mean([each[k][1] for each in table], axis=0)
                    base = np.mean([each[0][1] for each in table], axis=0)
                    sizes = f"{found[3]:.2f}–{found[4]:.2f} ±{found[5]:.3f}"
                    print(
                        f"{title:28}{found[0] / base[0]:10.3f}{found[1] / base[1]:8.3f}{found[2]:8.1f}"
                        f"{sizes:>20}{found[6]:10.3f}",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
