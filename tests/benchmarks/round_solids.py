"""Measure roundness and balance of annealed 3-D parts, next to the best bisectors.

    python tests/benchmarks/round_solids.py [--seeds N] [--cells N] [--only NAME ...]

Means over random tetrahedra and Voronoi polyhedra with about 4,000 cells, in parts of 32 cells on average:
by size (the diagonal of a cube of 32 mean cells) and by count. Columns: part count K; interface area over
that of the recursion with k-means, both divided by the cube root of K to compensate for more parts; mean
diameter over the size (by count: over the diagonal of a cube with the mean part volume); means of UF, J and
the isoperimetric quotient; CPU seconds. METIS parts exceed the size, so by size METIS appears only with
further bisection.
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
from numpy.typing import NDArray

import agglo_core as agglo
from agglo_core import Mesh, samples
from agglo_core.errors import AggloError

Labels = NDArray[np.int64]
PER_PART = 32
BASE = "kmeans"
MESHES: dict[str, Callable[[int, int], Mesh]] = {
    "tetrahedra": lambda cells, seed: samples.random_tetrahedra(round(0.172 * cells), seed=seed),
    "Voronoi solids": lambda cells, seed: samples.voronoi3d(cells, seed=seed),
}
_ANNEALED: dict[str, Any] = {"post_refiners": ("compactness", ("anneal", {"objective": "roundness"}))}
METHODS: dict[str, dict[str, Any]] = {
    **{name: {"bisector": name} for name in (BASE, "sweep", "inertial", "spectral", "metis")},
    "k-way": {"bisector": BASE, "method": "kway"},
    "METIS k-way, polished": {"bisector": "metis", "method": "kway"},
    "kmeans, then anneal": {"bisector": BASE, **_ANNEALED},
    "k-way, then anneal": {"bisector": BASE, "method": "kway", **_ANNEALED},
    **{
        name: {"bisector": (BASE, {"effort": name, "objective": "roundness"}), "method": "kway"}
        for name in ("fast", "good", "best")
    },
}
METRICS = ("UF", "J", "isoperimetric")


def target_of(mesh: Mesh, kind: str) -> tuple[dict[str, float], float]:
    """Return the target, and the reference width for diameters."""
    width = float(np.sqrt(3.0) * (PER_PART * mesh.cell_measures.mean()) ** (1 / 3))
    return ({"h_star": width} if kind == "size" else {"n_parts": mesh.n_cells // PER_PART}), width


def figures(mesh: Mesh, labels: Labels, width: float) -> list[float]:
    """Return K, interface area over the cube root of K, mean diameter over the width, and mean metrics."""
    graph, coarse = mesh.graph, mesh.coarsen(labels)
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    area = graph.interface[labels[rows] != labels[graph.indices]].sum() / 2.0
    values = agglo.quality(mesh, labels, metrics=METRICS)
    means = [float(values[name].mean()) for name in METRICS]
    k = coarse.n_cells
    return [float(k), float(area / k ** (1 / 3)), float(coarse.cell_diameters.mean() / width), *means]


def rows_of(mesh: Mesh, kind: str, seed: int) -> dict[str, list[float]]:
    """Return the figures of each method on a mesh, with interface areas relative to the base."""
    target, width = target_of(mesh, kind)
    assert mesh.graph.n
    rows = {}
    for name, how in METHODS.items():
        start = time.process_time()
        try:
            labels = agglo.agglomerate(mesh, seed=seed, **how, **target).levels[0]
        except AggloError as error:  # METIS and spectral are optional
            print(f"{name}: {error}")
            continue
        seconds = time.process_time() - start
        rows[name] = [*figures(mesh, labels, width), seconds]
    base = rows[BASE][1]
    return {name: [row[0], row[1] / base, *row[2:]] for name, row in rows.items()}


def main() -> None:
    """Print a table per mesh family and kind of target."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--cells", type=int, default=4000)
    parser.add_argument("--only", nargs="*", default=list(MESHES), choices=list(MESHES))
    options = parser.parse_args()
    rows_of(samples.random_tetrahedra(40), "size", 0)  # compiles
    fresh = int(np.random.SeedSequence().generate_state(1)[0]) % 10**6
    for family in options.only:
        meshes = [MESHES[family](options.cells, fresh + place) for place in range(options.seeds)]
        for kind in ("size", "count"):
            found = [rows_of(mesh, kind, place) for place, mesh in enumerate(meshes)]
            cells = "–".join(f"{count:,}" for count in sorted({mesh.n_cells for mesh in meshes}))
            print(f"\n{family}, {cells} cells, by {kind}, {len(meshes)} meshes")
            heads = ("K", "area", "d/width", "UF", "J", "isop.", "CPU s")
            print(f"{'':>22}{''.join(f'{head:>8}' for head in heads)}")
            for name in found[0]:
                k, *rest = np.mean([rows[name] for rows in found], axis=0)
                print(f"{name:>22}{k:8.1f}{''.join(f'{value:8.3f}' for value in rest)}", flush=True)


if __name__ == "__main__":
    main()
