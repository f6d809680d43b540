"""Measure rules for parts: balance on graded meshes, regions for solvers, and the cost of rules.

``python tests/benchmarks/rules.py [balance] [solve] [cost]`` prints these tables, by default all. Process CPU
seconds, the best alternating run.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from scipy.spatial import Delaunay

import agglo_core as agglo
from agglo_core import samples
from agglo_core.problems import Diffusion
from agglo_core.registry import default

GRADES = (1.0, 1e5)
WAYS = {
    "cells": {},
    "cells, k-way": {"method": "kway"},
    "cells, sweep": {"bisector": "sweep"},
    "cells, metis k-way": {"bisector": "metis", "method": "kway"},
    "measure": {"balance": "measure"},
}


def graded(n: int, seed: int, ratio: float) -> agglo.Mesh:
    """Return triangles whose areas grow from the corner (0, 0) by about ``ratio``, the ratio of point
    densities.
    """
    rng = np.random.default_rng(seed)
    inner = 1.0 / (max(np.sqrt(ratio), 1.001) - 1.0)
    found = np.empty((0, 2))
    # Draw points with the wanted density by rejection.
    while len(found) < n:
        r = inner * np.expm1(rng.random(4 * n) * np.log1p(1.5 / inner))
        r = r[rng.random(4 * n) < r / (inner + r)]
        angle = rng.uniform(0, np.pi / 2, len(r))
        points = r[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=1)
        found = np.concatenate((found, points[(points < 1).all(axis=1)]))
    # Triangulate and drop degenerate triangles.
    points = np.concatenate((found[:n], [[0, 0], [1, 0], [0, 1], [1, 1]]))
    triangles = Delaunay(points).simplices
    a, b = (points[triangles[:, k]] - points[triangles[:, 0]] for k in (1, 2))
    return agglo.Mesh.from_polygons(points, triangles[np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) > 1e-14])


def balance() -> None:
    """Print cells per part on graded meshes, as means over three seeds."""
    print(
        "balance, 20,000 triangles, 16 cells per part: deviation over mean of the cells, most cells, mean CR"
    )
    for ratio in GRADES:
        meshes = [graded(10_000, seed, ratio) for seed in (1, 2, 3)]
        areas = np.concatenate([mesh.cell_measures for mesh in meshes])
        print(f"areas of 99.9 % and .1 %: {np.divide(*np.percentile(areas, (99.9, 0.1))):.1e}")
        for name, how in WAYS.items():
            rows = []
            for mesh in meshes:
                labels = agglo.agglomerate(mesh, cells_per_part=16, **how).levels[0]
                cells = np.bincount(labels)
                ratios = agglo.quality(mesh, labels, metrics=("CR",))["CR"]
                rows.append((cells.std() / cells.mean(), cells.max(), ratios.mean()))
            spread, most, ratio_of_circles = np.mean(rows, axis=0)
            print(f"  {name:20} {spread:6.2f} {most:8.0f} {ratio_of_circles:7.3f}")


def solve() -> None:
    """Print iterations with and without regions, for κ of 1 and 1e6 in wavy layers."""
    mesh = samples.voronoi(3000, seed=2)
    x, y = mesh.cell_centroids.T
    layer = np.floor(6 * (y + 0.15 * np.sin(5 * x))).astype(int) % 2
    problem = Diffusion(kappa=np.where(layer, 1e6, 1.0), source=8.0)
    print("iterations on 3,000 Voronoi cells, kappa 1 and 1e6 in layers, levels of 8 and 32 cells per part")
    for degree in (1, 2):
        for name in ("polydg_mg_paper", "polydg_mg"):
            solver = default().build("solver", name, degree=degree)
            counts = []
            for regions in (None, layer):
                hierarchy = agglo.agglomerate(mesh, cells_per_part=(8, 32), regions=regions)
                counts.append(solver.solve(problem, hierarchy).iterations)
            print(f"  p = {degree} {name:16} without {counts[0]:5}, with regions {counts[1]:5}")


def cost() -> None:
    """Print CPU seconds for a million triangles with 16 cells per part."""
    mesh = samples.triangles(708)
    x, y = mesh.cell_centroids.T
    rules = {
        "plain": {},
        "regions": {"regions": (x + 0.1 * np.sin(9 * y) > 0.5) + 2 * (y > 0.6)},
        "weights": {"weights": np.random.default_rng(0).uniform(1, 3, mesh.n_cells)},
    }
    best = dict.fromkeys(rules, np.inf)
    for _ in range(6):
        for name, rule in rules.items():
            start = time.process_time()
            agglo.agglomerate(mesh, cells_per_part=16, **rule)
            best[name] = min(best[name], time.process_time() - start)
    print(f"cost, {mesh.n_cells:,} triangles: CPU s, and over the plain run")
    for name, seconds in best.items():
        print(f"  {name:10} {seconds:6.3f} {seconds / best['plain']:6.2f}")


if __name__ == "__main__":
    tables = {"balance": balance, "solve": solve, "cost": cost}
    for chosen in sys.argv[1:] or tables:
        tables[chosen]()
