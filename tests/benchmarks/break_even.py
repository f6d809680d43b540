"""Find the problem size below which a direct solver is faster than polydg_mg.

    python tests/benchmarks/break_even.py [--meshes NAME ...] [--cells N ...] [--degrees P ...]
                                          [--backends NAME ...] [--many K] [--most N] [--repeats N] [--seed N]

The tables give the thresholds in ``agglo_core/solvers/advice.py``. −Δu = 8 on the unit square with the same
sharp penalty for all solvers, one thread, process CPU seconds, the best repeat after a warm-up. Assembly is
not counted; setup of the polydg_mg levels, factorisation and refinement are counted. ``ratio`` is polydg_mg
over the direct solver: above 1 the direct solver is faster. ``further`` is the same ratio for one more
right-hand side: an iteration of polydg_mg over a share of a direct solve with several columns. ``ratio k``
is the ratio for ``--many`` right-hand sides, computed from these times. Direct solvers are omitted above
``--most`` unknowns.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1]))  # for the matrices of the tests

from flux_matrices import two_point_flux

from agglo_core import Hierarchy, Mesh, samples
from agglo_core.problems import Diffusion, Linear, Solution
from agglo_core.solvers.backends import BACKENDS, available_backends
from agglo_core.solvers.direct import Direct
from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid

COLUMNS = 8  # right-hand sides per direct solve

MESHES: Mapping[str, Callable[[int, int], Mesh]] = {
    "triangles": lambda n, _: samples.triangles(max(2, round(np.sqrt(n / 2)))),
    "squares": lambda n, _: samples.squares(max(2, round(np.sqrt(n)))),
    "voronoi": lambda n, seed: samples.voronoi(n, seed=seed),
    "random": lambda n, seed: samples.random_triangles(max(8, n // 2), seed=seed),
    "fluxes": lambda n, seed: samples.voronoi(n, seed=seed),
}
"""Meshes by name; ``fluxes`` is a linear system of two-point fluxes between Voronoi cells, without degree."""


def problem_on(name: str, mesh: Mesh) -> Diffusion | Linear:
    """Return the problem for a mesh."""
    if name != "fluxes":
        return Diffusion(source=8.0)
    A = two_point_flux(mesh, np.ones(mesh.n_cells))
    return Linear(A, 8.0 * mesh.cell_measures, np.arange(mesh.n_cells + 1))


@dataclass(frozen=True)
class Row:
    """CPU seconds of one case: for the first solution, and for each further right-hand side."""

    mesh: str
    degree: int
    unknowns: int
    entries: int
    kind: str
    first: Mapping[str, float]
    further: Mapping[str, float]

    def ratio(self, backend: str, count: int = 1) -> float:
        """Return polydg_mg over a direct solver for ``count`` right-hand sides."""
        ours, theirs = (
            self.first[each] + (count - 1) * self.further[each] for each in ("polydg_mg", backend)
        )
        return ours / theirs


def seconds_of(solution: Solution) -> float:
    """Return the CPU seconds of all phases except assembly."""
    assert solution.converged, solution.reason
    return sum(each for name, each in solution.cpu_seconds.items() if name != "assemble")


def measured(name: str, cells: int, degree: int, backends: Sequence[str], how: argparse.Namespace) -> Row:
    """Return one case, as the best repeat."""
    first: dict[str, float] = {}
    further: dict[str, float] = {}
    for repeat in range(how.repeats):
        mesh = MESHES[name](cells, how.seed + repeat)
        problem, plain = problem_on(name, mesh), Hierarchy(mesh, mesh.graph, [], [], nested=True)
        ours = PolyDGMultigrid(degree).solve(problem, plain)
        _keep(first, "polydg_mg", seconds_of(ours))
        _keep(further, "polydg_mg", ours.cpu_seconds["solve"])
        for backend in backends if len(ours.x) <= how.most else ():
            direct = Direct(degree, penalty="sharp", scaled_basis=True, backend=backend)
            theirs = direct.solve(problem, plain)
            _keep(first, backend, seconds_of(theirs))
            solves = BACKENDS[backend](theirs.A)
            columns = np.random.default_rng(0).standard_normal((len(theirs.x), COLUMNS))
            start = time.process_time()
            solves(columns)
            _keep(further, backend, (time.process_time() - start) / COLUMNS)
    kind = "cells" if name in ("triangles", "squares") else "groups"
    kind = "plane" if name == "fluxes" else kind
    return Row(name, degree, len(ours.x), ours.A.nnz, kind, first, further)


def _keep(seconds: dict[str, float], name: str, value: float) -> None:
    seconds[name] = min(value, seconds.get(name, np.inf))


def rows(how: argparse.Namespace, backends: Sequence[str]) -> Iterator[Row]:
    """Yield all cases, smallest first, and print each case."""
    head = "".join(f"{each:>10}{'ratio':>7}{'further':>9}{f'ratio {how.many}':>9}" for each in backends)
    print(f"{'':10} p  unknowns    entries  kind      polydg_mg{head}", flush=True)
    for name in how.meshes:
        for degree in how.degrees if name != "fluxes" else (1,):
            measured(name, 100, degree, backends, argparse.Namespace(**{**vars(how), "repeats": 1}))
            for cells in how.cells:
                row = measured(name, cells, degree, backends, how)
                line = f"{name:10} {degree}{row.unknowns:10,}{row.entries:11,}  {row.kind:8}"
                line += f"{row.first['polydg_mg']:11.3f}"
                for each in backends:
                    if each not in row.first:
                        line += f"{'–':>10}{'–':>7}{'–':>9}{'–':>9}"
                        continue
                    dearer = row.further["polydg_mg"] / row.further[each]
                    line += f"{row.first[each]:10.3f}{row.ratio(each):7.2f}{dearer:9.1f}"
                    line += f"{row.ratio(each, how.many):9.2f}"
                print(line, flush=True)
                yield row


def break_even(cases: Sequence[Row], backend: str, count: int) -> str:
    """Return the number of matrix entries with ratio 1, from a log-log fit over all cases."""
    known = [row for row in cases if backend in row.first]
    if len({row.entries for row in known}) < 2:
        return "–"
    sizes = np.log([row.entries for row in known])
    slope, at_one = np.polyfit(sizes, np.log([row.ratio(backend, count) for row in known]), 1)
    least, most = np.exp([sizes.min(), sizes.max()])
    if slope >= 0.0:
        return "–"
    here = float(np.exp(-at_one / slope))
    return f"< {least:,.0f}" if here < least else f"> {most:,.0f}" if here > most else f"{here:,.0f}"


def main() -> None:
    """Read the arguments, and print the cases and the break-even of each direct solver."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--meshes", nargs="+", choices=MESHES, default=list(MESHES))
    parser.add_argument("--cells", type=int, nargs="+", default=[250, 1_000, 4_000, 16_000])
    parser.add_argument("--degrees", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--backends", nargs="+", choices=BACKENDS, default=available_backends())
    parser.add_argument("--many", type=int, default=10)
    parser.add_argument("--most", type=int, default=200_000)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    how = parser.parse_args()
    cases = list(rows(how, how.backends))
    print(f"\nentries of the matrix at which both take the same time, for 1 | {how.many} right-hand sides")
    for backend in how.backends:
        for kind in dict.fromkeys(row.kind for row in cases):
            mine = [row for row in cases if row.kind == kind]
            few, many = (break_even(mine, backend, count) for count in (1, how.many))
            print(f"{backend:10} {kind:8} {few:>14} | {many:>14}")


if __name__ == "__main__":
    main()
