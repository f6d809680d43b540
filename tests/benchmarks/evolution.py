"""Compare solvers over time steps of a monodomain problem: set-up once, iterations and CPU seconds per step.

    python tests/benchmarks/evolution.py [--cells N ...] [--degrees P ...] [--steps N] [--step T]
                                         [--kappa K] [--scheme NAME] [--solvers NAME ...] [--tolerance T]

A wave of the FitzHugh–Nagumo equations on Voronoi cells of the unit square, insulated, excited on the left.
The reaction is explicit, so all steps have one matrix (with BDF2 two). One thread, process CPU seconds.
``set-up`` is assembly and levels or factors, over all steps. ``iterations`` are the mean of all steps after
the first ten, ``ms`` the CPU milliseconds of these steps, with the reaction, whose time is ``react``. PyAMG
is smoothed aggregation with the constants, or with linear functions (PyAMG 1), in conjugate gradients that
start from the best combination of eight earlier solutions, with agglo's stopping test, as polydg_mg. The
solver ``direct`` (superlu, pardiso) solves once per step and bounds the error by the residual; "superlu 1"
and "pardiso 1" test nothing. PARDISO and PyAMG are omitted if not installed.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import time
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core import Diffusion, Hierarchy, Mesh, evolve, samples
from agglo_core.multigrid import pcg
from agglo_core.problems import Solution
from agglo_core.solvers.backends import BACKENDS
from agglo_core.solvers.direct import Direct
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.solver.earlier_solutions import best_combination
from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid


class Amg:
    """Conjugate gradients with smoothed aggregation of PyAMG, as a solver with repeated solves."""

    def __init__(self, degree: int, tolerance: float, *, linear: bool) -> None:
        self.discretisation, self.tolerance, self.linear = PolyDG(degree), tolerance, linear

    def solve(self, problem: Diffusion, hierarchy: Hierarchy) -> Solution:
        """Solve one problem."""
        return self.repeated(hierarchy).solve(problem)

    def repeated(self, hierarchy: Hierarchy) -> AmgSteps:
        """Return the solver for all steps."""
        assert hierarchy.fine is not None
        return AmgSteps(self, hierarchy.fine)


class AmgSteps:
    """PyAMG's levels for the last matrix."""

    def __init__(self, solver: Amg, mesh: Mesh) -> None:
        self.solver, self.mesh, self.earlier = solver, mesh, list[np.ndarray]()

    def solve(self, problem: Diffusion, *, load: Any = 0.0) -> Solution:
        """Set up PyAMG and solve."""
        import pyamg

        start, how = time.process_time(), self.solver.discretisation
        self.fine = how.fine_system(problem, self.mesh)
        basis = [lambda x: np.ones(len(x)), *((lambda x, k=k: x[:, k]) for k in range(self.mesh.dim))]
        near = [how.project(self.mesh, f) for f in basis[: 3 if self.solver.linear else 1]]
        matrix = sparse.csr_matrix(self.fine.A).tobsr(self.fine.A.blocksize)
        matrix.indices, matrix.indptr = (each.astype(np.int32) for each in (matrix.indices, matrix.indptr))
        levels = pyamg.smoothed_aggregation_solver(matrix, B=np.stack(near, axis=1))
        self.M = levels.aspreconditioner()
        return self._solve(load, {"setup": time.process_time() - start})

    def solve_again(self, load: Any) -> Solution:
        """Solve with the last matrix."""
        return self._solve(load, {})

    def _solve(self, load: Any, spent: dict[str, float]) -> Solution:
        start, fine, tolerance = time.process_time(), self.fine.with_load(load), self.solver.tolerance
        x = best_combination(fine.A, fine.b, self.earlier) if self.earlier else None
        measure = fine.measure
        found = pcg(
            fine.A, fine.b, self.M, x, tolerance=tolerance, most=1000, stop="both", probe=False,
            measure=measure, energy=measure.energy,
        )  # fmt: skip
        self.earlier = [*self.earlier[-7:], found.x]
        spent["solve"] = time.process_time() - start
        return Solution(
            x=found.x, A=fine.A, b=fine.full, operators=[], residuals=found.residuals,
            converged=found.converged, reason=found.reason, iterations=found.iterations,
            seconds={}, cpu_seconds=spent,
        )  # fmt: skip


class Factors(Amg):
    """One solve per step with the factors of SuperLU or PARDISO, without estimate of the error."""

    def __init__(self, degree: int, backend: str) -> None:
        super().__init__(degree, 0.0, linear=False)
        self.backend = backend

    def repeated(self, hierarchy: Hierarchy) -> FactorSteps:
        """Return the solver for all steps."""
        assert hierarchy.fine is not None
        return FactorSteps(self, hierarchy.fine)


