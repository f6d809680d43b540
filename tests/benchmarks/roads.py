"""Compare bisectors that make all splits in one call with the same bisectors depth by depth.

    python tests/benchmarks/roads.py [--bisectors NAME ...] [--families NAME ...] [--seeds N] [--cells N]
                                     [--no-polish]

Means over N random meshes per family: part count, UF and CR (in 3-D J, the k-means energy, 1 for a ball) for
both ways, and differences, without merging; ``±`` is the standard error of a difference. Parts of 16 cells
on average (counts), then parts of at most twice this size (sizes). ``--no-polish`` shows the splits without
polish.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

import agglo_core as agglo
from agglo_core import Mesh, samples
from agglo_core.arrays import Float, Int, UInt64

FAMILIES: Mapping[str, Callable[[int, int], Mesh]] = {
    "triangles": lambda cells, seed: samples.random_triangles(cells // 2, seed=seed),
    "voronoi": lambda cells, seed: samples.voronoi(cells, seed=seed),
    "quadrilaterals": lambda cells, seed: perturbed(samples.squares(round(cells**0.5)), seed),
    "tetrahedra": lambda cells, seed: perturbed(samples.tetrahedra(round((cells / 6) ** (1 / 3))), seed),
}


def perturbed(mesh: Mesh, seed: int) -> Mesh:
    """Return the mesh with inner points displaced by up to a tenth of a cell."""
    inside = np.ones(len(mesh.points), bool)
    outer = np.flatnonzero(mesh.face_cells[:, 1] < 0)
    starts, stops = mesh.face_offsets[outer], mesh.face_offsets[outer + 1]
    for start, stop in zip(starts, stops, strict=True):
        inside[mesh.face_vertices[start:stop]] = False
    size = 0.1 * float(np.median(mesh.cell_measures)) ** (1 / mesh.dim)
    moves = np.random.default_rng(seed).uniform(-size, size, mesh.points.shape) * inside[:, None]
    return Mesh(mesh.points + moves, mesh.face_offsets, mesh.face_vertices, mesh.face_cells)


class ByDepth:
    """Built-in bisector without its method to make all splits."""

    def __init__(self, name: str) -> None:
        self._tool = agglo.plugins.default().build("bisector", name)

    def bisect_level(self, level: Any, seeds: UInt64) -> Int:
        """Return the sides of the bisector."""
        sides: Int = self._tool.bisect_level(level, seeds)
        return sides


def values(mesh: Mesh, bisector: Any, **target: Any) -> Float:
    """Return the part count, mean UF, and mean of the other metric."""
    labels = agglo.agglomerate(mesh, bisector=bisector, **target).levels[0]
    found = agglo.quality(mesh, labels, metrics=("UF", "CR") if mesh.dim == 2 else ("UF",))
    other = found["CR"].mean() if mesh.dim == 2 else compactness(mesh, labels)
    return np.array([labels.max() + 1, found["UF"].mean(), other])


def compactness(mesh: Mesh, labels: Int) -> float:
    """Return the k-means energy relative to balls of equal measure, from the cell centroids."""
    weight, x = mesh.cell_measures, mesh.graph.centroids
    total = np.bincount(labels, weight)
    means = np.stack([np.bincount(labels, weight * each) / total for each in x.T], axis=1)
    energy = np.bincount(labels, weight * ((x - means[labels]) ** 2).sum(axis=1))
    return float(np.mean(energy / (0.6 * (0.75 / np.pi) ** (2 / 3) * total ** (5 / 3))))


def main() -> None:
    """Print a table per family."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--bisectors", nargs="+", default=["kmeans", "sweep", "inertial", "coordinate", "gnn"]
    )
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=list(FAMILIES))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--cells", type=int, default=4000)
    parser.add_argument("--no-polish", action="store_true")
    how = parser.parse_args()
    for family in how.families:
        meshes = [FAMILIES[family](how.cells, 1000 + seed) for seed in range(how.seeds)]
        other = "CR" if meshes[0].dim == 2 else "J"
        print(f"\n{family}, {how.seeds} meshes of {meshes[0].n_cells} cells")
        print(f"{'':20}{'K':>14}{'UF':>15}{other:>15}{'UF':>17}{other:>17}")
        for bisector in how.bisectors:
            if not suits(bisector, meshes[0].dim):
                continue
            for target in ("counts", "sizes"):
                rows = [compared(mesh, bisector, target, not how.no_polish) for mesh in meshes]
                print(line(f"{bisector}, {target}", np.array(rows)), flush=True)


def suits(bisector: str, dim: int) -> bool:
    """Return True if a built-in bisector supports this dimension."""
    component = agglo.plugins.default().record("bisector", bisector).component
    return dim == 2 or (component is not None and bool(component.promises.get("3d")))


def compared(mesh: Mesh, bisector: str, target: str, polish: bool) -> Float:
    """Return values ``(2, 3)`` in one call and depth by depth."""
    count = mesh.n_cells // 16
    size = 2.0 * float((mesh.cell_measures.sum() / count) ** (1 / mesh.dim))
    options: dict[str, Any] = {"n_parts": count} if target == "counts" else {"h_star": size}
    ways = (bisector, ByDepth(bisector))
    return np.stack([values(mesh, way, polish=polish, **options) for way in ways])


def line(title: str, rows: Float) -> str:
    """Format the means of both ways, then differences with standard errors."""
    means, change = rows.mean(axis=0), rows[:, 0] - rows[:, 1]
    error = change.std(axis=0) / len(rows) ** 0.5
    text = f"{title:20}" + "".join(
        f"{f'{means[0, k]:.{d}f} | {means[1, k]:.{d}f}':>{w}}"
        for k, d, w in ((0, 0, 14), (1, 3, 15), (2, 3, 15))
    )
    return text + "".join(f"{f'{change[:, k].mean():+.4f} ±{error[k]:.4f}':>17}" for k in (1, 2))


if __name__ == "__main__":
    main()
