"""Count iterations of a solver for tensors, reaction, convection and boundary data, as a table.

    python tests/benchmarks/elliptic.py [--cells N] [--degrees P ...] [--meshes NAME ...] [--rows PART]
        [--solver NAME]

f = 1 on the unit square, or x − 1/2 with Neumann data alone; u = 0 on the boundary unless the row names other
data. Tensors have the eigenvalues 1 and ε, the first along an angle: constant, or varying over the square, or
random in each cell. Péclet numbers are h / κ with the mean cell size h. Iterations from 0 to a relative
residual of 1e-6 and, without convection, an equal energy error; ``–`` if 300 do not suffice.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np

import agglo_core as agglo
from agglo_core import Mesh, samples
from agglo_core.arrays import Float
from agglo_core.problems import Diffusion

MESHES: dict[str, Callable[[int], Mesh]] = {
    "voronoi": lambda n: samples.voronoi(n, seed=0),
    "squares": lambda n: samples.squares(round(np.sqrt(n))),
    "random": lambda n: samples.random_triangles(n, seed=0),
}

FLOWS: dict[str, Any] = {
    "(1, 0.3)": np.array([1.0, 0.3]),
    "(−y, x)": lambda x: np.stack((-x[:, 1], x[:, 0]), axis=1),
    "(1/2 − y, x − 1/2)": lambda x: np.stack((0.5 - x[:, 1], x[:, 0] - 0.5), axis=1),
}


def tensors(angle: Float, epsilon: float) -> Float:
    """Return tensors with the eigenvalues 1 and ε, the first along an angle."""
    axis = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    return np.asarray(epsilon * np.eye(2) + (1.0 - epsilon) * axis[..., :, None] * axis[..., None, :])


def problems(mesh: Mesh) -> dict[str, Diffusion]:
    """Return the problems by name."""
    found = {"Poisson": Diffusion()}
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
    h = mesh.cell_measures.mean() ** 0.5
    for name, b in FLOWS.items():
        for peclet in (0.1, 1.0, 10.0, 1e2, 1e3, 1e4):
            found[f"Péclet {peclet:g}, b = {name}"] = Diffusion(h / peclet, convection=b)
    found["Neumann alone"] = Diffusion(source=lambda points: points[:, 0] - 0.5, neumann={0: 0.0})
    return found


def count(mesh: Mesh, problem: Diffusion, degree: int, solver: str) -> str:
    """Return the number of iterations, or a dash."""
    solution = agglo.solve(mesh, problem, solver=solver, degree=degree, max_iterations=300)
    return str(solution.iterations) if solution.converged else "–"


def main() -> None:
    """Print one table per mesh."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--cells", type=int, default=4096)
    parser.add_argument("--degrees", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--meshes", nargs="+", default=["voronoi", "squares"], choices=list(MESHES))
    parser.add_argument("--rows", default="", help="part of the names of the rows")
    parser.add_argument("--solver", default="polydg_mg")
    arguments = parser.parse_args()
    for name in arguments.meshes:
        mesh = MESHES[name](arguments.cells)
        print(f"\n| {mesh.n_cells} {name} | {' | '.join(f'p = {p}' for p in arguments.degrees)} |")
        print("|---" * (1 + len(arguments.degrees)) + "|")
        chosen = {key: value for key, value in problems(mesh).items() if arguments.rows in key}
        for title, problem in chosen.items():
            counts = [count(mesh, problem, degree, arguments.solver) for degree in arguments.degrees]
            print(f"| {title} | {' | '.join(counts)} |", flush=True)


if __name__ == "__main__":
    main()