class FactorSteps(AmgSteps):
    """Factors of the last matrix."""

    def solve(self, problem: Diffusion, *, load: Any = 0.0) -> Solution:
        """Factorise and solve."""
        start = time.process_time()
        self.fine = self.solver.discretisation.fine_system(problem, self.mesh)
        self.M = BACKENDS[self.solver.backend](self.fine.A)
        return self._solve(load, {"setup": time.process_time() - start})

    def _solve(self, load: Any, spent: dict[str, float]) -> Solution:
        start, fine = time.process_time(), self.fine.with_load(load)
        x = self.M(fine.b)
        spent["solve"] = time.process_time() - start
        return Solution(
            x=x, A=fine.A, b=fine.full, operators=[], residuals=np.zeros(2), converged=True,
            reason="not tested", iterations=1, seconds={}, cpu_seconds=spent,
        )  # fmt: skip


SOLVERS: Mapping[str, Callable[[int, float], Any]] = {
    "polydg_mg": lambda p, tolerance: PolyDGMultigrid(p, tolerance),
    "superlu": lambda p, tolerance: Direct(p, tolerance, 3, "sharp", scaled_basis=True, backend="superlu"),
    "pardiso": lambda p, tolerance: Direct(p, tolerance, 3, "sharp", scaled_basis=True, backend="pardiso"),
    "superlu 1": lambda p, _: Factors(p, "superlu"),
    "pardiso 1": lambda p, _: Factors(p, "pardiso"),
    "PyAMG": lambda p, tolerance: Amg(p, tolerance, linear=False),
    "PyAMG 1": lambda p, tolerance: Amg(p, tolerance, linear=True),
}
_WARM = 10  # first steps, not counted


class Tissue:
    """Reaction of FitzHugh and Nagumo, with the recovery variable at each point."""

    def __init__(self, step: float) -> None:
        self.step, self.w, self.seconds = step, 0.0, 0.0

    def __call__(self, t: float, points: Any, u: Any) -> Any:
        """Return the current, and advance the recovery variable."""
        start = time.process_time()
        current = u * (1.0 - u) * (u - 0.1) - self.w
        self.w = self.w + self.step * 0.01 * (0.5 * u - self.w)
        self.seconds += time.process_time() - start
        return current


def row(mesh: Mesh, degree: int, name: str, options: argparse.Namespace) -> str:
    """Return the formatted figures of a solver."""
    problem = Diffusion(kappa=options.kappa, source=0.0, neumann={0: 0.0})
    tissue, solver = Tissue(options.step), SOLVERS[name](degree, options.tolerance)
    end = options.steps * options.step
    states = evolve(
        mesh, problem, lambda x: np.where(x[:, 0] < 0.2, 1.0, 0.0), end, options.step, options.scheme,
        reaction=tissue, solver=solver,
    )  # fmt: skip
    setup, counts, start = 0.0, list[int](), 0.0
    for k, (_, solution) in enumerate(states):
        phases = solution.cpu_seconds
        setup += sum(seconds for phase, seconds in phases.items() if phase != "solve")
        counts.append(solution.iterations)
        if k + 1 == _WARM:
            start, tissue.seconds = time.process_time(), 0.0
    n = len(counts) - _WARM
    each, react = (1e3 * seconds / n for seconds in (time.process_time() - start, tissue.seconds))
    return f"{setup:8.2f}{np.mean(counts[_WARM:]):12.1f}{each:8.0f}{react:8.1f}{solution.integral():12.6f}"


def main() -> None:
    """Read the arguments and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, nargs="+", default=[16_384])
    parser.add_argument("--degrees", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--step", type=float, default=0.2)
    parser.add_argument("--kappa", type=float, default=1e-3)
    parser.add_argument("--scheme", default="cn")
    parser.add_argument("--solvers", nargs="+", choices=SOLVERS, default=list(SOLVERS))
    parser.add_argument("--tolerance", type=float, default=1e-6)
    options = parser.parse_args()
    needed = {"pardiso": "pypardiso", "pardiso 1": "pypardiso", "PyAMG": "pyamg", "PyAMG 1": "pyamg"}
    names = [name for name in options.solvers if name not in needed or find_spec(needed[name])]
    heads = f"{'set-up':>8}{'iterations':>12}{'ms':>8}{'react':>8}{'∫ u':>12}"
    print(f"{'cells':>7}{'p':>3} {'solver':<10}{heads}")
    for cells in options.cells:
        mesh = samples.voronoi(cells, seed=0)
        for degree in options.degrees:
            for name in names:
                found = row(mesh, degree, name, options)
                print(f"{mesh.n_cells:>7}{degree:>3} {name:<10}{found}", flush=True)


if __name__ == "__main__":
    main()
