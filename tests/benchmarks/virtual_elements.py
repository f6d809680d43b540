"""Compare virtual elements with PolyDG: unknowns, iterations, CPU seconds and errors on equal meshes.

    python tests/benchmarks/virtual_elements.py [--cells N ...] [--degrees K ...] [--meshes NAME ...]
                                                [--edges] [--levels]

The problem is −Δu = f with u = sin πx sin πy. Both methods use the solver
polydg_mg to 1e-6. ``solved`` are the unknowns of the finest level, without the unknowns inside cells of
virtual elements, ``entries`` those of its matrix. Ratios are virtual elements by PolyDG. CPU seconds of
one thread: assembly, set-up and solve.
``--edges`` prints condition numbers (diagonal scaled to 1) as an edge collapses. ``--levels`` compares
classical coarsening with the virtual elements on agglomerates of 8 cells, with the injection through L2
projections: iterations of a two-level cycle, and the fraction of unknowns that the coarse level keeps.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from polygon_meshes import PLANE, collapsing

import agglo_core as agglo
from agglo_core import Diffusion, Mesh
from agglo_core.multigrid import build_stack, cycle, pcg
from agglo_core.problems.diffusion import sine
from agglo_vem.virtual_elements import VirtualElements

WAVE = sine()
PROBLEM = Diffusion(source=WAVE.source, dirichlet={0: WAVE.exact}, exact=WAVE.exact)


def compare(name: str, mesh: Mesh, degree: int) -> None:
    """Print a row per method, and the ratios of unknowns and seconds at equal error."""
    costs = []
    for method in ("vem", "polydg"):
        solution = agglo.solve(mesh, PROBLEM, degree=degree, discretisation=method)
        finest, error = solution.operators[0][0], solution.errors()["l2"]
        seconds = sum(solution.cpu_seconds.values())
        print(
            f"{name:18} {mesh.n_cells:7,} {degree} {method:7} {finest.shape[0]:9,} {finest.nnz:11,} "
            f"{solution.iterations:4} {seconds:7.2f} {error:9.2e}",
            flush=True,
        )
        costs.append((finest.shape[0], seconds, error))
    (n, t, e), (n_dg, t_dg, e_dg) = costs
    # Costs are proportional to the number of cells, errors to its power −(k + 1) / 2.
    factor = (e / e_dg) ** (2.0 / (degree + 1))
    print(f"{'':28} at equal error: unknowns {factor * n / n_dg:.2f}, seconds {factor * t / t_dg:.2f}")


def print_conditions(degree: int) -> None:
    """Print condition numbers of two quadrilaterals whose common edge collapses, by stabilisation."""
    for name in ("dofi", "d-recipe"):
        row = []
        for length in (1e-1, 1e-3, 1e-5, 1e-7):
            problem = Diffusion(reaction=1.0, neumann={0: 0.0})
            A = VirtualElements(degree, name).assemble(problem, collapsing(length)).A.toarray()
            scale = A.diagonal() ** -0.5
            row.append(f"{np.linalg.cond(scale[:, None] * A * scale):8.1f}")
        print(f"{degree} {name:9}", *row)


def print_levels(name: str, mesh: Mesh) -> None:
    """Print the iterations of both coarse spaces for degree 1."""
    how = VirtualElements(1)
    system = how.assemble(PROBLEM, mesh)
    labels = agglo.agglomerate(mesh, cells_per_part=8).levels[0]
    P = how.prolongation(mesh, labels)
    free = np.setdiff1d(np.arange(system.n), how.fixed_unknowns(PROBLEM, mesh))
    A, P = system.A[free][:, free], P[free]
    P = P[:, np.flatnonzero(abs(P).sum(axis=0) > 1e-12)]
    injected = build_stack(A, np.arange(len(free) + 1), [P], coarse="lu")
    classical = agglo.build_levels(A).stack
    counts = [
        pcg(A, system.b[free], cycle(stack, "V"), tolerance=1e-6, most=200, stop="both").iterations
        for stack in (injected, classical)
    ]
    print(
        f"{name:18} {mesh.n_cells:7,} injection {counts[0]:4}, unknowns kept {P.shape[1] / len(free):.2f}; "
        f"classical {counts[1]:4}, kept {classical.levels[1].A.shape[0] / len(free):.2f}"
    )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cells", type=int, nargs="+", default=[4096, 16384])
    parser.add_argument("--degrees", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--meshes", nargs="+", default=[name for name in PLANE if name != "slivers"])
    parser.add_argument("--edges", action="store_true")
    parser.add_argument("--levels", action="store_true")
    chosen = parser.parse_args()
    agglo.solve(agglo.samples.voronoi(100), PROBLEM)  # compiles
    for degree in chosen.degrees if chosen.edges else ():
        print_conditions(degree)
    for name in chosen.meshes:
        for n in chosen.cells:
            mesh = PLANE[name](n)
            if chosen.levels:
                print_levels(name, mesh)
            for degree in () if chosen.edges or chosen.levels else chosen.degrees:
                compare(name, mesh, degree)


if __name__ == "__main__":
    main()
