"""Compare petsc_mg with solvers of PETSc on PolyDG matrices: GAMG with near-null vectors, and MUMPS.

``mpiexec -n 2 python tests/benchmarks/petsc.py --cells 4000 --degree 1``

One run per number of ranks; seconds are the minimum of ``--repeat`` runs, also relative to GAMG. Our setup
includes prolongations and patches; setup of the matrix is not counted. BoomerAMG is missing unless PETSc was
built with hypre. Rows are distributed as in petsc_mg.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

import agglo_core as agglo
from agglo_core.registry import default
from agglo_petsc.ksp.checked_solve import solve
from agglo_petsc.ksp.pcmg import setup
from agglo_petsc.matrices import petsc
from agglo_petsc.solver.posed_systems import pose_system
from agglo_petsc.solver.system_on_ranks import SystemOnRanks, on_ranks

PETSc: Any = petsc()
OURS = ("sweeps", "patches", "blocks", "sor")


def main() -> None:
    """Print a row per solver."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--cells", type=int, default=4000)
    asked.add_argument("--degree", type=int, default=1)
    asked.add_argument("--seed", type=int, default=1)
    asked.add_argument("--repeat", type=int, default=3)
    asked.add_argument("--tolerance", type=float, default=1e-8)
    asked.add_argument("--jumps", type=float, default=0.0, help="κ is 10 to a random power up to this, ±")
    asked.add_argument("--box", action="store_true", help="boxes in space instead of Voronoi cells")
    given = asked.parse_args()
    # Problem, hierarchy and matrix.
    comm, rng = PETSc.COMM_WORLD, np.random.default_rng(given.seed)
    side = round(given.cells ** (1 / 3))
    mesh = agglo.samples.boxes(side) if given.box else agglo.samples.voronoi(given.cells, seed=given.seed)
    kappa = 10 ** rng.uniform(-given.jumps, given.jumps, mesh.n_cells)
    problem = agglo.Diffusion(kappa=kappa if given.jumps else 1.0)
    hierarchy = agglo.agglomerate(mesh, cells_per_part=(8, 64, 512), seed=given.seed)
    how = default().build("discretisation", "polydg", degree=given.degree)
    system = pose_system(problem, hierarchy, how, given.degree, None)
    # Solvers by name.
    rivals: dict[str, Callable[[], Any]] = {
        f"petsc_mg {name}": lambda name=name: _ours(system, comm, name) for name in OURS
    }
    rivals |= {"gamg": lambda: _gamg(system, comm), "mumps": lambda: _mumps(system, comm)}
    if PETSc.Sys.hasExternalPackage("hypre"):
        rivals["boomeramg"] = lambda: _plain(system, comm, {"pc_type": "hypre"})
    rows = {name: _measured(make, given.repeat, given.tolerance) for name, make in rivals.items()}
    if comm.getRank() == 0:
        _print(rows, mesh.n_cells, system.A.shape[0], comm.getSize())


def _measured(make: Callable[[], Any], repeat: int, tolerance: float) -> tuple[int, float, float, bool]:
    """Return iterations, seconds of setup and solve, and True on convergence."""
    setups, solves = [], []
    for _ in range(repeat):
        there, ksp, seconds = make()
        start = _now()
        history = solve(ksp, there.b, tolerance=tolerance, max_iterations=500)
        setups.append(seconds)
        solves.append(_now() - start)
        ksp.destroy()
    return history.iterations, min(setups), min(solves), history.converged


def _ours(system: Any, comm: Any, smoother: Any) -> tuple[SystemOnRanks, Any, float]:
    start = _now()
    on_ranks(replace(system, labels=[]), comm, "agglomerates", smoother)
    start += _now() - start  # distribution of the matrix
    there = on_ranks(system, comm, "agglomerates", smoother)
    ksp = _ksp(there)
    setup(ksp, there.levels, smoother=smoother)
    return there, ksp, _now() - start


def _gamg(system: Any, comm: Any) -> tuple[SystemOnRanks, Any, float]:
    """Set up GAMG with the constant and the linear functions as near-null vectors."""
    options = {"pc_type": "gamg", "mg_levels_ksp_type": "chebyshev", "mg_levels_esteig_ksp_type": "cg"}
    return _plain(system, comm, options, near_null=True)


def _mumps(system: Any, comm: Any) -> tuple[SystemOnRanks, Any, float]:
    return _plain(system, comm, {"pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"})


def _plain(
    system: Any, comm: Any, options: dict[str, str], near_null: bool = False
) -> tuple[SystemOnRanks, Any, float]:
    """Set up a solver of PETSc on the same rows."""
    there = on_ranks(system, comm, "agglomerates", "sor")  # its levels are neither used nor counted
    if near_null:
        start, stop = there.A.getOwnershipRange()
        own = np.linalg.qr(system.near_null)[0][there.rows[start:stop]]
        vectors = [there.b.duplicate() for _ in own.T]
        for vector, column in zip(vectors, own.T, strict=True):
            vector.setArray(column)
        there.A.setNearNullSpace(PETSc.NullSpace().create(vectors=vectors, comm=comm))
    there.A.setOption(PETSc.Mat.Option.SPD, True)
    start_time, database = _now(), PETSc.Options()
    ksp = _ksp(there)
    for name, value in options.items():
        database[name] = value
    ksp.setFromOptions()
    ksp.setUp()
    for name in options:
        database.delValue(name)
    return there, ksp, _now() - start_time


def _ksp(there: SystemOnRanks) -> Any:
    ksp = PETSc.KSP().create(there.A.getComm())
    ksp.setOperators(there.A)
    ksp.setType("cg")
    return ksp


def _now() -> float:
    PETSc.COMM_WORLD.tompi4py().Barrier()
    return time.perf_counter()


def _print(rows: dict[str, tuple[int, float, float, bool]], cells: int, n: int, ranks: int) -> None:
    setup_seconds, solve_seconds = rows["gamg"][1:3]
    print(f"{cells} cells, {n} unknowns, {ranks} ranks")
    print(f"gamg: set-up {setup_seconds:.3f} s, solve {solve_seconds:.3f} s")
    print(f"{'solver':18s} {'iterations':>10s} {'set-up':>8s} {'solve':>8s} {'both':>8s}   over gamg")
    for name, (iterations, first, second, converged) in rows.items():
        both = (first + second) / (setup_seconds + solve_seconds)
        state = "" if converged else "   not converged"
        seconds = f"{first / setup_seconds:8.2f} {second / solve_seconds:8.2f} {both:8.2f}"
        print(f"{name:18s} {iterations:10d} {seconds}{state}")


if __name__ == "__main__":
    main()
