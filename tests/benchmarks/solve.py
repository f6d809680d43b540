"""Compare solvers with direct solvers and algebraic multigrid: iterations, CPU seconds, memory.

    python tests/benchmarks/solve.py [--solver NAME[:opt=val,…]] [--cells N ...] [--degrees P ...]
                                     [--meshes NAME ...] [--solvers NAME ...] [--hierarchy BISECTOR]
                                     [--tolerance T] [--repeats N]

PolyDG for −∇·(κ∇u) = 8 on the unit square, or on the unit cube for 3-D meshes (omitted unless named). One
thread, process CPU seconds, best repeat after a warm-up at the same degree. All solvers use the same mesh;
direct solvers and PyAMG use the matrix of the solver under test. ``set-up`` is factorisation, hierarchy and
levels; solvers of agglo make levels themselves, or use given levels with mean sizes of 8, 64, 512, … cells
(the paper's solver, and with ``--hierarchy``); assembly is separate. ``1e-6`` and ``1e-10`` are iterations
to these tolerances by the test of each solver; seconds are for ``--tolerance``. ``ratio`` is set-up plus
solve, relative to the best direct solver on the same mesh. ``MB`` is peak memory growth by assembly and
solve, with each solver in its own process; ``error`` is the true ‖b − A x‖ / ‖b‖. PARDISO and PyAMG are
omitted if not installed. Losses are included.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from math import comb
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import cg
from solve_cases import MESHES, SOLID, problem_on

from agglo_core import AggloError, Hierarchy, Mesh, agglomerate
from agglo_core.cli.options.specs import parse_spec
from agglo_core.problems import Diffusion
from agglo_core.registry import default
from agglo_core.solvers.backends import BACKENDS

Row = dict[str, Any]
PAPER = "polydg_mg_paper"
MOST = 3000  # maximum number of PyAMG iterations
PLANE = [name for name in MESHES if name not in SOLID]


def clocked(call: Callable[[], Any]) -> tuple[float, Any]:
    """Return CPU seconds and result for a call."""
    start = time.process_time()
    result = call()
    return time.process_time() - start, result


def memory() -> float:
    """Return the peak process memory in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def size_of(A: Any, b: Any, x: Any) -> float:
    """Return the true relative residual."""
    return float(np.linalg.norm(b - A @ x) / np.linalg.norm(b))


def direct(name: str, A: Any, b: Any) -> Row:
    """Factorise and solve."""
    setup, solves = clocked(lambda: BACKENDS[name](A))
    solve, x = clocked(lambda: solves(b))
    return {"loose": 1, "tight": 1, "setup": setup, "solve": solve, "error": size_of(A, b, x)}


def amg(A: Any, b: Any, block: int, near: Any, tolerance: float) -> Row:
    """Solve by conjugate gradients with smoothed aggregation of PyAMG, in blocks with the constants."""
    import pyamg

    # Convert the matrix and set up the levels.
    matrix = sparse.csr_matrix(A)
    matrix = matrix.tobsr((block, block)) if block > 1 else matrix
    matrix.indices, matrix.indptr = (each.astype(np.int32) for each in (matrix.indices, matrix.indptr))
    setup, levels = clocked(lambda: pyamg.smoothed_aggregation_solver(matrix, B=near))
    # Iterate to both tolerances.
    counts, seconds, x = {}, {}, b
    for wanted in (1e-6, 1e-10):
        steps: list[int] = []
        M = levels.aspreconditioner()

        def run(wanted: float = wanted, M: Any = M, steps: list[int] = steps) -> Any:
            return cg(matrix, b, rtol=wanted, maxiter=MOST, M=M, callback=lambda _: steps.append(1))[0]

        seconds[wanted], found = clocked(run)
        counts[wanted] = len(steps) if len(steps) < MOST else None
        x = found if wanted == tolerance else x
    return {
        "loose": counts[1e-6],
        "tight": counts[1e-10],
        "setup": setup,
        "solve": seconds[tolerance],
        "error": size_of(A, b, x),
    }


def own(spec: str, problem: Diffusion, hierarchy: Hierarchy, degree: int, tolerance: float) -> Row:
    """Run a solver component."""
    name, options = parse_spec(spec)
    counts: dict[float, int | None] = {}

    def solved(wanted: float) -> Any:
        tool = default().build("solver", name, **{"degree": degree, "tolerance": wanted, **options})
        it = tool.solve(problem, hierarchy)
        counts[wanted] = it.iterations if it.converged else None
        return it

    solved(1e-6 if tolerance == 1e-10 else 1e-10)  # its arrays are freed before the measured run
    it = solved(tolerance)
    phases = it.cpu_seconds
    return {
        "loose": counts[1e-6],
        "tight": counts[1e-10],
        "assemble": phases.get("assemble", 0.0),
        "setup": phases.get("hierarchy", 0.0) + phases.get("setup", 0.0),
        "solve": phases.get("solve", 0.0),
        "error": size_of(it.A, it.b, it.x),
        "unconverged": "" if it.converged else it.reason,
    }


def measured(case: Row) -> Row:
    """Measure a solver on a mesh, for a ``case`` from :func:`main`."""
    rows = []
    for cells in (400, *[case["cells"]] * case["repeats"]):
        mesh = MESHES[case["mesh"]](cells)
        before = memory()
        row = one(case, mesh, problem_on(case["mesh"], mesh))
        rows.append(row | {"memory": memory() - before})
    best = min(rows[1:], key=lambda row: float(row["setup"] + row["solve"]))
    return best | {"memory": max(row["memory"] for row in rows[1:])}


