"""Measure the effect of part shapes on solvers: errors, conditioning and iterations next to METIS k-way.

    python tests/benchmarks/solver_shapes.py [--cells N ...] [--per-part N ...] [--seeds N] [--penalty P]
    python tests/benchmarks/solver_shapes.py --tried
    python tests/benchmarks/solver_shapes.py --times
    python tests/benchmarks/solver_shapes.py --balance
    python tests/benchmarks/solver_shapes.py --objective

On random meshes, at equal numbers of parts. On the coarse mesh: L2 and DG errors for u = sin πx sin πy by
PolyDG of degree 1 and 2, and the condition number of its matrix scaled by block Jacobi (up to 800 unknowns).
On the mesh itself: fractional iterations to 1e-8 with two levels, by the default solver, the default solver
with its recipe ``patches``, and the paper's solver with inherited operators. E is the k-means energy, L the
interface length. Geometric means over the meshes, divided by those of METIS k-way (contiguous, weights of
cells and faces, the better of two imbalances per figure). ``--tried`` compares other interface weights in
the polish, and further polishes, without iterations; ``--times`` prints CPU seconds relative to METIS k-way;
``--balance`` shows parts with equal numbers of cells; ``--objective`` the objective F and the CPU seconds of
the efforts, by number of parts and by size, and other constants of their starts.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import logging
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.sparse.linalg import spsolve

import agglo_core as agglo
from agglo_core import Mesh, samples
from agglo_core.anneal import solver_parts
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.hierarchy import Hierarchy
from agglo_core.problems import Diffusion
from agglo_core.refine.compactness import refiner as compactness
from agglo_core.registry import default
from agglo_kmeans import kmeans, lattice
from agglo_polydg_mg.forms.assembly import discretise
from agglo_polydg_mg.forms.norms import errors
from agglo_polydg_mg.space.basis import Basis

Labels = NDArray[np.int64]

SINE = Diffusion(
    source=lambda x: 2 * np.pi**2 * np.sin(np.pi * x[:, 0]) * np.sin(np.pi * x[:, 1]),
    exact=lambda x: np.sin(np.pi * x[:, 0]) * np.sin(np.pi * x[:, 1]),
)
UNIT = Diffusion(source=1.0)
BARE: Mapping[str, Any] = {"method": "kway", "refiners": (), "polish": False, "balance": "measure"}
METHODS: dict[str, Mapping[str, Any]] = {
    "METIS k-way, 3 %": {"bisector": ("metis", {"ufactor": 30}), **BARE},
    "METIS k-way, 30 %": {"bisector": ("metis", {"ufactor": 300}), **BARE},
    "METIS recursive": {"bisector": ("metis", {"algorithm": "recursive"}), **BARE},
    "kmeans": {"bisector": "kmeans"},
    "kmeans k-way": {"bisector": "kmeans", "method": "kway"},
    "effort quick": {"bisector": ("kmeans", {"effort": "quick"}), "method": "kway"},
    "effort fast": {"bisector": ("kmeans", {"effort": "fast"}), "method": "kway"},
    "effort good": {"bisector": ("kmeans", {"effort": "good"}), "method": "kway"},
    "effort best": {"bisector": ("kmeans", {"effort": "best"}), "method": "kway"},
}
_AGAIN = ("compactness", "compactness")
TRIED: dict[str, tuple[Mapping[str, Any], float]] = {
    "kmeans": ({}, 0.3),
    "weight .2": ({}, 0.2),
    "weight .1": ({}, 0.1),
    "twice": ({"post_refiners": _AGAIN}, 0.3),
    "weight .2, twice": ({"post_refiners": _AGAIN}, 0.2),
    "weight .1, thrice": ({"post_refiners": (*_AGAIN, "compactness")}, 0.1),
    "k-way": ({"method": "kway"}, 0.3),
    "k-way, .2, twice": ({"method": "kway", "post_refiners": _AGAIN}, 0.2),
    "kmeans, no polish": ({"polish": False}, 0.3),
}
"""Options of a run, and the interface weight in its polish."""
STARTS: dict[str, tuple[Any, str, Any]] = {
    "quick, 1 shift": (lattice, "_SHIFTS", (0.0,)),
    "quick, 5 shifts": (lattice, "_SHIFTS", (0.0, 0.125, 0.25, 0.375, 0.5)),
    "quick, no Lloyd step": (kmeans, "_LATTICE_STEPS", 0),
    "quick, 4 Lloyd steps": (kmeans, "_LATTICE_STEPS", 4),
    "quick, filled less": (solver_parts, "_FILLED", {2: 0.36, 3: 0.10}),
    "quick, filled more": (solver_parts, "_FILLED", {2: 0.44, 3: 0.13}),
}
"""Other constants of the starts: module, name and value. The last two only affect sizes."""
RIVALS = ("METIS k-way, 3 %", "METIS k-way, 30 %")
SOLVERS: dict[str, tuple[str, Mapping[str, Any]]] = {
    "default": ("polydg_mg", {}),
    "patches": ("polydg_mg", {"recipe": "patches"}),
    "paper": ("polydg_mg_paper", {"operators": "inherited"}),
}
MOST_UNKNOWNS = 800  # maximum number of unknowns for a condition number by all eigenvalues


def perturbed_squares(cells: int, seed: int) -> Mesh:
    """Return squares with inner points displaced by up to 0.3 sides."""
    n = round(cells**0.5)
    mesh, rng = samples.squares(n), np.random.default_rng(seed)
    inside = ((mesh.points > 1e-9) & (mesh.points < 1 - 1e-9)).all(axis=1)
    return replace(
        mesh, points=mesh.points + inside[:, None] * rng.uniform(-0.3 / n, 0.3 / n, mesh.points.shape)
    )


FAMILIES: dict[str, Callable[[int, int], Mesh]] = {
    "Voronoi": lambda cells, seed: samples.voronoi(cells, seed=seed),
    "random triangles": lambda cells, seed: samples.random_triangles(cells // 2, seed=seed),
    "perturbed squares": perturbed_squares,
}


def condition(A: Any, width: int) -> float:
    """Return the condition number of a matrix with blocks of ``width`` unknowns, scaled by its diagonal
    blocks.
    """
    dense = A.toarray()
    starts = range(0, len(dense), width)
    blocks = [np.linalg.cholesky(dense[i : i + width, i : i + width]) for i in starts]
    L = scipy.linalg.block_diag(*blocks)
    half = scipy.linalg.solve_triangular(L, dense, lower=True)
    values = np.linalg.eigvalsh(scipy.linalg.solve_triangular(L, half.T, lower=True))
    return float(values[-1] / values[0])


def iterations(mesh: Mesh, labels: Labels, solver: str, tolerance: float = 1e-8) -> float:
    """Return the fractional number of two-level iterations until the residual reaches the tolerance."""
    name, options = SOLVERS[solver]
    hierarchy = Hierarchy(mesh, mesh.graph, [labels], [{}], nested=True)
    tool = default().build("solver", name, degree=1, tolerance=tolerance, **options)
    residuals = np.asarray(tool.solve(UNIT, hierarchy).residuals)
    fallen = np.log(residuals / residuals[0])
    last = int(np.argmax(fallen <= np.log(tolerance))) or len(fallen) - 1
    return float(last - 1 + (np.log(tolerance) - fallen[last - 1]) / (fallen[last] - fallen[last - 1]))


def figures(mesh: Mesh, labels: Labels, penalty: Any, solvers: bool) -> dict[str, float]:
    """Return all figures of a partition."""
    found = {"E": OBJECTIVES["compactness"].value(mesh.graph, labels)}
    found["L"] = OBJECTIVES["interface"].value(mesh.graph, labels)
    coarse = mesh.coarsen(labels)
    for degree in (1, 2):
        system = discretise(coarse, degree, SINE, penalty=penalty, scaled_basis=True)
        basis = Basis(coarse, degree, True)
        error = errors(basis, spsolve(system.A.tocsc(), system.b), SINE, penalty=penalty)
        found |= {f"L2 p{degree}": error.l2, f"DG p{degree}": error.dg}
        if len(system.b) <= MOST_UNKNOWNS:
            found[f"cond p{degree}"] = condition(system.A, basis.n_local)
    for name in SOLVERS if solvers else ():
        found[f"it {name}"] = iterations(mesh, labels, name)
    return found


def partition(mesh: Mesh, parts: int, method: Mapping[str, Any]) -> Labels:
    """Return the labels for this part count."""
    return np.asarray(agglo.agglomerate(mesh, n_parts=parts, **method).levels[0])


@contextmanager
def replaced(module: Any, name: str, value: Any) -> Iterator[None]:
    """Replace a constant of a module for a while."""
    kept = getattr(module, name)
    setattr(module, name, value)
    try:
        yield
    finally:
        setattr(module, name, kept)


def weighed(mesh: Mesh, parts: int, tried: tuple[Mapping[str, Any], float]) -> Labels:
    """Return the labels with another interface weight in the polish."""
    method, weight = tried
    with replaced(compactness, "SHORTNESS", weight):
        return partition(mesh, parts, method)


def compared(
    meshes: list[Mesh],
    methods: Mapping[str, Callable[[Mesh, int], Labels]],
    per_part: int,
    penalty: Any,
    solvers: bool,
) -> dict[str, dict[str, float]]:
    """Return geometric means of all figures by method, relative to METIS k-way."""
    logs: dict[str, dict[str, float]] = {}
    for name, method in methods.items():
        found = []
        for mesh in meshes:
            labels = method(mesh, mesh.n_cells // per_part)
            found.append(figures(mesh, labels, penalty, solvers))
        logs[name] = {key: float(np.mean([np.log(each[key]) for each in found])) for key in found[0]}
    best = {key: min(logs[rival][key] for rival in RIVALS) for key in logs[RIVALS[0]]}
    return {name: {key: float(np.exp(row[key] - best[key])) for key in row} for name, row in logs.items()}


def show(title: str, rows: dict[str, dict[str, float]]) -> None:
    """Print a table of ratios."""
    keys = list(next(iter(rows.values())))
    print(f"\n{title}\n{'':<18}{''.join(f'{key:>11}' for key in keys)}")
    for name, row in rows.items():
        print(f"{name:<18}{''.join(f'{row[key]:11.3f}' for key in keys)}", flush=True)


def show_times(seeds: int) -> None:
    """Print CPU seconds relative to METIS k-way."""
    print(f"{'cells':<26}{''.join(f'{name:>20}' for name in METHODS)}")
    for cells in (4_000, 100_000):
        for family, make in FAMILIES.items():
            taken: dict[str, list[float]] = {name: [] for name in METHODS}
            for seed in range(seeds):
                mesh = make(cells, seed)
                _ = mesh.graph
                for name, method in METHODS.items():
                    start = time.process_time()
                    partition(mesh, mesh.n_cells // 16, method)
                    taken[name].append(time.process_time() - start)
            rival = min(float(np.median(taken[name])) for name in RIVALS)
            ratios = "".join(f"{np.median(each) / rival:20.3f}" for each in taken.values())
            print(f"{family + ' ' + str(cells):<26}{ratios}", flush=True)


def show_objective(seeds: int) -> None:
    """Print F and CPU seconds for 16 cells per part, and parts for a size, over METIS recursive or k-way."""
    fresh = int(np.random.SeedSequence().generate_state(1)[0]) % 10**6
    efforts = {name: method for name, method in METHODS.items() if not name.startswith("METIS k-way")}
    families: dict[str, list[Mesh]] = {
        name: [make(2_000, fresh + seed) for seed in range(seeds)] for name, make in FAMILIES.items()
    }
    families |= {"brain": [samples.brain()], "brain with holes": [samples.brain_holes()]}
    families["random tetrahedra"] = [samples.random_tetrahedra(350, fresh + seed) for seed in range(seeds)]
    print("F, CPU seconds over METIS recursive; parts for a size over k-way with merging, and their F")
    for family, meshes in families.items():
        print(family)
        rows: dict[str, list[tuple[float, ...]]] = {}
        for mesh in meshes:
            parts, size = mesh.n_cells // 16, 2.0 * (16.0 * mesh.graph.measures.mean()) ** (1 / mesh.dim)
            merged = agglo.agglomerate(mesh, h_star=size, method="kway", merge=True).parts[0]
            for name, method in (efforts | dict.fromkeys(STARTS, METHODS["effort quick"])).items():
                with replaced(*STARTS[name]) if name in STARTS else nullcontext():
                    start = time.process_time()
                    labels = partition(mesh, parts, method)
                    seconds = time.process_time() - start
                    sized = (
                        labels
                        if "METIS" in name
                        else agglo.agglomerate(mesh, h_star=size, **method).levels[0]
                    )
                values = [OBJECTIVES["solver"].value(mesh.graph, each) for each in (labels, sized)]
                rows.setdefault(name, []).append((values[0], seconds, (sized.max() + 1) / merged, values[1]))
        rival = np.mean(rows["METIS recursive"], axis=0)[1]
        for name, row in rows.items():
            F, seconds, count, sized_F = np.mean(row, axis=0)
            by_size = "" if "METIS" in name else f"{count:10.3f}{sized_F:9.4f}"
            print(f"  {name:<24}{F:9.4f}{seconds / rival:9.2f}{by_size}", flush=True)


def show_balance(seeds: int) -> None:
    """Print the objective ``solver`` and the part sizes for equal numbers of cells."""
    fresh = int(np.random.SeedSequence().generate_state(1)[0]) % 10**6
    print(f"{'cells, parts, tolerance; method':<56}{'F':>9}{'least':>9}{'most':>9}{'CPU s':>9}")
    for parts, tolerance in ((256, 0.0), (64, 0.0), (64, 0.05)):
        even = {"tolerance": tolerance}
        good = {"effort": "good"}
        # Methods that balance the numbers of cells.
        ways: dict[str, Mapping[str, Any]] = {
            "METIS": {
                "bisector": ("metis", {"ufactor": max(1, round(1000 * tolerance))}),
                **BARE,
                "balance": "cells",
            },
            "k-way, balance": {"method": "kway", "post_refiners": ["compactness", ("balance", even)]},
            "k-way, balance, fm": {"method": "kway", "post_refiners": [("balance", even), ("fm", even)]},
            "good, no balance": {"method": "kway", "bisector": ("kmeans", good)},
            "good, balance": {"method": "kway", "bisector": ("kmeans", {**good, "balance": tolerance})},
        }
        ways["METIS"]["bisector"][1]["vertex_weights"] = False
        # Average objective, part sizes and seconds over random meshes.
        for name, way in ways.items():
            rows = []
            for seed in range(seeds):
                mesh = samples.voronoi(4096, seed=fresh + seed)
                _ = mesh.graph
                start = time.process_time()
                labels = partition(mesh, parts, way)
                taken, cells = time.process_time() - start, np.bincount(labels)
                rows.append((OBJECTIVES["solver"].value(mesh.graph, labels), cells.min(), cells.max(), taken))
            title = f"Voronoi 4096, {parts}, {tolerance}; {name}"
            print(f"{title:<56}{''.join(f'{x:9.3f}' for x in np.mean(rows, axis=0))}", flush=True)


def main() -> None:
    """Read the arguments and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, nargs="+", default=[1000, 4000])
    parser.add_argument("--per-part", type=int, nargs="+", default=[16, 64])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--penalty", default="sharp", help="sharp, paper or a number")
    parser.add_argument("--no-solvers", action="store_true", help="leave out the iterations")
    parser.add_argument("--tried", action="store_true", help="other weights and polishes")
    parser.add_argument("--balance", action="store_true", help="print balanced parts alone")
    parser.add_argument("--objective", action="store_true", help="print F, seconds and parts by size alone")
    parser.add_argument("--times", action="store_true", help="print the times alone")
    options = parser.parse_args()
    logging.getLogger("agglo").setLevel(logging.ERROR)
    for method in METHODS.values():
        partition(samples.squares(8), 4, method)  # compiles
    if options.balance:
        show_balance(options.seeds)
        return
    if options.times:
        show_times(options.seeds)
        return
    if options.objective:
        show_objective(options.seeds)
        return
    methods = {name: partial(partition, method=METHODS[name]) for name in METHODS}
    if options.tried:
        methods = {name: methods[name] for name in RIVALS}
        methods |= {name: partial(weighed, tried=TRIED[name]) for name in TRIED}
    penalty = options.penalty if options.penalty in ("sharp", "paper") else float(options.penalty)
    solvers = not (options.no_solvers or options.tried)
    fresh = int(np.random.SeedSequence().generate_state(1)[0]) % 10**6
    for name, make in FAMILIES.items():
        for cells in options.cells:
            meshes = [make(cells, fresh + seed) for seed in range(options.seeds)]
            for per_part in options.per_part:
                rows = compared(meshes, methods, per_part, penalty, solvers)
                show(f"{name}, {cells} cells, {per_part} in a part, {len(meshes)} meshes", rows)


if __name__ == "__main__":
    main()
