"""Compare elasticity solves with smoothed aggregation of PyAMG: iterations and CPU seconds.

    python tests/benchmarks/elasticity.py [--cells N ...] [--degrees P ...] [--meshes NAME ...] [--poisson NU]

Bodies under their own weight, clamped on the whole boundary, and beams with length 20 and height 1, clamped
at the left and pulled down at the right. Both methods get the system of ``polydg_elasticity`` and its rigid
motions, and iterate to a relative residual of 1e-6, ``agglo`` also to an energy error of 1e-6; PyAMG has
conjugate gradients and the faster of the strengths 0 (its default) and 0.05. One thread, CPU seconds of
set-up and iterations, the better of two runs; ``assembly`` belongs to both. ``time`` is our seconds over
those of PyAMG, ``error`` the energy norm of the error relative to that of the solution. PyAMG is omitted if
not installed.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy import sparse
from scipy.spatial import Voronoi

import agglo_core as agglo
from agglo_core import Elasticity, Mesh, samples

LENGTH = 20.0
HELD, PULLED = 1, 2


def side(n: int, power: int = 2) -> int:
    """Return the cells per side of a mesh with about n cells."""
    return max(2, round(n ** (1 / power)))


def with_ends(mesh: Mesh) -> Mesh:
    """Return a beam with boundary tag 1 at its left end, 2 at its right end, and 0 elsewhere."""
    x, outer = mesh.face_centroids[:, 0], mesh.face_cells[:, 1] < 0
    tags = np.where(outer & (x < 1e-9), HELD, np.where(outer & (x > LENGTH - 1e-9), PULLED, 0))
    return mesh.with_face_tags(boundary=tags)


def square_beam(n: int) -> Mesh:
    """Return a beam of about n squares."""
    rows = max(2, round(np.sqrt(n / LENGTH)))
    columns = round(LENGTH * rows)
    y, x = np.divmod(np.arange((columns + 1) * (rows + 1)), columns + 1)
    j, i = np.divmod(np.arange(columns * rows), columns)
    corner = j * (columns + 1) + i
    cells = np.stack((corner, corner + 1, corner + columns + 2, corner + columns + 1), axis=1)
    points = np.stack((x * LENGTH / columns, y / rows), axis=1)
    return with_ends(Mesh.from_polygons(points, cells, name="beam of squares"))


def voronoi_beam(n: int, seed: int = 1) -> Mesh:
    """Return a beam of n Voronoi cells of random points."""
    rng = np.random.default_rng(seed)
    seeds = rng.random((n, 2)) * (LENGTH, 1.0)
    mirrored = [seeds * (-1, 1), seeds * (-1, 1) + (2 * LENGTH, 0), seeds * (1, -1), seeds * (1, -1) + (0, 2)]
    diagram = Voronoi(np.concatenate([seeds, *mirrored]))
    points = np.clip(diagram.vertices, 0.0, (LENGTH, 1.0))
    cells = []
    for k in range(n):
        region = np.array(diagram.regions[diagram.point_region[k]])
        angle = np.arctan2(*(points[region] - points[region].mean(axis=0)).T[::-1])
        cells.append(region[np.argsort(angle)])
    used, numbers = np.unique(np.concatenate(cells), return_inverse=True)
    ends = np.cumsum([len(cell) for cell in cells])[:-1]
    return with_ends(Mesh.from_polygons(points[used], np.split(numbers, ends), name="beam of Voronoi cells"))


MESHES: dict[str, Callable[[int], Mesh]] = {
    "squares": lambda n: samples.squares(side(n)),
    "voronoi": lambda n: samples.voronoi(n, seed=1),
    "triangles": lambda n: samples.triangles(side(n / 2)),
    "random": lambda n: samples.random_triangles(n // 2, seed=1),
    "beam": square_beam,
    "voronoi beam": voronoi_beam,
    "tetrahedra": lambda n: samples.tetrahedra(side(n / 6, 3)),
    "boxes": lambda n: samples.boxes(side(n, 3)),
    "polyhedra": lambda n: samples.voronoi3d(n),
}


def problem_on(mesh: Mesh, nu: float) -> Elasticity:
    """Return the problem: a beam pulled down at its end, or a body under its own weight."""
    if "boundary" not in mesh.face_tags:
        return Elasticity(poisson=nu, force=(*(0.0,) * (mesh.dim - 1), -1.0))
    return Elasticity(
        poisson=nu,
        displacement={HELD: (0.0,) * mesh.dim},
        traction={PULLED: (*(0.0,) * (mesh.dim - 1), -1.0)},
    )


def pyamg_solve(A: Any, b: Any, motions: Any, theta: float) -> tuple[Any, int, float]:
    """Solve with PyAMG; return the solution, the iterations and the CPU seconds."""
    import pyamg

    blocks, start, residuals = sparse.bsr_matrix(A), time.process_time(), []
    strength = ("symmetric", {"theta": theta})
    levels = pyamg.smoothed_aggregation_solver(blocks, B=motions, strength=strength)
    x = levels.solve(b, tol=1e-6, accel="cg", maxiter=300, residuals=residuals)
    return x, len(residuals) - 1, time.process_time() - start


def row(name: str, n: int, degree: int, nu: float) -> str:
    """Solve one case with both methods, and format the results."""
    mesh = MESHES[name](n)
    problem = problem_on(mesh, nu)
    runs = [agglo.solve(mesh, problem, degree=degree) for _ in range(2)]
    found = runs[-1]
    ours = min(run.cpu_seconds["setup"] + run.cpu_seconds["solve"] for run in runs)
    assembly = min(run.cpu_seconds["assemble"] for run in runs)
    text = f"{name:>13} {mesh.n_cells:>7} {degree:>2} {len(found.x):>8} {assembly:>9.2f}"
    text += f" {found.iterations:>6}{' ' if found.converged else '!'} {ours:>7.2f}"
    if not find_spec("pyamg"):
        return text
    system = found.discretisation.assemble(problem, mesh)
    motions = np.array(system.near_null)
    theirs = [pyamg_solve(system.A, system.b, motions, theta) for theta in (0.0, 0.05) for _ in range(2)]
    x, iterations, seconds = min(theirs, key=lambda each: each[2])
    best = agglo.solve(mesh, problem, degree=degree, tolerance=1e-10).x
    size = np.sqrt(best @ (system.A @ best))
    errors = [np.sqrt(max((y - best) @ (system.A @ (y - best)), 0.0)) / size for y in (found.x, x)]
    return (
        f"{text} {errors[0]:>8.0e} {iterations:>6} {seconds:>7.2f} {errors[1]:>8.0e} {ours / seconds:>6.2f}"
    )


def main() -> None:
    """Print one line per mesh, number of cells and degree."""
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--cells", type=int, nargs="+", default=[4000, 16000])
    options.add_argument("--degrees", type=int, nargs="+", default=[1, 2])
    options.add_argument("--meshes", nargs="+", default=["squares", "voronoi", "beam", "voronoi beam"])
    options.add_argument("--poisson", type=float, default=0.3)
    given = options.parse_args()
    ours = f"{'mesh':>13} {'cells':>7} {'p':>2} {'unknowns':>8} {'assembly':>9} {'agglo':>7} {'s':>7}"
    print(ours, f"{'error':>8} {'PyAMG':>6} {'s':>7} {'error':>8} {'time':>6}")
    for name in given.meshes:
        for n in given.cells:
            for degree in given.degrees:
                print(row(name, n, degree, given.poisson), flush=True)


if __name__ == "__main__":
    main()
