"""Measure the effect of tuned constants: run a job with a constant multiplied by several factors.

    python tests/benchmarks/constants.py [NAME ...] [--factors F ...] [--seed N] [--list]

A NAME is part of ``FILE:CONSTANT`` as in ``--list``, by default all of them. The job of the constant runs
in a temporary copy of the sources in which only this constant is changed, once per factor. Counts, errors
and shapes are printed where they change, and the CPU seconds of the job on one thread after a warm-up. A
safeguard or a tolerance for rounding should change nothing. Meshes and matrices are random, see ``--seed``.

- ``agglomerate``: score J · L^0.3 and number of parts, for runs with rules, metrics and lines.
- ``measure``: seconds and the sum of the metrics of polygons and solids.
- ``matrices``: iterations and measured error of solves with algebraic levels; "-" if not converged.
- ``errors``: seconds and error norms of PolyDG solutions, and samples for pictures.
- ``threads``: wall seconds of two threads for shape metrics and PolyDG matrices, and their largest entry.
- ``build``: faces of solids whose faces do not match.
- ``ranks``: score and number of parts of a distributed run, on one rank.
- ``train``, ``train solids``: cut relative to 2-means of a briefly trained network.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import ast
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
FACTORS = (0.25, 4.0)

CONSTANTS: Mapping[str, tuple[str, ...]] = {
    "agglomerate": (
        "agglo_core/split/piece_growth.py:_ROOM",
        "agglo_core/refine/descent.py:_FLOOR",
        "agglo_core/agglomeration/levels/lines.py:STRONG",
        "agglo_core/agglomeration/rules/members.py:_TIE",
        "agglo_core/agglomeration/rules/parts.py:_ROUNDS",
        "plugins/agglo_spectral/modes.py:_BATCH",
        "plugins/agglo_spectral/modes.py:_SWEEPS",
    ),
    "measure": (
        "agglo_core/shapes/balls.py:_LISTED",
        "agglo_core/shapes/circle.py:_MANY",
        "agglo_core/shapes/solid_boxes.py:_TIES",
    ),
    "matrices": (
        "agglo_core/multigrid/coarse_solve.py:_SHIFT",
        "agglo_core/multigrid/coarsening/classical.py:_FULL",
        "agglo_core/multigrid/coarsening/classical.py:_NEGATIVE",
        "agglo_core/multigrid/coarsening/classical.py:_MANY",
        "agglo_core/multigrid/krylov/column.py:_CONJUGATE",
        "agglo_core/multigrid/krylov/column.py:_LOST",
        "agglo_core/multigrid/krylov/column.py:_DIGIT",
        "agglo_core/multigrid/krylov/column.py:_DRIFT",
        "agglo_core/multigrid/krylov/column.py:_LUCK",
        "agglo_core/multigrid/krylov/column.py:_STILL",
        "agglo_core/multigrid/krylov/lanczos.py:_FLAT",
        "agglo_core/multigrid/krylov/lanczos.py:_NULL",
        "agglo_core/multigrid/krylov/look_ahead.py:_AHEAD",
        "agglo_core/multigrid/krylov/stopping.py:_MORE",
        "agglo_core/multigrid/krylov/stopping.py:_FALL",
        "agglo_core/multigrid/smoothers/additive_schwarz.py:_DENSE",
        "agglo_core/multigrid/smoothers/additive_schwarz.py:_MOST_STEPS",
        "agglo_core/problems/residuals/backward_error.py:_TWO_DIGITS",
        "agglo_core/problems/residuals/row_scales.py:_ALIKE",
        "agglo_core/problems/residuals/row_scales.py:_PENALTY",
        "agglo_core/problems/residuals/stiff_springs.py:_STIFF",
        "agglo_core/problems/residuals/stiff_springs.py:_STEP",
        "agglo_core/problems/residuals/stiff_springs.py:_WEAK",
        "agglo_core/problems/residuals/stiff_springs.py:_LEFT",
        "agglo_core/problems/residuals/stiff_springs.py:_MOST",
        "agglo_core/problems/residuals/stiff_springs.py:_FEW",
        "agglo_core/problems/residuals/stiff_springs.py:_SAMPLE",
        "agglo_core/problems/residuals/stiff_springs.py:_HIDDEN",
    ),
    "errors": (
        "plugins/agglo_polydg_mg/forms/jump_operator.py:_FACES",
        "agglo_core/fields/errors.py:_STEP",
        "agglo_core/fields/rules.py:_POINTS",
        "agglo_core/fields/location.py:_TRIANGLES",
        "agglo_core/fields/location.py:_INSIDE",
    ),
    "threads": (
        "agglo_core/threads.py:COSTLY",
        "agglo_core/shapes/solid_shapes.py:_FEW",
    ),
    "build": (
        "agglo_core/mesh/construction/touching.py:_CHUNK",
        "agglo_core/mesh/construction/touching.py:_LIFT",
        "agglo_core/mesh/construction/touching.py:_LAID",
    ),
    "ranks": (
        "agglo_core/distributed/agglomeration/levels.py:_NODES_PER_PART",
        "agglo_core/distributed/agglomeration/levels.py:_CELLS_PER_NODE",
        "agglo_core/distributed/agglomeration/levels.py:_FEWEST_CELLS",
        "agglo_core/distributed/agglomeration/levels.py:_FEW_NODES",
        "agglo_core/distributed/agglomeration/levels.py:_SIZES_PER_PART",
    ),
    "train": (
        "plugins/agglo_gnn/training/loop.py:_BATCH",
        "plugins/agglo_gnn/training/loop.py:_RATE",
        "plugins/agglo_gnn/training/loop.py:_WARM_UP",
        "plugins/agglo_gnn/training/loop.py:_SIZE_POWER",
        "plugins/agglo_gnn/training/loop.py:BALANCE",
        "plugins/agglo_gnn/training/loop.py:COMPACT",
        "plugins/agglo_gnn/training/loop.py:GROWTH",
        "plugins/agglo_gnn/training/pieces.py:FEWEST",
        "plugins/agglo_gnn/training/pieces.py:_MOST",
    ),
    "train solids": ("plugins/agglo_gnn/space/pieces.py:_MOST",),
}
"""Constants by the job that measures their effect, as file and name."""

Figures = Iterator[tuple[str, str, float]]


def value_of(source: str, name: str) -> tuple[int, int]:
    """Return the start and end of the value that a module assigns to a name, in bytes.

    Raises
    ------
    KeyError
        If the module assigns no value to the name.
    """
    starts = [0]
    for line in source.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    for node in ast.parse(source).body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        value: Any = getattr(node, "value", None)
        for target in targets:
            names = target.elts if isinstance(target, ast.Tuple) else [target]
            values = value.elts if isinstance(target, ast.Tuple) else [value]
            for each, part in zip(names, values, strict=True):
                if isinstance(each, ast.Name) and each.id == name and part is not None:
                    first, last = starts[part.lineno - 1], starts[part.end_lineno - 1]
                    return first + part.col_offset, last + part.end_col_offset
    raise KeyError(f"no constant {name}")


def scaled(source: str, name: str, factor: float) -> str:
    """Return the source of a module with a constant multiplied by a factor; integers are at least 1."""
    first, last = value_of(source, name)
    text = source.encode()
    old = text[first:last].decode()
    new = f"type({old})(max(1, round(({old}) * {factor})) if isinstance({old}, int) else ({old}) * {factor})"
    return (text[:first] + new.encode() + text[last:]).decode()


# Jobs, which run in the copy


def agglomerate(seed: int) -> Figures:
    """Agglomerate random meshes with rules."""
    import numpy as np

    import agglo_core as agglo
    from agglo_core import samples
    from agglo_core.graph.objectives import OBJECTIVES

    plane, solids = samples.voronoi(4000, seed=seed), samples.random_tetrahedra(700, seed=seed)
    stretched = plane.points * (1.0, 0.02)
    loops = plane.boundary_loops
    flat = agglo.Mesh.from_polygons(stretched, (loops.loop_offsets, loops.vertices))
    regions = np.floor(4.0 * plane.cell_centroids[:, 0]).astype(np.int64)
    runs: dict[str, tuple[Any, dict[str, Any]]] = {
        "plain": (plane, {}),
        "solids": (solids, {}),
        "spectral": (plane, {"bisector": "spectral"}),
        "descent": (plane, {"refiners": ("descent",), "polish": False}),
        "lines": (flat, {"lines": True}),
        "regions": (plane, {"regions": regions, "method": "kway"}),
        "balance": (plane, {"balance": "measure"}),
        "bounds": (plane, {"max_cells": 20, "min_cells": 10}),
    }
    for name, (mesh, how) in runs.items():
        agglo.agglomerate(mesh, n_parts=mesh.n_cells // 16, **how)
        start = time.process_time()
        labels = agglo.agglomerate(mesh, n_parts=mesh.n_cells // 16, **how).levels[0]
        seconds = time.process_time() - start
        J, L = (OBJECTIVES[key].value(mesh.graph, labels) for key in ("compactness", "interface"))
        yield name, f"{J * L**0.3:.5g}, {labels.max() + 1} parts", seconds


def measure(seed: int) -> Figures:
    """Measure random parts, ragged parts and solid parts."""
    import numpy as np

    import agglo_core as agglo
    from agglo_core import samples

    plane, solids = samples.voronoi(40_000, seed=seed), samples.tetrahedra(20)
    parts = {
        "round": (plane, agglo.agglomerate(plane, cells_per_part=16).levels[0]),
        "large": (plane, agglo.agglomerate(plane, cells_per_part=4000).levels[0]),
        "strips": (plane, np.floor(200 * plane.cell_centroids[:, 0]).astype(np.int64)),
        "solids": (solids, agglo.agglomerate(solids, cells_per_part=32).levels[0]),
    }
    for name, (mesh, labels) in parts.items():
        metrics = ("UF", "CR", "box_ratio")
        agglo.quality(mesh, labels, metrics=metrics)
        mesh = mesh.coarsen(labels)
        start = time.process_time()
        values = agglo.quality(mesh, np.arange(mesh.n_cells), metrics=metrics)
        seconds = time.process_time() - start
        yield name, f"{sum(each.sum() for each in values.values()):.9g}", seconds


def matrices(seed: int) -> Figures:
    """Solve stiff, scaled, singular and graded systems."""
    import numpy as np
    from scipy import sparse
    from scipy.sparse.linalg import LinearOperator, cg

    sys.path.insert(0, str(Path(__file__).parents[1]))
    from flux_matrices import five_points, linear_elements, truss, two_point_flux, two_valued

    import agglo_core as agglo
    from agglo_core import samples
    from agglo_core.multigrid import additive_schwarz
    from agglo_core.multigrid.coarse_solve import direct_solver
    from agglo_core.multigrid.krylov.look_ahead import conjugate_gradients
    from agglo_core.multigrid.krylov.pcg import pcg

    rng = np.random.default_rng(seed)
    mesh = samples.random_triangles(3000, seed=seed)
    n = mesh.n_cells
    one = np.ones(n)
    plain = two_point_flux(mesh, one)
    units = sparse.diags_array(2.0 ** rng.integers(0, 4, n))
    pairs = mesh.face_cells[(mesh.face_cells[:, 1] >= 0) & (rng.random(len(mesh.face_cells)) < 0.02)]
    ends = np.concatenate((one[: len(pairs)], -one[: len(pairs)]))
    springs = sparse.csr_array((ends, (np.tile(np.arange(len(pairs)), 2), pairs.T.ravel())), (len(pairs), n))
    penalised = sparse.diags_array(np.where(rng.random(n) < 0.02, 1e8, 0.0))
    elements = linear_elements(samples.random_triangles(4000, seed=seed))[0]
    free, motions = truss(2000, seed)
    systems: dict[str, tuple[Any, dict[str, Any]]] = {
        "plain": (plain, {}),
        "contrast": (two_point_flux(mesh, two_valued(n, seed)), {}),
        "no Dirichlet": (two_point_flux(mesh, one, dirichlet=False), {}),
        "almost none": (two_point_flux(mesh, one, dirichlet=False) + 1e-9 * sparse.eye_array(n), {}),
        "units": (units @ plain @ units, {}),
        "graded rows": (five_points(60, 1.0, 1e-4), {}),
        "elements": (elements, {}),
        "truss": (free + 1e-6 * sparse.eye_array(free.shape[0]), {"near_null": motions}),
        "penalties": (plain + penalised, {}),
        **{
            f"springs {stiffness:.0e}": (plain + stiffness * springs.T @ springs, {})
            for stiffness in (1e4, 1e7, 1e10)
        },
    }
    for name, (A, how) in systems.items():
        A = sparse.csr_array(A)
        exact = rng.standard_normal(A.shape[0])
        b = A @ (exact - exact.mean() if name == "no Dirichlet" else exact)
        start = time.process_time()
        found = agglo.build_levels(A, **how).solve(b, tolerance=1e-8)
        seconds = time.process_time() - start
        error = found.x - exact
        energy = np.sqrt(max(error @ (A @ error), 0.0) / (exact @ (A @ exact)))
        yield name, f"{found.iterations}, {_error(energy, found.converged)}", seconds
    exact = rng.standard_normal(n)
    rough = sparse.diags_array(1.0 / (plain.diagonal() * rng.uniform(1.0, 1.5, n)))
    twisted = [rough + twist * sparse.triu(rough @ plain @ rough, 1) for twist in (0.02, 0.5, 2.0)]
    noisy = LinearOperator((n, n), lambda r: rough @ r * rng.uniform(0.7, 1.3))
    rivals = dict(zip(("unsymmetric", "more", "most"), twisted, strict=True))
    for name, M in {"diagonal": rough, "noisy": noisy, **rivals}.items():
        history = pcg(plain, plain @ exact, M, tolerance=1e-8, most=3000)
        error = history.x - exact
        energy = np.sqrt(error @ (plain @ error) / (exact @ (plain @ exact)))
        yield name, f"{history.iterations}, {_error(energy, history.converged)}", 0.0
    plain_cg = conjugate_gradients(plain, plain @ exact, tolerance=1e-8)
    yield "no levels", str(plain_cg.iterations), 0.0
    free = two_point_flux(mesh, one, dirichlet=False)
    load = free @ exact
    left = load - free @ direct_solver(free, dense=100)(load)
    yield "singular", f"{np.linalg.norm(left) / np.linalg.norm(load):.1e}", 0.0
    labels = agglo.agglomerate(mesh, cells_per_part=100).levels[0]
    start, steps = time.process_time(), [0]
    M = additive_schwarz(plain, None, labels)
    cg(plain, plain @ exact, rtol=1e-8, M=M, callback=lambda _: steps.append(0))
    yield "Schwarz", str(len(steps) - 1), time.process_time() - start


def _error(value: float, converged: bool) -> str:
    return f"{value:.1e}" if converged else "-"


def errors(seed: int) -> Figures:
    """Solve a problem with a known solution, measure its errors and sample it."""
    import numpy as np

    import agglo_core as agglo
    from agglo_core import samples
    from agglo_core.problems import Diffusion

    def wave(x: Any) -> Any:
        return np.prod(np.sin(np.pi * x), axis=1)

    for name, mesh in {"plane": samples.voronoi(3000, seed=seed), "solids": samples.tetrahedra(8)}.items():
        problem = Diffusion(source=lambda x, d=mesh.dim: d * np.pi**2 * wave(x), exact=wave)
        solution = agglo.solve(mesh, problem, degree=2)
        start = time.process_time()
        norms = solution.discretisation.errors(problem, mesh, solution.x)
        text = " ".join(f"{value:.5e}" for value in norms.values())
        points = np.random.default_rng(seed).uniform(0.01, 0.99, (2000, mesh.dim))
        values = solution.discretisation.evaluate(mesh, solution.x, points)
        seconds = time.process_time() - start
        yield name, f"{text}, {np.abs(values - wave(points)).max():.3e}", seconds


def threads(seed: int) -> Figures:
    """Measure shapes and assemble PolyDG matrices of small and large meshes with two threads."""
    import numpy as np

    import agglo_core as agglo
    from agglo_core import samples
    from agglo_core.registry import default

    metrics, polydg = ("convexity", "CR"), default().build("discretisation", "polydg", degree=1)
    for n in (500, 5000):
        for name, mesh in {
            "triangles": samples.random_triangles(n, seed=seed),
            "solids": samples.random_tetrahedra(n // 4, seed=seed),
        }.items():
            for _ in range(2):  # the first compiles kernels
                mesh = mesh.renumbered(np.arange(mesh.n_cells))  # without derived quantities
                start = time.perf_counter()
                with agglo.using_threads(2):
                    values = agglo.quality(mesh, np.arange(mesh.n_cells), metrics=metrics)
                    A = polydg.assemble(agglo.Diffusion(source=1.0), mesh).A
                seconds = time.perf_counter() - start
            sizes = [float(each.mean()) for each in values.values()] + [float(abs(A).max())]
            yield f"{name} {mesh.n_cells}", " ".join(f"{size:.9g}" for size in sizes), seconds


def build(seed: int) -> Figures:
    """Join boxes whose faces do not match, with warped faces between them."""
    import numpy as np

    import agglo_core as agglo
    from agglo_core.mesh.elements import polyhedra_from_elements

    rng = np.random.default_rng(seed)

    def block(n: int, low: float, warp: float) -> tuple[Any, Any]:
        x, y, z = np.meshgrid(*(np.linspace(0, 1, n + 1),) * 3, indexing="ij")
        bump = warp * x * y
        corners = np.arange((n + 1) ** 3).reshape(x.shape)
        a = corners[:-1, :-1, :-1].ravel()
        step = np.array([0, (n + 1) ** 2, (n + 1) ** 2 + n + 1, n + 1])
        cells = a[:, None] + np.concatenate((step, step + 1))
        points = np.stack((x, y, z + low + bump), axis=-1).reshape(-1, 3)
        return points, cells

    for name, (fine, coarse, warp) in {
        "2 : 1": (16, 8, 0.1),
        "3 : 1": (24, 8, 0.0),
        "1 : 1": (30, 30, 0.1),
    }.items():
        (p, c), (q, d) = block(fine, 0.0, warp), block(coarse, 1.0, warp)
        order = rng.permutation(len(c) + len(d))
        cells = np.concatenate((c, d + len(p)))[order]
        start = time.process_time()
        solids = polyhedra_from_elements({"hexahedron": cells})
        mesh = agglo.Mesh.from_polyhedra(np.concatenate((p, q)), solids, merge_points=True)
        seconds = time.process_time() - start
        outer = int((mesh.face_cells[:, 1] < 0).sum())
        yield name, f"{len(mesh.face_cells)} faces, {outer} outer", seconds


def ranks(seed: int) -> Figures:
    """Agglomerate a distributed mesh, in domains of 2,000 cells."""
    from agglo_core import Pipeline, samples
    from agglo_core.distributed import DistributedMesh, agglomerate
    from agglo_core.graph.objectives import OBJECTIVES

    mesh = samples.random_triangles(12_000, seed=seed)
    shared = DistributedMesh.scatter(mesh)
    for name, target in {"parts": {"cells_per_part": 400}, "size": {"h_star": 0.4}}.items():
        pipeline = Pipeline(**target)
        agglomerate(shared, pipeline, block_cells=2000)
        start = time.process_time()
        labels = agglomerate(shared, pipeline, block_cells=2000).levels[0]
        seconds = time.process_time() - start
        J, L = (OBJECTIVES[key].value(mesh.graph, labels) for key in ("compactness", "interface"))
        yield name, f"{J * L**0.3:.5g}, {labels.max() + 1} parts", seconds


def train(seed: int) -> Figures:
    """Train the network for polygons for 600 steps."""
    from agglo_gnn.plane.train import train_fast

    yield from _trained(lambda: train_fast(seed, 600, 2000, 3000)[1])


def train_solids(seed: int) -> Figures:
    """Train the network for polyhedra for 300 steps."""
    from agglo_gnn.space.train import train_solids

    yield from _trained(lambda: train_solids(seed, 300, 300, 300)[1])


def _trained(train: Callable[[], Mapping[str, float]]) -> Figures:
    start = time.process_time()
    metrics = train()
    yield (
        "",
        " ".join(f"{name} {metrics[name]:.4f}" for name in ("network", "ratio") if name in metrics),
        (time.process_time() - start),
    )


JOBS: Mapping[str, Callable[[int], Figures]] = {
    "agglomerate": agglomerate,
    "measure": measure,
    "matrices": matrices,
    "errors": errors,
    "threads": threads,
    "build": build,
    "ranks": ranks,
    "train": train,
    "train solids": train_solids,
}


def run(copy: Path, job: str, seed: int) -> dict[str, tuple[str, float]]:
    """Run a job in a copy of the sources, and return its figures by name, or the error."""
    folders = (copy, copy / "plugins")
    keep = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    process = subprocess.run(
        [sys.executable, str(copy / "tests/benchmarks/constants.py"), "--job", job, "--seed", str(seed)],
        env=keep | {"PYTHONPATH": os.pathsep.join(map(str, folders))},
        capture_output=True,
        text=True,
        check=False,
    )
    if process.returncode:
        return {"failed": (process.stderr.strip().splitlines()[-1], 0.0)}
    return {name: (text, seconds) for name, text, seconds in json.loads(process.stdout)}


def main() -> None:
    """Print the figures of each job and factor."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--factors", nargs="+", type=float, default=FACTORS)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--job", choices=JOBS, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.job:
        print(json.dumps(list(JOBS[given.job](given.seed))))
        return
    chosen = [
        (job, each)
        for job, constants in CONSTANTS.items()
        for each in constants
        if not given.names or any(name in each for name in given.names)
    ]
    if given.list:
        print(*(f"{job}: {each}" for job, each in chosen), sep="\n")
        return
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for part in ("agglo_core", "plugins", "tests/benchmarks"):
            shutil.copytree(ROOT / part, copy / part)  # with compiled kernels: only changed ones are compiled
        shutil.copy(ROOT / "tests/flux_matrices.py", copy / "tests")
        unchanged: dict[str, dict[str, tuple[str, float]]] = {}
        for job, each in chosen:
            if job not in unchanged:
                run(copy, job, given.seed)  # compiles kernels
                unchanged[job] = run(copy, job, given.seed)
            before = unchanged[job]
            print(f"\n{each} ({job}): factor 1: {_total(before):.2f} s")
            file, name = each.split(":")
            source = (ROOT / file).read_text(encoding="utf-8")
            for factor in given.factors:
                (copy / file).write_text(scaled(source, name, factor), encoding="utf-8")
                after = run(copy, job, given.seed)
                print(f"  factor {factor:g}: {_total(after):.2f} s")
                for figure, (text, _) in after.items():
                    if text != before.get(figure, ("", 0.0))[0]:
                        print(f"    {figure}: {before.get(figure, ('', 0.0))[0]} -> {text}")
            (copy / file).write_text(source, encoding="utf-8")
            sys.stdout.flush()


def _total(figures: Mapping[str, tuple[str, float]]) -> float:
    return sum(seconds for _, seconds in figures.values())


if __name__ == "__main__":
    main()
