"""Count iterations of a solver for tensors, reaction, convection and boundary data, as a table.

    python tests/benchmarks/elliptic.py [--cells N] [--degrees P ...] [--meshes NAME ...] [--rows PART]
        [--solver NAME] [--beside pyamg gamg]

f = 1 on the unit square or cube, or x − 1/2 with Neumann data alone; u = 0 on the boundary unless the row
names other data. Tensors have the eigenvalues 1 and ε, the first along an angle: constant, varying over the
square, or random per cell. Péclet numbers are h / κ with the mean cell size h. Iterations from 0 to a
relative residual of 1e-6 and, without convection, an equal energy error; ``–`` if 300 do not suffice.
``--beside`` adds those of conjugate gradients with PyAMG's smoothed aggregation and PETSc's GAMG, without
convection: on the same matrix in blocks, with constants as near-null vector.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

import agglo_core as agglo
from agglo_core import Mesh, samples
from agglo_core.arrays import Float
from agglo_core.multigrid import pcg
from agglo_core.problems import Diffusion

MESHES: dict[str, Callable[[int], Mesh]] = {
    "voronoi": lambda n: samples.voronoi(n, seed=0),
    "squares": lambda n: samples.squares(round(np.sqrt(n))),
    "random": lambda n: samples.random_triangles(n, seed=0),
    "voronoi3d": lambda n: samples.voronoi3d(n, seed=0),
    "tetrahedra": lambda n: samples.random_tetrahedra(n // 5, seed=0),
}
MOST = 300

FLOWS: dict[str, Any] = {
    "(1, 0.3)": np.array([1.0, 0.3]),
    "(−y, x)": lambda x: np.stack((-x[:, 1], x[:, 0]), axis=1),
    "(1/2 − y, x − 1/2)": lambda x: np.stack((0.5 - x[:, 1], x[:, 0] - 0.5), axis=1),
}
FLOWS_3D: dict[str, Any] = {
    "(1, 0.3, −0.2)": np.array([1.0, 0.3, -0.2]),
    "(1/2 − y, x − 1/2, 0.2)": lambda x: np.stack(
        (0.5 - x[:, 1], x[:, 0] - 0.5, np.full(len(x), 0.2)), axis=1
    ),
}


def tensors(angle: Float, epsilon: float) -> Float:
    """Return tensors with the eigenvalues 1 and ε, the first along an angle."""
    axis = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    return np.asarray(epsilon * np.eye(2) + (1.0 - epsilon) * axis[..., :, None] * axis[..., None, :])


def problems(mesh: Mesh) -> dict[str, Diffusion]:
    """Return the problems by name."""
    found, h = {"Poisson": Diffusion()}, mesh.cell_measures.mean() ** (1 / mesh.dim)
    for name, b in (FLOWS if mesh.dim == 2 else FLOWS_3D).items():
        for peclet in (0.1, 1.0, 10.0, 1e2, 1e3, 1e4):
            found[f"Péclet {peclet:g}, b = {name}"] = Diffusion(h / peclet, convection=b)
    if mesh.dim == 3:
        return found
    x, y = mesh.cell_centroids.T
    angles = {
        "constant θ = 0.5": np.full(mesh.n_cells, 0.5),
        "θ = 2x + y": 2.0 * x + y,
        "random θ": np.random.default_rng(0).uniform(0.0, np.pi, mesh.n_cells),
    }
    for epsilon in (1e-2, 1e-4):
        for name, angle in angles.items():
            found[f"ε = {epsilon:g}, {name}"] = Diffusion(tensors(angle, epsilon))
    for c in (1.0, 1e2, 1e4, 1e6, 1e8):
        found[f"reaction {c:g}"] = Diffusion(reaction=c)
    found["Robin, α = 1"] = Diffusion(robin={0: (1.0, 0.0)})
    found["Neumann alone"] = Diffusion(source=lambda points: points[:, 0] - 0.5, neumann={0: 0.0})
    return found


def count(mesh: Mesh, problem: Diffusion, degree: int, solver: str) -> str:
    """Return the number of iterations, or a dash."""
    solution = agglo.solve(mesh, problem, solver=solver, degree=degree, max_iterations=MOST)
    return str(solution.iterations) if solution.converged else "–"


def count_beside(mesh: Mesh, problem: Diffusion, degree: int, made: Callable[[Any, Float], Any]) -> str:
    """Return the number of iterations of conjugate gradients with a preconditioner, or a dash."""
    how = agglo.registry.default().build("discretisation", "polydg", degree=degree)
    fine = how.fine_system(problem, mesh)
    A = sparse.csr_matrix(fine.A).tobsr(fine.A.blocksize)
    A.indices, A.indptr = (each.astype(np.int32) for each in (A.indices, A.indptr))
    M = made(A, how.project(mesh, lambda x: np.ones(len(x))))
    limits: Any = {"most": MOST, "stop": "both", "probe": False}
    history = pcg(fine.A, fine.b, M, **limits, measure=fine.measure, energy=fine.measure.energy)
    return str(history.iterations) if history.converged else "–"


def pyamg(A: Any, near_null: Float) -> Any:
    """Return smoothed aggregation of PyAMG as a preconditioner."""
    from pyamg import smoothed_aggregation_solver

    return smoothed_aggregation_solver(A, B=near_null[:, None]).aspreconditioner()


def gamg(A: Any, near_null: Float) -> Any:
    """Return GAMG of PETSc as a preconditioner."""
    from agglo_petsc.matrices import petsc

    PETSc = petsc()
    matrix = PETSc.Mat().createBAIJ(A.shape, A.blocksize[0], csr=(A.indptr, A.indices, A.data))
    matrix.convert("aij")
    matrix.setBlockSize(A.blocksize[0])
    null = PETSc.Vec().createWithArray(near_null / np.linalg.norm(near_null))
    matrix.setNearNullSpace(PETSc.NullSpace().create(vectors=[null]))
    pc = PETSc.PC().create()
    pc.setOperators(matrix)
    pc.setType("gamg")
    pc.setUp()
    x, b = matrix.createVecs()

    def apply(r: Float) -> Float:
        b.setArray(r)
        pc.apply(b, x)
        return np.array(x.getArray())

    return LinearOperator(A.shape, matvec=apply, dtype=float)


BESIDE: dict[str, tuple[str, Callable[[Any, Float], Any]]] = {
    "pyamg": ("pyamg", pyamg),
    "gamg": ("petsc4py", gamg),
}


def main() -> None:
    """Print one table per mesh."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--cells", type=int, default=4096)
    parser.add_argument("--degrees", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--meshes", nargs="+", default=["voronoi", "squares"], choices=list(MESHES))
    parser.add_argument("--rows", default="", help="part of the names of the rows")
    parser.add_argument("--solver", default="polydg_mg")
    parser.add_argument("--beside", nargs="+", default=[], choices=list(BESIDE))
    arguments = parser.parse_args()
    missing = [name for name in arguments.beside if find_spec(BESIDE[name][0]) is None]
    if missing:
        print(f"skipped, because not installed: {', '.join(missing)}")
    beside = [BESIDE[name][1] for name in arguments.beside if name not in missing]
    for name in arguments.meshes:
        mesh = MESHES[name](arguments.cells)
        print(f"\n| {mesh.n_cells} {name} | {' | '.join(f'p = {p}' for p in arguments.degrees)} |")
        print("|---" * (1 + len(arguments.degrees)) + "|")
        chosen = {key: value for key, value in problems(mesh).items() if arguments.rows in key}
        for title, problem in chosen.items():
            counts = [count(mesh, problem, degree, arguments.solver) for degree in arguments.degrees]
            for made in beside if "Péclet" not in title else []:
                for at, degree in enumerate(arguments.degrees):
                    counts[at] += f", {count_beside(mesh, problem, degree, made)}"
            print(f"| {title} | {' | '.join(counts)} |", flush=True)


if __name__ == "__main__":
    main()
