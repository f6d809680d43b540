"""Compare linear solves with algebraic multigrid and a direct solver: iterations and CPU seconds.

    python tests/benchmarks/linear.py [--unknowns N] [--seeds S ...] [--matrices NAME ...] [--repeats R]

Scalar finite-volume and finite-element matrices with a random right-hand side, solved by conjugate gradients
to a relative residual of 1e-8. Preconditioners: ``ours`` (classical levels, one sweep before and one after
the correction), ``labels`` (one classical step, then the mesh agglomerates as aggregates), ``aggregates``
(smoothed aggregation from the matrix graph), both methods of PyAMG with default options (two sweeps before
and two after), and PARDISO. One thread, CPU seconds, the best repeat after a warm-up; agglomeration is not
included for ``labels``. ``bar`` is our iteration count over the better method of PyAMG, ``time`` our seconds
over the faster method; values above 1 are losses. PyAMG and PARDISO are omitted if not installed.
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
from collections.abc import Callable, Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import cg

sys.path.insert(0, str(Path(__file__).parents[1]))

from flux_matrices import bilinear_elements, five_points, linear_elements, two_point_flux, two_valued

from agglo_core import Mesh, agglomerate, samples
from agglo_core.multigrid import aggregation_stack, classical_stack, cycle
from agglo_core.solvers.backends import BACKENDS

MOST = 300
Matrix = sparse.csr_array
Labels = list[np.ndarray]
Case = tuple[str, Callable[[], tuple[Matrix, Labels]]]


def side(n: int) -> int:
    """Return the cells per side in a square grid."""
    return max(4, round(np.sqrt(n)))


def labels_of(mesh: Mesh, size: int) -> Labels:
    """Return agglomerates of ``size``, 8 · ``size`` and 64 · ``size`` cells."""
    return list(agglomerate(mesh, cells_per_part=(size, 8 * size, 64 * size)).levels)


def fluxes(mesh: Mesh, kappa: np.ndarray) -> tuple[Matrix, Labels]:
    """Return a two-point flux matrix and labels."""
    return two_point_flux(mesh, kappa), labels_of(mesh, 8)


def elements(mesh: Mesh) -> tuple[Matrix, Labels]:
    """Return a matrix of linear elements, and labels.

    A vertex belongs to the agglomerate of its first triangle.
    """
    A, inner = linear_elements(mesh)
    corners = mesh.boundary_loops.vertices.reshape(-1, 3)
    found = []
    for labels in labels_of(mesh, 16):
        of_vertex = np.empty(len(mesh.points), np.int64)
        of_vertex[corners[::-1].ravel()] = np.repeat(labels[::-1], 3)
        found.append(np.unique(of_vertex[inner], return_inverse=True)[1])
    return A, found


def cases(n: int, seed: int) -> Iterator[Case]:
    """Yield names of matrices and functions that build them."""
    rng = np.random.default_rng(seed)
    m = side(n)
    for name, mesh in (("squares", samples.squares(m)), ("voronoi", samples.voronoi(n, seed))):
        cells = mesh.n_cells
        checks = np.floor(mesh.cell_centroids * 8).astype(int).sum(axis=1) % 2
        wild = 10.0 ** rng.uniform(-3, 3, cells)
        for how, kappa in (
            ("1", np.ones(cells)),
            ("checks", np.where(checks, 1e6, 1.0)),
            ("1e±3", wild),
            ("1 or 1e6", two_valued(cells, seed)),
        ):
            yield f"{name}, κ {how}", lambda mesh=mesh, kappa=kappa: fluxes(mesh, kappa)
    grid = samples.squares(m)
    for ratio in (1e-3, 1e-6):
        yield (
            f"five-point, 1 : {ratio:g}",
            lambda ratio=ratio: (five_points(m, 1.0, ratio), labels_of(grid, 8)),
        )
    for name, widths in (("", np.ones(m + 1)), (", columns", 10.0 ** rng.uniform(-0.5, 0.5, m + 1))):
        heights = np.full(m + 1, 1e-3)
        yield (
            f"Q1, 1 : 0.001{name}",
            lambda widths=widths, heights=heights: (bilinear_elements(widths, heights), labels_of(grid, 8)),
        )
    yield "P1 on a grid", lambda: elements(samples.triangles(m))
    yield "P1 on random points", lambda: elements(samples.random_triangles(n, seed=seed))


def clocked(call: Callable[[], Any]) -> tuple[float, Any]:
    """Return CPU seconds and result for a call."""
    start = time.process_time()
    result = call()
    return time.process_time() - start, result


def amg(method: str) -> Callable[[Matrix, Labels], Any]:
    """Return a method of PyAMG with default options."""
    import pyamg

    def made(A: Matrix, labels: Labels) -> Any:
        matrix = sparse.csr_matrix(A)
        matrix.indices, matrix.indptr = (each.astype(np.int32) for each in (matrix.indices, matrix.indptr))
        return getattr(pyamg, method)(matrix).aspreconditioner()

    return made


def makers() -> dict[str, Callable[[Matrix, Labels], Any]]:
    """Return the preconditioners by name."""
    found: dict[str, Callable[[Matrix, Labels], Any]] = {
        "ours": lambda A, labels: cycle(classical_stack(A)),
        "labels": lambda A, labels: cycle(classical_stack(A, labels=labels)),
        "aggregates": lambda A, labels: cycle(aggregation_stack(A)),
    }
    if find_spec("pyamg"):
        found |= {"pyamg RS": amg("ruge_stuben_solver"), "pyamg SA": amg("smoothed_aggregation_solver")}
    return found


def iterated(make: Callable[[Matrix, Labels], Any], A: Matrix, labels: Labels, b: np.ndarray) -> list[float]:
    """Return iterations (inf without convergence), and CPU seconds of setup and solve."""
    seen: list[int] = []
    setup, M = clocked(lambda: make(A, labels))
    solve, (x, failed) = clocked(
        lambda: cg(A, b, rtol=1e-8, maxiter=MOST, M=M, callback=lambda _: seen.append(0))
    )
    wrong = failed or np.linalg.norm(b - A @ x) > 1e-6 * np.linalg.norm(b)
    return [np.inf if wrong else len(seen), setup, solve]


def direct(A: Matrix, b: np.ndarray) -> list[float]:
    """Return CPU seconds of factorisation and solve with PARDISO."""
    setup, solves = clocked(lambda: BACKENDS["pardiso"](A))
    solve, _ = clocked(lambda: solves(b))
    return [1, setup, solve]


def row(A: Matrix, labels: Labels, b: np.ndarray, repeats: int) -> dict[str, list[float]]:
    """Return the best alternating repeat for every method."""
    runs = {name: lambda make=make: iterated(make, A, labels, b) for name, make in makers().items()}
    if find_spec("pypardiso"):
        runs["pardiso"] = lambda: direct(A, b)
    best: dict[str, list[float]] = {}
    for _ in range(repeats):
        for name, run in runs.items():
            found = run()
            if name not in best or sum(found[1:]) < sum(best[name][1:]):
                best[name] = found
    return best


def printed(name: str, n: int, found: Mapping[str, list[float]]) -> None:
    """Print one line of the table."""
    rivals = [values for rival, values in found.items() if rival.startswith("pyamg")]
    cells = []
    for values in found.values():
        count = "none" if np.isinf(values[0]) else f"{values[0]:.0f}"
        cells.append(f"{count:>5} {values[1]:.3f}+{values[2]:.3f}")
    line = f"{name:22}{n:>7} |" + " |".join(cells)
    if rivals:
        bar = found["ours"][0] / min(values[0] for values in rivals)
        spent = sum(found["ours"][1:]) / min(sum(values[1:]) for values in rivals)
        line += f" |{bar:6.2f}{spent:6.2f}"
    print(line, flush=True)


def main() -> None:
    """Read the arguments and print a table per seed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--unknowns", type=int, default=16_384)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--matrices", nargs="+", default=None, help="beginnings of names")
    parser.add_argument("--repeats", type=int, default=2)
    options = parser.parse_args()
    warnings.simplefilter("ignore")  # from loops in PyAMG
    small = five_points(24, 1.0, 1.0)
    row(small, [np.arange(576) // 8], np.ones(576), 1)  # compiles kernels
    heads = [*makers(), *["pardiso"][: bool(find_spec("pypardiso"))]]
    for seed in options.seeds:
        print(f"\nseed {seed}; iterations, set-up + solve in CPU seconds")
        print(f"{'':22}{'n':>7} |" + " |".join(f"{each:^17}" for each in heads) + " |   bar  time")
        for name, make in cases(options.unknowns, seed):
            if options.matrices and not name.startswith(tuple(options.matrices)):
                continue
            A, labels = make()
            b = np.random.default_rng(seed).standard_normal(A.shape[0])
            printed(name, A.shape[0], row(A, labels, b, options.repeats))


if __name__ == "__main__":
    main()
