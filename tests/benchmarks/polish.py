"""Measure the effect of the polish on finished levels, for several interface weights.

    python tests/benchmarks/polish.py [--cells N] [--seeds N] [--per-part N ...]

The refiner ``compactness`` lowers J · L^α, where J is the moment of inertia of the parts (the energy of
k-means) and L the interface length. For each α: J and L relative to no polish, mean CR, UF, and CPU seconds
of the polish relative to recursive METIS. Means over random meshes; default pipeline, exact counts.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import time
from collections.abc import Callable

import numpy as np
import pymetis
from numpy.typing import NDArray

import agglo_core as agglo
from agglo_core import Graph, Mesh, samples
from agglo_core.arrays import frozen_int
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.protocols import Target
from agglo_core.refine.compactness import refiner as compactness

Labels = NDArray[np.int64]
WEIGHTS = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0)


def families(cells: int) -> dict[str, Callable[[int], Mesh]]:
    """Return functions of a seed for meshes with about ``cells`` cells, by name."""
    side = max(2, round((cells / 6) ** (1 / 3)))
    return {
        "random triangles": lambda seed: samples.random_triangles(cells // 2, seed=seed),
        "Voronoi": lambda seed: samples.voronoi(cells, seed=seed),
        "tetrahedra": lambda seed: samples.tetrahedra(side + seed % 3),
    }


def polished(graph: Graph, labels: Labels, weight: float) -> Labels:
    """Return the labels after the polish with this weight."""
    kept, compactness.SHORTNESS = compactness.SHORTNESS, weight
    try:
        block = frozen_int(np.zeros(int(labels.max()) + 1))
        return compactness.CompactnessRefiner().refine_parts(graph, frozen_int(labels), block, Target())
    finally:
        compactness.SHORTNESS = kept


def figures(mesh: Mesh, labels: Labels) -> list[float]:
    """Return J, L, mean CR (2-D only) and UF."""
    values = [OBJECTIVES[name].value(mesh.graph, labels) for name in ("compactness", "interface")]
    metrics = ("UF", "CR") if mesh.dim == 2 else ("UF",)
    means = {name: each.mean() for name, each in agglo.quality(mesh, labels, metrics=metrics).items()}
    return [*values, float(means.get("CR", np.nan)), float(means["UF"])]


def rows_of(mesh: Mesh, per_part: int) -> list[list[float]]:
    """Return a row without polish, and a row per weight."""
    graph = mesh.graph
    parts = max(2, round(graph.n / per_part))
    start = time.process_time()
    pymetis.part_graph(parts, pymetis.CSRAdjacency(graph.indptr, graph.indices), recursive=True)
    reference = time.process_time() - start
    labels = agglo.agglomerate(graph, n_parts=parts, polish=False).levels[0]
    rows = [[*figures(mesh, labels), 0.0]]
    for weight in WEIGHTS:
        start = time.process_time()
        after = polished(graph, labels, weight)
        seconds = time.process_time() - start
        rows.append([*figures(mesh, after), seconds / reference])
    for row in rows[::-1]:
        row[0], row[1] = row[0] / rows[0][0], row[1] / rows[0][1]
    return rows


def main() -> None:
    """Print a table per family and part size."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, default=4000)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--per-part", type=int, nargs="*", default=[16, 64])
    options = parser.parse_args()
    rows_of(samples.voronoi(200), 16)  # compiles
    fresh = int(np.random.SeedSequence().generate_state(1)[0])
    for name, make in families(options.cells).items():
        for per_part in options.per_part:
            tables = [rows_of(make(fresh % 10**6 + s), per_part) for s in range(options.seeds)]
            print(f"\n{name}, {per_part} cells in a part, {options.seeds} meshes")
            print(f"{'weight':>10}{'J':>8}{'L':>8}{'CR':>8}{'UF':>8}{'time/METIS':>12}")
            for label, row in zip(("none", *WEIGHTS), np.mean(tables, axis=0), strict=True):
                print(f"{label!s:>10}{''.join(f'{value:8.3f}' for value in row[:4])}{row[4]:12.3f}")


if __name__ == "__main__":
    main()
