"""Compare the default solver in 3-D with the better method of PyAMG, alternately in one process.

    python tests/benchmarks/solid_ratios.py [--meshes NAME ...] [--cells N ...] [--degrees P ...]
                                            [--repeats N]

CPU seconds for setup and solve to 1e-10, one thread, best alternating repeat, so that other load on the
machine has the least effect. PyAMG is smoothed aggregation on the matrix in blocks and on single unknowns,
both with the constants.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import warnings
from typing import Any

import numpy as np
from solve import amg
from solve_cases import MESHES, SOLID, problem_on

from agglo_core import Hierarchy
from agglo_core.registry import default

TOLERANCE = 1e-10


def ratios(name: str, cells: int, degree: int, repeats: int) -> None:
    """Print the line of a mesh."""
    # Problem, solver and matrix.
    mesh = MESHES[name](cells)
    problem, hierarchy = problem_on(name, mesh), Hierarchy(mesh, mesh.graph, [], [], nested=True)
    tool = default().build("solver", "polydg_mg", degree=degree, tolerance=TOLERANCE)
    how = tool.discretisation
    system, near = (
        how.assemble(problem, mesh),
        how.project(mesh, lambda points: np.ones(len(points)))[:, None],
    )
    widths = {"blocks": system.A.shape[0] // mesh.n_cells, "single": 1}
    own: dict[str, Any] = {}
    rivals = dict.fromkeys(widths, np.inf)
    # Alternate between the solver and both variants of PyAMG.
    for _ in range(repeats):
        solution = tool.solve(problem, hierarchy)
        phases = solution.cpu_seconds
        seconds = [phases.get("hierarchy", 0.0) + phases["setup"], phases["solve"]]
        if not own or sum(seconds) < sum(own["seconds"]):
            own = {"seconds": seconds, "iterations": solution.iterations, "memory": solution.memory}
        for which, width in widths.items():
            row = amg(system.A, system.b, width, near, TOLERANCE)
            rivals[which] = min(rivals[which], row["setup"] + row["solve"])
    # Print seconds, ratios and memory relative to the matrix.
    total, data = sum(own["seconds"]), system.A.data.nbytes
    print(
        f"{name:<12}{mesh.n_cells:>7}{degree:>3}{own['iterations']:>5}{own['seconds'][0]:>9.3f}"
        f"{own['seconds'][1]:>8.3f}{total / rivals['blocks']:>9.2f}{total / rivals['single']:>8.2f}"
        f"{total / min(rivals.values()):>8.2f}{own['memory'] / data - 1.0:>9.2f}",
        flush=True,
    )


def main() -> None:
    """Read the arguments and print a line per mesh, size and degree."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--meshes", nargs="+", choices=SOLID, default=["tetrahedra", "boxes", "solids"])
    parser.add_argument("--cells", type=int, nargs="+", default=[4_096, 16_000])
    parser.add_argument("--degrees", type=int, nargs="+", default=[1])
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    warnings.filterwarnings("ignore", message="Having less target vectors")
    print(
        f"{'mesh':<12}{'cells':>7}{'p':>3}{'its':>5}{'set-up':>9}{'solve':>8}{'/blocks':>9}{'/single':>8}",
        end="",
    )
    print(f"{'/best':>8}{'memory':>9}  (above the matrix, of its size)")
    for name in options.meshes:
        for cells in options.cells:
            for degree in options.degrees:
                ratios(name, cells, degree, options.repeats)


if __name__ == "__main__":
    main()
