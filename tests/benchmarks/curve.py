"""Compare polished runs of a space-filling curve with polished bisections of ``kmeans``.

    python tests/benchmarks/curve.py [--seeds N] [--cells N]

For each family of fresh random meshes and number of parts: objective J · L^0.3, J, interface length, mean
CR (2-D), relative deviation of the cell counts, and CPU seconds, of the curve relative to the bisections.
Means over the meshes. The curve is used everywhere, also where a run would not choose it: these rows show the
limits of the choice (few parts, few cells per part, stretched cells).
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

import agglo_core as agglo
from agglo_core import Mesh, samples
from agglo_core.agglomeration.levels import curve
from agglo_core.graph.objectives import OBJECTIVES

ALWAYS = {"_ACROSS": 0, "_CELLS": (0, np.inf), "_STRETCHED": 2.0}


def families(cells: int) -> dict[str, Callable[[int], Mesh]]:
    """Return functions of a seed for meshes with about ``cells`` cells, by name."""

    def stretched(by: float) -> Callable[[int], Mesh]:
        def make(seed: int) -> Mesh:
            mesh = samples.voronoi(cells, seed=seed)
            return replace(mesh, points=mesh.points * [by, 1.0])

        return make

    return {
        "random triangles": lambda seed: samples.random_triangles(cells // 2, seed=seed),
        "Voronoi": lambda seed: samples.voronoi(cells, seed=seed),
        "Voronoi, stretched 4 times": stretched(4.0),
        "Voronoi, stretched 16 times": stretched(16.0),
        "random tetrahedra": lambda seed: samples.random_tetrahedra(cells // 5, seed=seed),
    }


def figures(mesh: Mesh, parts: int, along_curve: bool) -> list[float]:
    """Return the figures of one partition."""
    start = time.process_time()
    bisector = ("kmeans", {"curve": along_curve})
    labels = agglo.agglomerate(mesh, n_parts=parts, bisector=bisector).levels[0]
    seconds = time.process_time() - start
    values = [OBJECTIVES[name].value(mesh.graph, labels) for name in ("shape", "compactness", "interface")]
    ratio = agglo.quality(mesh, labels, metrics=("CR",))["CR"].mean() if mesh.dim == 2 else np.nan
    sizes = np.bincount(labels)
    return [*values, float(ratio), float(sizes.std() / sizes.mean()), seconds]


def main() -> None:
    """Print a table per family."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--cells", type=int, default=5000)
    options = parser.parse_args()
    for name, value in ALWAYS.items():
        setattr(curve, name, value)
    fresh = int(np.random.SeedSequence().generate_state(1)[0]) % 10**6
    for family, make in families(options.cells).items():
        meshes = [make(fresh + seed) for seed in range(options.seeds)]
        print(f"\n{family}, {meshes[0].n_cells} cells, {options.seeds} meshes")
        print(f"{'parts':>8}{'shape':>8}{'J':>8}{'L':>8}{'CR':>8}{'spread':>8}{'time':>8}")
        counts = [4, 12, 25, 125, *(meshes[0].n_cells // cells for cells in (32, 16, 8, 5, 3))]
        for parts in counts:
            figures(meshes[0], parts, True)  # compiles
            rows = [np.divide(figures(m, parts, True), figures(m, parts, False)) for m in meshes]
            print(f"{parts:>8}{''.join(f'{value:8.3f}' for value in np.mean(rows, axis=0))}", flush=True)


if __name__ == "__main__":
    main()
