"""Random diffusion problems with meshes, coefficients and boundary data, and their direct solution."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from agglo_core import Mesh, samples
from agglo_core.problems import Diffusion
from agglo_polydg_mg.forms.assembly import discretise_lifted
from agglo_polydg_mg.forms.norms import EnergyNorm
from agglo_polydg_mg.space.basis import Basis

__all__ = ["Case", "energy_error", "graded", "random_case", "with_four_sides"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """Mesh, problem, degree and tolerance."""

    mesh: Mesh
    problem: Diffusion
    degree: int
    tolerance: float


def graded(n: int, ratio: float, *, both: bool = False) -> Mesh:
    """Return n × n rectangles on the unit square, with widths from ``ratio`` to 1 times the largest."""
    s = np.concatenate(([0.0], np.cumsum(np.geomspace(ratio, 1.0, n))))
    xs, ys = s / s[-1], s / s[-1] if both else np.linspace(0, 1, n + 1)
    points = np.array([(x, y) for y in ys for x in xs])
    corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    return Mesh.from_polygons(points, np.stack([corner, corner + 1, corner + n + 2, corner + n + 1], axis=1))


def with_four_sides(mesh: Mesh) -> Mesh:
    """Tag boundary faces 1 to 4 by the nearest side: left, right, bottom, top."""
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    at = (mesh.points[mesh.face_pairs].mean(axis=1) - low) / (high - low)
    side = 1 + np.stack([at[:, 0], 1 - at[:, 0], at[:, 1], 1 - at[:, 1]]).argmin(axis=0)
    return replace(mesh, face_tags={"boundary": np.where(mesh.face_cells[:, 1] < 0, side, 0)})


def random_case(seed: int, largest: int = 12) -> Case:
    """Return a random case with about ``largest``² cells at most, and data with an offset up to 1e8."""
    random = np.random.default_rng(seed)
    mesh = with_four_sides(_mesh(random, int(random.integers(4, largest)), seed))
    offset = 0.0 if random.random() < 0.25 else random.choice([-1, 1]) * 10.0 ** random.uniform(0, 8)
    dirichlet, neumann = _boundary(random, mesh, float(offset))
    sources = [1.0, 0.0, random.normal(size=mesh.n_cells), lambda x: np.exp(x[:, 0]) * np.cos(7 * x[:, 1])]
    problem = Diffusion(_kappa(random, mesh), sources[random.integers(4)], dirichlet, neumann)
    return Case(
        mesh, problem, int(random.choice([1, 2, 3], p=[0.6, 0.25, 0.15])), 10 ** -random.uniform(3, 9)
    )


def _mesh(random: Generator, n: int, seed: int) -> Mesh:
    kind = random.choice(["squares", "voronoi", "triangles", "random", "graded", "loose"], p=_SHARES)
    if kind == "squares":
        return samples.squares(n)
    if kind == "voronoi":
        return samples.voronoi(n * n, seed=seed)
    if kind == "triangles":
        return samples.triangles(n // 2 + 2)
    if kind == "random":
        return samples.random_triangles(n * n // 2, seed=seed)
    if kind == "graded":
        return graded(n, 10 ** -random.uniform(1, 6), both=bool(random.random() < 0.4))
    return samples.disconnected(max(3, n // 2))


_SHARES = [0.15, 0.2, 0.15, 0.15, 0.3, 0.05]


def _kappa(random: Generator, mesh: Mesh) -> float | Array:
    """Return a coefficient: 1, log-uniform, two-valued per cell, two halves, or an island."""
    contrast, middle = 10.0 ** random.uniform(0, 6), mesh.cell_centroids
    kind = random.integers(5)
    if kind == 0:
        return 1.0
    if kind == 1:
        return np.asarray(contrast ** random.random(mesh.n_cells))
    if kind == 2:
        return np.where(random.random(mesh.n_cells) < 0.5, 1.0, contrast)
    if kind == 3:
        along = middle @ random.normal(size=2)
        return np.where(along < np.median(along), 1.0, contrast)
    away = np.linalg.norm(middle - middle[random.integers(mesh.n_cells)], axis=1)
    return np.where(away < np.quantile(away, 0.3), contrast ** random.choice([-1, 1]), 1.0)


def _boundary(random: Generator, mesh: Mesh, offset: float) -> tuple[dict, dict]:
    """Return Dirichlet and Neumann data.

    If some component would have no Dirichlet side, all sides get Dirichlet data.
    """
    outer = mesh.face_cells[:, 1] < 0
    tags = mesh.face_tags["boundary"]
    draws = {int(tag): random.random() for tag in np.unique(tags[outer])}
    held = {tag for tag, draw in draws.items() if draw < 0.6}
    component = mesh.graph.components()
    reached = component[mesh.face_cells[outer & np.isin(tags, list(held)), 0]]
    if len(np.unique(reached)) <= component.max():
        held = set(draws)
    neumann = {tag: float(random.normal()) for tag in draws if tag not in held and draws[tag] < 0.85}
    return {tag: _data(random, offset) for tag in held}, neumann


def _data(random: Generator, offset: float) -> object:
    a, b, c = random.normal(size=3) * random.choice([0.01, 1, 10])
    return [
        offset,
        offset + a,
        lambda x: offset + a + b * x[:, 0] + c * x[:, 1],
        lambda x: offset + a * np.sin(3 * x[:, 0] + 5 * x[:, 1]),
    ][random.integers(4)]


def energy_error(case: Case, x: Array) -> float:
    """Return ‖x − A⁻¹b‖_A relative to the energy norm, for a solution without the offset of the data."""
    found = discretise_lifted(case.mesh, case.degree, case.problem)
    A, exact = found.system.A, _eliminated(found.system.A, found.load)
    e = (x - exact).astype(float)
    norm = EnergyNorm(Basis(case.mesh, case.degree), case.problem, 10.0)(exact.astype(float))
    return float(np.sqrt(max(e @ (A @ e), 0.0)) / norm)


def _eliminated(A: sparse.sparray, b: Array) -> np.ndarray:
    """Solve by sparse elimination and iterative refinement with extended-precision residuals."""
    factors, entries = splu(sparse.csc_array(A)), sparse.coo_array(A)
    (row, column), values = entries.coords, entries.data.astype(np.longdouble)
    x = factors.solve(b).astype(np.longdouble)
    for _ in range(4):
        r = b.astype(np.longdouble)
        np.subtract.at(r, row, values * x[column])
        x = x + factors.solve(r.astype(float))
    return x
