"""Compare twenty time steps with slowly changing coefficient: levels and solutions kept, or fresh solves.

    python tests/benchmarks/time_steps.py [--cells N] [--degrees P ...] [--meshes NAME ...] [--steps N]
                                          [--rates R ...] [--tolerance T] [--front RATIO]

κ = exp(sin(2πx + t) sin(2πy)), one value per cell, with a source that changes accordingly; t grows by
``rate`` per step. With ``--front`` κ is RATIO for x < 0.2 + 0.1 t, otherwise 1. Each step is solved twice in
turn: from scratch, and by ``repeated`` of the default solver. Single-thread CPU seconds are summed over the
steps. ``set-up`` and ``all`` are the times of kept steps relative to fresh steps, where ``all`` is assembly,
set-up and solve; ``made`` counts how often levels were made, ``fresh`` and ``kept`` iterations; ``differ``
is the largest difference of the two solutions in the energy norm, ``residual`` the largest true
‖b − A x‖ / ‖b‖ of the kept steps.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
from collections.abc import Callable, Mapping

import numpy as np

from agglo_core import Hierarchy, Mesh, samples
from agglo_core.problems import Diffusion, Solution
from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid

MESHES: Mapping[str, Callable[[int], Mesh]] = {
    "squares": lambda n: samples.squares(round(np.sqrt(n))),
    "triangles": lambda n: samples.triangles(round(np.sqrt(n / 2))),
    "voronoi": lambda n: samples.voronoi(n, seed=0),
    "random": lambda n: samples.random_triangles(n // 2, seed=0),
}


def problem_at(mesh: Mesh, t: float, front: float = 0.0) -> Diffusion:
    """Return the problem at time t, with a front if its ratio is positive."""
    x, y = (mesh.cell_centroids - mesh.points.min(axis=0)).T
    kappa = np.exp(np.sin(2 * np.pi * x + t) * np.sin(2 * np.pi * y))
    if front > 0.0:
        kappa = np.where(x < 0.2 + 0.1 * t, front, 1.0)
    return Diffusion(kappa=kappa, source=8.0 + 4.0 * np.sin(np.pi * y + t))


def energy(A: object, x: np.ndarray) -> float:
    """Return the energy norm of x."""
    return float(np.sqrt(max(0.0, x @ (A @ x))))  # type: ignore[operator]


def row(mesh: Mesh, degree: int, rate: float, steps: int, tolerance: float, front: float) -> str:
    """Return the formatted figures for a mesh and degree."""
    solver = PolyDGMultigrid(degree=degree, tolerance=tolerance)
    hierarchy = Hierarchy(mesh, mesh.graph, [], [], nested=True)
    warm = solver.repeated(hierarchy)
    for _ in range(3):  # compilation and imports are charged to neither
        warm.solve(problem_at(mesh, 0.0, front))
    # Solve each step from scratch and with kept levels.
    kept_steps, spent = solver.repeated(hierarchy), {"fresh": [0.0, 0.0], "kept": [0.0, 0.0]}
    counts, differ, residual = {"fresh": 0, "kept": 0}, 0.0, 0.0
    for k in range(steps):
        problem = problem_at(mesh, rate * k, front)
        found: dict[str, Solution] = {
            "fresh": solver.solve(problem, hierarchy),
            "kept": kept_steps.solve(problem),
        }
        for name, it in found.items():
            if not it.converged:
                return f"{name}: {it.reason}"
            spent[name][0] += it.cpu_seconds.get("setup", 0.0)
            spent[name][1] += sum(it.cpu_seconds.values())
            counts[name] += it.iterations
        # Differences between both solutions, and residuals.
        kept, fresh = found["kept"], found["fresh"]
        differ = max(differ, energy(kept.A, kept.x - fresh.x) / energy(fresh.A, fresh.x))
        residual = max(residual, float(np.linalg.norm(kept.b - kept.A @ kept.x) / np.linalg.norm(kept.b)))
    setup, whole = (spent["kept"][i] / spent["fresh"][i] for i in range(2))
    return (
        f"{setup:8.2f}{whole:7.2f}{kept_steps.setups:6}{counts['fresh']:7}{counts['kept']:6}"
        f"{spent['fresh'][1]:9.2f}{differ:10.1e}{residual:10.1e}"
    )


def main() -> None:
    """Read the arguments and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, default=16_384)
    parser.add_argument("--degrees", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--meshes", nargs="+", choices=MESHES, default=list(MESHES))
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--rates", type=float, nargs="+", default=[0.05])
    parser.add_argument("--tolerance", type=float, default=1e-6)
    parser.add_argument("--front", type=float, default=0.0)
    options = parser.parse_args()
    print(
        f"{'mesh':<10}{'cells':>7}{'p':>3}{'rate':>7}{'set-up':>8}{'all':>7}{'made':>6}{'fresh':>7}{'kept':>6}"
        f"{'fresh s':>9}{'differ':>10}{'residual':>10}"
    )
    for name in options.meshes:
        mesh = MESHES[name](options.cells)
        for degree in options.degrees:
            for rate in options.rates:
                found = row(mesh, degree, rate, options.steps, options.tolerance, options.front)
                print(f"{name:<10}{mesh.n_cells:>7}{degree:>3}{rate:>7}{found}", flush=True)


if __name__ == "__main__":
    main()
