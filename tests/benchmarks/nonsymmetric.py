"""Compare solves of nonsymmetric systems by multigrid, SuperLU and PyAMG: iterations and CPU seconds.

    python tests/benchmarks/nonsymmetric.py [--cells N] [--meshes NAME ...] [--peclet P ...]

Upwind finite volumes for −∇·(κ∇u) + ∇·(b u) with a random right-hand side, to a relative residual of 1e-6,
for a constant flow b and a closed one. Péclet numbers are cell size over κ. ``ours`` is ``polydg_mg`` for
``Linear(A, b, symmetric=False)``; PyAMG preconditions GMRES by ``smoothed_aggregation_solver(A,
symmetry="nonsymmetric")`` and by ``ruge_stuben_solver(A)``. Seconds of set-up and solve of one thread.
PyAMG is omitted if not installed.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import sys
import time
import warnings
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import gmres, splu

sys.path.insert(0, str(Path(__file__).parents[1]))

from flux_matrices import upwind_flux

from agglo_core import Linear, agglomerate, samples, solve

MOST = 200


def constant(x: np.ndarray) -> np.ndarray:
    """Return the flow (1, 0.3, −0.2)."""
    return np.broadcast_to([1.0, 0.3, -0.2][: x.shape[1]], x.shape)


def closed(x: np.ndarray) -> np.ndarray:
    """Return the rotation about the middle of the unit square or cube."""
    found = np.zeros(x.shape)
    found[:, 0], found[:, 1] = 0.5 - x[:, 1], x[:, 0] - 0.5
    return found


MESHES: dict[str, Callable[[int], Any]] = {
    "squares": lambda n: samples.squares(round(n ** (1 / 2))),
    "voronoi": lambda n: samples.voronoi(n, seed=1),
    "boxes": lambda n: samples.boxes(round(n ** (1 / 3))),
    "voronoi3d": lambda n: samples.voronoi3d(n, seed=1),
}


def rival(method: str, A: Any, b: np.ndarray) -> tuple[int, bool]:
    """Return iterations and convergence of GMRES with a method of PyAMG."""
    import pyamg

    matrix, counted = sparse.csr_matrix(A), list[float]()
    matrix.indices, matrix.indptr = (each.astype(np.int32) for each in (matrix.indices, matrix.indptr))
    options = {"symmetry": "nonsymmetric"} if method.startswith("smoothed") else {}
    M = getattr(pyamg, method)(matrix, **options).aspreconditioner()
    x, _ = gmres(
        A, b, M=M, rtol=1e-7, restart=50, maxiter=MOST // 50, callback=counted.append, callback_type="pr_norm"
    )  # the preconditioned residual is tested
    return len(counted), bool(np.linalg.norm(b - A @ x) <= 1e-6 * np.linalg.norm(b))


def row(hierarchy: Any, A: Any, b: np.ndarray) -> str:
    """Return iterations and CPU seconds of every method."""

    def ours() -> tuple[int, bool]:
        problem = Linear(A, b, symmetric=False)
        solution = solve(hierarchy, problem, max_iterations=MOST)
        return solution.iterations, solution.converged

    def direct() -> tuple[int, bool]:
        splu(sparse.csc_matrix(A)).solve(b)
        return 1, True

    methods: list[Callable[[], tuple[int, bool]]] = [ours, direct]
    if find_spec("pyamg"):
        for name in ("smoothed_aggregation_solver", "ruge_stuben_solver"):
            methods.append(lambda name=name: rival(name, A, b))
    cells = []
    for method in methods:
        start = time.process_time()
        iterations, converged = method()
        seconds = time.process_time() - start
        cells.append(f"{iterations if converged else 'none':>5}{seconds:9.2f}")
    return " |".join(cells)


def main() -> None:
    """Read the arguments and print a table for every mesh."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, default=57_600)
    parser.add_argument("--meshes", nargs="+", choices=MESHES, default=["squares", "boxes"])
    parser.add_argument("--peclet", type=float, nargs="+", default=[0.1, 1.0, 10.0, 1e2, 1e4])
    options = parser.parse_args()
    warnings.simplefilter("ignore")  # from loops in PyAMG
    heads = ["ours", "SuperLU", *(["PyAMG SA", "PyAMG RS"] if find_spec("pyamg") else [])]
    row(
        agglomerate(samples.squares(50), n_parts=4),
        upwind_flux(samples.squares(50), 1.0, closed),
        np.ones(2500),
    )
    for name in options.meshes:
        mesh = MESHES[name](options.cells)
        hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=16, polish=False)
        print(f"\n{name}, {mesh.n_cells} unknowns; iterations and CPU seconds")
        print(f"{'flow':10}{'Péclet':>8} |" + " |".join(f"{each:>14}" for each in heads), flush=True)
        b = np.random.default_rng(0).standard_normal(mesh.n_cells)
        for flow in (constant, closed):
            for peclet in options.peclet:
                A = upwind_flux(mesh, peclet, flow)
                print(f"{flow.__name__:10}{peclet:8g} |" + row(hierarchy, A, b), flush=True)


if __name__ == "__main__":
    main()
