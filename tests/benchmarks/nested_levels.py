"""Compare nested annealed levels, built from below or above, with recursion and unnested levels.

    python tests/benchmarks/nested_levels.py [--meshes NAME ...] [--cells N] [--seeds N] [--effort NAME]

Three levels with parts as large as 16, 64 and 256 cells: by size (the diagonal of a square with this many
cells), and by count. "From below" is ``method="kway"`` with nested levels: each level joins parts of the
finer level. "From above" makes each level inside the parts of the next coarser level, kept apart by a
constraint. Means over N random meshes: part count, UF, CR and J of each level, finest first, and CPU
seconds.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import agglo_core as agglo
from agglo_core import Graph, Mesh, samples
from agglo_core.arrays import Int, Mask

MESHES: dict[str, Callable[[int, int], Mesh]] = {
    "triangles": lambda cells, seed: samples.random_triangles(cells // 2, seed=seed),
    "voronoi": lambda cells, seed: samples.voronoi(cells, seed=seed),
}
SIZES = (16, 64, 256)
METRICS = ("UF", "CR", "J")


class Apart:
    """Constraint that keeps the parts of a level separate."""

    def __init__(self, labels: Int) -> None:
        self.labels = labels

    def forbidden(self, graph: Graph) -> Mask:
        """Return the edges between parts."""
        rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
        return self.labels[rows] != self.labels[graph.indices]


def targets(mesh: Mesh, kind: str) -> dict[str, list[float]]:
    """Return the targets, finest level first."""
    cell = float(mesh.cell_measures.mean())
    if kind == "sizes":
        return {"h_star": [float(np.sqrt(2 * each * cell)) for each in SIZES]}
    return {"n_parts": [mesh.n_cells // each for each in SIZES]}


def from_above(mesh: Mesh, kind: str, **how: Any) -> list[Int]:
    """Return levels, each made inside the parts of the next coarser level."""
    ((name, values),) = targets(mesh, kind).items()
    levels: list[Int] = []
    for value in reversed(values):
        apart = [Apart(levels[0])] if levels else []
        levels.insert(0, agglo.agglomerate(mesh, **{name: value}, constraints=apart, **how).levels[0])
    return levels


def ways(effort: str) -> dict[str, Callable[[Mesh, str], list[Int]]]:
    """Return methods to make levels, by name."""
    annealed: dict[str, Any] = {
        "method": "kway",
        "bisector": ("kmeans", {"effort": effort, "objective": "roundness"}),
    }

    def plain(mesh: Mesh, kind: str, **how: Any) -> list[Int]:
        return list(agglo.agglomerate(mesh, **targets(mesh, kind), **how).levels)

    return {
        "recursion": plain,
        "k-way, from below": lambda mesh, kind: plain(mesh, kind, method="kway"),
        f"{effort}, from below": lambda mesh, kind: plain(mesh, kind, **annealed),
        f"{effort}, from above": lambda mesh, kind: from_above(mesh, kind, **annealed),
        f"{effort}, not nested": lambda mesh, kind: plain(mesh, kind, nested=False, **annealed),
    }


def main() -> None:
    """Print a table per mesh and kind of target."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--meshes", nargs="+", choices=MESHES, default=list(MESHES))
    parser.add_argument("--cells", type=int, default=4000)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--effort", default="good")
    how = parser.parse_args()
    for name in how.meshes:
        meshes = [MESHES[name](how.cells, 50 + seed) for seed in range(how.seeds)]
        for kind in ("sizes", "counts"):
            print(f"\n{name}, {meshes[0].n_cells:,} cells, {kind}: K, UF, CR, J of each level")
            for title, make in ways(how.effort).items():
                start, rows = time.process_time(), []
                for mesh in meshes:
                    rows.append([measured(mesh, labels) for labels in make(mesh, kind)])
                seconds = (time.process_time() - start) / len(meshes)
                levels = ["{:5.0f} {:.3f} {:.3f} {:.3f}".format(*row) for row in np.mean(rows, axis=0)]
                print(f"{title:20}{' | '.join(levels)}{seconds:8.2f} s", flush=True)


def measured(mesh: Mesh, labels: Int) -> list[float]:
    """Return the part count and mean metrics."""
    found = agglo.quality(mesh, labels, metrics=METRICS)
    return [float(labels.max()) + 1.0, *(float(found[name].mean()) for name in METRICS)]


if __name__ == "__main__":
    main()