def one(case: Row, mesh: Mesh, problem: Diffusion) -> Row:
    """Run a solver once on a mesh."""
    name, degree = case["solver"], case["degree"]
    unknowns = mesh.n_cells * comb(degree + mesh.dim, mesh.dim)
    size = {"cells": mesh.n_cells, "unknowns": unknowns}
    if name not in BACKENDS and name != "pyamg":
        grown, hierarchy = clocked(lambda: levels_for(case, mesh))
        row = own(name, problem, hierarchy, degree, case["tolerance"])
        return row | size | {"setup": row["setup"] + grown}
    judged, options = parse_spec(case["judged"])
    how = default().build("solver", judged, **{"degree": degree, **options}).discretisation
    assemble, system = clocked(lambda: how.assemble(problem, mesh))
    if name in BACKENDS:
        row = direct(name, system.A, system.b)
    else:
        near = how.project(mesh, lambda points: np.ones(len(points)))[:, None]
        row = amg(system.A, system.b, unknowns // mesh.n_cells, near, case["tolerance"])
    return row | size | {"assemble": assemble}


def levels_for(case: Row, mesh: Mesh) -> Hierarchy:
    """Return a hierarchy without levels for solvers that make their own, unless levels are requested."""
    bisector = case["hierarchy"]
    if bisector is None and not case["solver"].startswith(PAPER):
        return Hierarchy(mesh, mesh.graph, [], [], nested=True)
    sizes = [8**k for k in range(1, 8) if mesh.n_cells / 8**k >= 8] or [2]
    return agglomerate(mesh, bisector=bisector or "kmeans", cells_per_part=sizes)


def in_a_process(case: Row) -> Row:
    """Measure a case in a child process, whose memory is that of the solver.

    An error gives a row.
    """
    command = [sys.executable, __file__, "--case", json.dumps(case)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        return {"failed": (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]}
    answer: Row = json.loads(done.stdout.splitlines()[-1])
    return answer


def table(name: str, degree: int, rows: Mapping[str, Row]) -> None:
    """Print the rows for a mesh and degree."""
    # The fastest direct solver is the reference of ratios.
    known = [row for row in rows.values() if "failed" not in row]
    direct_times = [
        rows[each]["setup"] + rows[each]["solve"]
        for each in BACKENDS
        if each in rows and "failed" not in rows[each]
    ]
    best = min(direct_times, default=np.nan)
    if known:
        print(f"\n{name}, {known[0]['cells']} cells, p = {degree}, {known[0]['unknowns']} unknowns")
    print(
        f"{'':26}{'1e-6':>6}{'1e-10':>7}{'assemble':>10}{'set-up':>9}{'solve':>9}{'ratio':>8}{'MB':>7}"
        f"{'error':>10}"
    )
    for solver, row in rows.items():
        if "failed" in row:
            print(f"{solver[:25]:26}{row['failed']}")
            continue
        counts = ["–" if row[key] is None else row[key] for key in ("loose", "tight")]
        print(
            f"{solver[:25]:26}{counts[0]:>6}{counts[1]:>7}{row['assemble']:10.3f}{row['setup']:9.3f}"
            f"{row['solve']:9.3f}{(row['setup'] + row['solve']) / best:8.2f}{row['memory']:7.0f}"
            f"{row['error']:10.1e}  {row.get('unconverged', '')}".rstrip(),
            flush=True,
        )


def installed() -> list[str]:
    """Return the other solvers that are installed."""
    packages = {"pardiso": "pypardiso", "superlu": "scipy", "pyamg": "pyamg"}
    return [*[name for name, package in packages.items() if find_spec(package)], PAPER]


def answer(case: Row) -> None:
    """Print the row of a case as JSON.

    An error of agglo gives a row.
    """
    try:
        row = measured(case)
    except AggloError as error:
        row = {"failed": " ".join(str(error).split())}
    print(json.dumps(row))


def main() -> None:
    """Read the arguments and print a table per mesh, size and degree."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--solver", default="polydg_mg", help="the component that is judged")
    parser.add_argument("--cells", type=int, nargs="+", default=[4_096, 16_384])
    parser.add_argument("--degrees", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--meshes", nargs="+", choices=MESHES, default=PLANE)
    parser.add_argument("--solvers", nargs="*", default=None, help="rivals (default: all installed)")
    parser.add_argument("--hierarchy", metavar="BISECTOR", help="levels for the solvers of agglo")
    parser.add_argument("--tolerance", type=float, choices=(1e-6, 1e-10), default=1e-10)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--case", type=json.loads, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.case is not None:
        answer(options.case)
        return
    rivals = installed() if options.solvers is None else options.solvers
    for cells in options.cells:
        for name in options.meshes:
            for degree in options.degrees:
                case = {"mesh": name, "cells": cells, "degree": degree}
                how_long = {
                    "judged": options.solver,
                    "hierarchy": options.hierarchy,
                    "tolerance": options.tolerance,
                    "repeats": options.repeats,
                }
                solvers = dict.fromkeys([*rivals, options.solver])
                table(
                    name, degree, {each: in_a_process(case | how_long | {"solver": each}) for each in solvers}
                )


if __name__ == "__main__":
    main()
