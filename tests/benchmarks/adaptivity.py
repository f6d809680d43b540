"""Adapted cuts: errors at equal unknowns, effectivity indices, met tolerances, other indicators, time.

python adaptivity.py [equal] [indices] [orders] [tolerances] [headroom] [time] [--cells 12000] [--seed 0]
[--discretisation vem]

The discretisation of ``equal`` is polydg or vem.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise, product
from typing import Any

import numpy as np

import agglo_core as agglo
from agglo_core import Diffusion, Hierarchy, Mesh, samples
from agglo_core.fields.rules import inside
from agglo_core.fields.values import central_differences

Array = Any


def layer(a: float = 60.0, r0: float = 0.7, centre: float = -0.05) -> Diffusion:
    """Arctan layer of width 1/a on a circle with radius r0."""

    def u(x: Array) -> Array:
        return np.arctan(a * (np.linalg.norm(x - centre, axis=1) - r0))

    def f(x: Array) -> Array:
        r = np.linalg.norm(x - centre, axis=1)
        s = a * (r - r0)
        return -((x.shape[1] - 1) * a / (r * (1 + s * s)) - 2 * a * a * s / (1 + s * s) ** 2)

    return Diffusion(source=f, dirichlet={0: u}, exact=u)


def corner() -> Diffusion:
    """u = r^(2/3) sin(2φ/3) on the L-shape with its re-entrant corner at 0."""

    def u(x: Array) -> Array:
        angle = np.mod(np.arctan2(x[:, 1], x[:, 0]), 2.0 * np.pi)
        return np.linalg.norm(x, axis=1) ** (2.0 / 3.0) * np.sin(2.0 * angle / 3.0)

    return Diffusion(source=0.0, dirichlet={0: u}, exact=u)


def smooth() -> Diffusion:
    """u = sin(3x) exp(y)."""

    def u(x: Array) -> Array:
        return np.sin(3.0 * x[:, 0]) * np.exp(x[:, 1])

    return Diffusion(source=lambda x: 8.0 * u(x), dirichlet={0: u}, exact=u)


def wave_and_peak(random: np.random.Generator) -> Diffusion:
    """Random sine wave with a random Gaussian peak, and a random constant κ."""
    wave, shift, kappa = random.uniform(2, 9, 2), random.uniform(0, 6), 10.0 ** random.uniform(-3, 3)
    peak, width = random.uniform(0, 1, 2), 10.0 ** random.uniform(1, 2.5)

    def u(x: Array) -> Array:
        return np.sin(x @ wave + shift) + np.exp(-width * ((x - peak) ** 2).sum(axis=1))

    def f(x: Array) -> Array:
        r = ((x - peak) ** 2).sum(axis=1)
        return kappa * (
            wave @ wave * np.sin(x @ wave + shift) - (4 * width**2 * r - 4 * width) * np.exp(-width * r)
        )

    return Diffusion(kappa, f, {0: u}, exact=u)


def on_squares(mesh: Mesh) -> Diffusion:
    """r^α g(φ) around a cross point at which κ is 161.4476 and 1, with α = 0.1 (B. Kellogg, 1975)."""
    alpha, rho, shift, kappa = 0.1, np.pi / 4.0, -14.92256510455152, 161.4476387975881

    def u(x: Array) -> Array:
        x = x - 0.5
        phi, r = np.mod(np.arctan2(x[:, 1], x[:, 0]), 2.0 * np.pi), np.linalg.norm(x, axis=1)
        quarters = (
            np.cos((np.pi / 2.0 - shift) * alpha) * np.cos((phi - np.pi / 2.0 + rho) * alpha),
            np.cos(rho * alpha) * np.cos((phi - np.pi + shift) * alpha),
            np.cos(shift * alpha) * np.cos((phi - np.pi - rho) * alpha),
            np.cos((np.pi / 2.0 - rho) * alpha) * np.cos((phi - 1.5 * np.pi - shift) * alpha),
        )
        return r**alpha * np.choose(np.minimum(phi // (np.pi / 2.0), 3).astype(int), quarters)

    high = (mesh.cell_centroids > 0.5) @ [1, 1] != 1
    return Diffusion(np.where(high, kappa, 1.0), 0.0, {0: u}, exact=u)


def l_shape(cells: int, seed: int) -> Mesh:
    """Random triangles on (−1, 1)² without the quadrant x > 0 > y, whose corner is a vertex."""
    from scipy.spatial import Delaunay

    random, side = np.random.default_rng(seed), int(np.sqrt(cells / 6.0))
    points = random.uniform(-1.0, 1.0, (int(cells / 1.5), 2))
    points = points[(points[:, 0] < -0.3 / side) | (points[:, 1] > 0.3 / side)]
    corners = np.array([[0, 0], [0, -1], [-1, -1], [-1, 1], [1, 1], [1, 0], [0, 0]], float)
    edges = [
        a + np.linspace(0, 1, max(2, round(side * np.abs(b - a).max())))[:-1, None] * (b - a)
        for a, b in pairwise(corners)
    ]
    points = np.concatenate((*edges, points[np.abs(points).max(axis=1) < 1.0 - 0.3 / side]))
    triangles = Delaunay(points).simplices
    x, y = points[triangles].mean(axis=1).T
    return Mesh.from_polygons(points, triangles[(x < 0) | (y > 0)], name="L-shape")


def energy_error(errors: Mapping[str, float]) -> float:
    """Error in the DG norm, or in the energy norm of virtual elements."""
    return errors.get("dg", errors.get("energy", np.nan))


def uniform(hierarchy: Hierarchy, problem: Diffusion, **options: Any) -> tuple[Array, Array]:
    """Unknowns and energy errors of all levels and of the mesh, coarsest first."""
    meshes = [hierarchy.mesh(level) for level in range(len(hierarchy) - 1, -1, -1)]
    found = [agglo.solve(mesh, problem, **options) for mesh in (*meshes, hierarchy.fine)]
    return tuple(
        np.array(column)
        for column in zip(*((len(s.x), energy_error(s.errors())) for s in found), strict=True)
    )


def equal(cells: int, seed: int, how: str = "polydg") -> None:
    """Print the error over that of a uniform level with as many unknowns, along the adaptation."""
    for name, mesh, problem, limit in (
        ("layer, triangles", samples.random_triangles(cells // 2, seed=seed), layer(), cells // 4),
        ("layer, Voronoi", samples.voronoi(cells, seed=seed), layer(), cells // 4),
        ("corner, L-shape", l_shape(cells, seed), corner(), cells // 8),
        ("layer, tetrahedra", samples.random_tetrahedra(cells // 6, seed=seed), layer(), cells),
    ):
        for degree in (1, 2) if how == "polydg" or mesh.dim == 2 else (1,):
            options: Any = {"degree": degree, "discretisation": how}
            found = agglo.adapt(mesh, problem, max_unknowns=limit * (1 + degree), **options)
            n, e = uniform(found.hierarchy, problem, **options)
            print(f"{name}, p = {degree}, {mesh.n_cells} cells, ended by {found.reason}")
            for step in found.steps[-1:]:
                dg = energy_error(step.errors)
                same = np.exp(np.interp(np.log(step.unknowns), np.log(n), np.log(e)))
                need = np.exp(np.interp(-np.log(dg), -np.log(e), np.log(n))) if dg >= e[-1] else np.inf
                print(
                    f"  {step.unknowns:7,} unknowns: error {dg:.3e}, {dg / same:.2f} of a uniform level's "
                    f"(the whole mesh {e[-1] / same:.2f}), "
                    f"which needs {need / step.unknowns:5.1f} times as many; index {step.estimate / dg:.2f}"
                )


def indices(cells: int, seed: int) -> None:
    """Print effectivity indices of the estimators on fresh agglomerates, for all kinds of data."""
    names = "residual", "gradient_jump", "hierarchical"
    tools = [agglo.registry.default().build("estimator", name) for name in names]
    triangles = samples.random_triangles(cells // 4, seed=seed)
    u = smooth().exact
    squares = samples.squares(2 * int(np.sqrt(cells) / 2.0))
    tensor = np.array([[2.0, 0.5], [0.5, 1.0]])

    def mixed(x: Array) -> Array:
        return 17.0 * u(x) - 3.0 * np.cos(3.0 * x[:, 0]) * np.exp(x[:, 1])

    cases: dict[str, tuple[Mesh, Diffusion]] = {
        "smooth": (triangles, smooth()),
        "layer": (triangles, layer()),
        "tensor": (triangles, Diffusion(tensor, mixed, {0: u}, exact=u)),
        "reaction 1": (triangles, Diffusion(1.0, lambda x: 9.0 * u(x), {0: u}, reaction=1.0, exact=u)),
        "reaction 10⁴": (triangles, Diffusion(1.0, lambda x: 10008.0 * u(x), {0: u}, reaction=1e4, exact=u)),
        "L-shape": (l_shape(cells, seed), corner()),
        "cross point": (squares, on_squares(squares)),
        "tetrahedra": (samples.random_tetrahedra(cells // 20, seed=seed), layer()),
    }
    for name, (mesh, problem) in cases.items():
        regions = (mesh.cell_centroids > 0.5) @ [1, 2] if mesh is squares else None
        parts = mesh.coarsen(agglo.agglomerate(mesh, cells_per_part=8, regions=regions).levels[0])
        if mesh is squares:
            problem = on_squares(parts)
        for degree in (1, 2):
            solution = agglo.solve(parts, problem, degree=degree, tolerance=1e-8)
            error = solution.errors()["dg"]
            found = [float(np.linalg.norm(tool.indicate(solution))) / error for tool in tools]
            print(
                f"| {name} | {degree} | " + " | ".join(f"{index:.2f}" for index in found) + " |", flush=True
            )


def orders(cells: int, seed: int) -> None:
    """Print the orders of the error in unknowns on the L-shape, adapted and by uniform levels."""
    mesh = l_shape(cells, seed)
    for degree in (1, 2):
        found = agglo.adapt(mesh, corner(), max_unknowns=cells // 30, degree=degree, marking=0.5)
        sizes = np.array([step.unknowns for step in found.steps], float)
        errors = np.array([step.errors["dg"] for step in found.steps])
        half = sizes > 100.0 * degree
        fits = (sizes[half], errors[half]), uniform(found.hierarchy, corner(), degree=degree)
        adapted, even = (-np.polyfit(np.log(n), np.log(e), 1)[0] for n, e in fits)
        print(
            f"p = {degree}, {mesh.n_cells} cells: order {adapted:.2f} over {sizes[half][0]:.0f} to "
            f"{sizes[-1]:.0f} unknowns; uniform levels {even:.2f}"
        )


def tolerances(cells: int, seed: int) -> None:
    """Print how the true error compares with the tolerance 0.2 on 50 random problems."""
    random, ratios, reasons = np.random.default_rng(seed), [], []
    for k in range(50):
        problem = wave_and_peak(random)
        made = samples.random_triangles if k % 2 else samples.voronoi
        mesh = made(cells // (2 if k % 2 else 1), seed=seed + k)
        found = agglo.adapt(mesh, problem, tolerance=0.2, degree=1 + k % 3)
        last = found.steps[-1]
        reasons.append(found.reason)
        if found.reason == "tolerance" and last.relative:
            ratios.append(last.errors["dg"] / (last.estimate / last.relative) / 0.2)
    print(
        f"ends of 50 problems with the tolerance 0.2: {dict(Counter(reasons))}; "
        f"true error over tolerance: {min(ratios):.2f} to {max(ratios):.2f}, mean {np.mean(ratios):.2f}"
    )


class TrueErrors:
    """Estimator that returns the true error in the DG norm, for a constant κ and known exact solutions."""

    def __init__(self) -> None:
        self.residual = agglo.registry.default().build("estimator", "residual")

    def indicate(self, solution: Any) -> Array:
        """Return the error of each cell; the term ``jump`` of ``residual`` is that part of the norm."""
        basis, mesh, problem = solution.discretisation.basis(solution.mesh), solution.mesh, solution.problem
        squares = self.residual.terms(solution)["jump"] ** 2
        for batch in inside(basis.mesh, 2 * basis.degree + 4):
            cells, points = batch.cells, batch.points + basis.mesh.origin
            steps = np.tile(1e-4 * mesh.cell_diameters[cells, None], mesh.dim)
            gaps = central_differences(problem.exact, points, steps)
            gaps -= basis.gradient(solution.x, cells, points)
            squares += problem.kappa * np.bincount(cells, batch.weights * (gaps**2).sum(axis=1), mesh.n_cells)
        return np.sqrt(squares)


def headroom(cells: int, seed: int) -> None:
    """Print unknowns at equal error of gradient_jump and of the true errors over those of residual."""
    random, tools = np.random.default_rng(seed), ("residual", "gradient_jump", TrueErrors())
    meshes: Any = {
        "layer, triangles": lambda k: samples.random_triangles(cells // 2, seed=k),
        "wave and peak, Voronoi": lambda k: samples.voronoi(cells, seed=k),
        "corner, L-shape": lambda k: l_shape(cells, k),
        "layer, tetrahedra": lambda k: samples.random_tetrahedra(cells // 6, seed=k),
    }
    for name, degree in product(meshes, (1, 2)):
        ratios, options = [], {"degree": degree, "max_unknowns": cells // 5 * degree, "marking": 0.5}
        for k in range(6):
            problems = {
                "layer": layer(10.0 ** random.uniform(1.0, 2.0), random.uniform(0.4, 0.9)),
                "wave and peak": wave_and_peak(random),
                "corner": corner(),
            }
            mesh, problem = meshes[name](seed + k), problems[name.partition(",")[0]]
            found = [agglo.adapt(mesh, problem, estimator=tool, **options) for tool in tools]
            curves = [np.log([(step.unknowns, step.errors["dg"]) for step in each.steps]).T for each in found]
            least, most = max(e.min() for _, e in curves), min(e[0] for _, e in curves)
            levels = np.linspace(least, (least + most) / 2.0, 8)
            needs = [np.interp(-levels, -np.minimum.accumulate(e), n) for n, e in curves]
            ratios.append([np.exp((need - needs[0]).mean()) for need in needs[1:]])
        means, deviations = np.mean(ratios, axis=0), np.std(ratios, axis=0, ddof=1) / np.sqrt(len(ratios))
        shown = " | ".join(f"{m:.3f} ± {d:.3f}" for m, d in zip(means, deviations, strict=True))
        print(f"| {name} | {degree} | {shown} |", flush=True)


def measure_time(cells: int, seed: int) -> None:
    """Print CPU seconds to the estimate 0.1 on the layer, p = 2, and of a solve on the fine mesh."""
    problem = replace(layer(), exact=None)
    for n in (cells // 20, cells):  # the first compiles
        mesh = samples.random_triangles(n // 2, seed=seed)
        for marking in (0.8, 0.9):
            start = time.process_time()
            found = agglo.adapt(mesh, problem, tolerance=0.1, degree=2, marking=marking)
            spent = time.process_time() - start
            print(f"{mesh.n_cells} cells, marking {marking}: {spent:.2f} CPU s, {found}")
        start = time.process_time()
        fine = agglo.solve(mesh, problem, degree=2)
        print(f"{mesh.n_cells} cells, fine mesh: {time.process_time() - start:.2f} CPU s, {fine}")


def main() -> None:
    """Run the parts named on the command line, by default all."""
    parts: Any = {
        "equal": equal,
        "indices": indices,
        "orders": orders,
        "tolerances": tolerances,
        "headroom": headroom,
        "time": measure_time,
    }
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", choices=[*parts, []], default=[])
    parser.add_argument("--cells", type=int, default=12_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--discretisation", choices=["polydg", "vem"], default="polydg")
    given = parser.parse_args()
    for name in given.parts or parts:
        more = (given.discretisation,) if name == "equal" else ()
        parts[name](given.cells, given.seed, *more)


if __name__ == "__main__":
    main()
