"""Boundary layers whose points are displaced at random: iterations of the default solver."""

from __future__ import annotations

import numpy as np
import pytest

from agglo_core import Hierarchy, Mesh, samples
from agglo_core.problems import Diffusion
from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid

FRESH = 730911


def noisy_layer(n: int, ratio: float, seed: int) -> Mesh:
    """Noisy squares drawn towards one side, the last of them ``ratio`` times as wide as the first."""
    even = samples.squares(n)
    points = even.points.copy()
    inner = ((points > 1e-9) & (points < 1.0 - 1e-9)).all(axis=1)
    points[inner] += np.random.default_rng(seed).uniform(-0.25, 0.25, (inner.sum(), 2)) / n
    points[:, 0] = np.expm1(np.log(ratio) * points[:, 0]) / np.expm1(np.log(ratio))
    return Mesh.from_polygons(points, even.boundary_loops.vertices.reshape(-1, 4))


def iterations(mesh: Mesh, degree: int, kappa: float | np.ndarray = 1.0) -> int:
    """Iterations until converged."""
    bare = Hierarchy(mesh, mesh.graph, [], [], nested=True)
    found = PolyDGMultigrid(degree=degree).solve(Diffusion(kappa, 8.0), bare)
    assert found.converged, found.reason
    return found.iterations


@pytest.mark.parametrize(("ratio", "most"), [(1e3, (12, 11, 14)), (1e6, (15, 13, 17))])
def test_noise(ratio: float, most: tuple[int, int, int]) -> None:
    mesh = noisy_layer(32, ratio, FRESH)
    for degree, bound in enumerate(most, start=1):
        assert iterations(mesh, degree) <= bound, f"degree {degree}, seed {FRESH}"


@pytest.mark.slow
@pytest.mark.parametrize(("ratio", "most"), [(1e3, (16, 17, 21)), (1e6, (20, 21, 30))])
def test_noise_with_more_cells(ratio: float, most: tuple[int, int, int]) -> None:
    mesh = noisy_layer(64, ratio, FRESH)
    for degree, bound in enumerate(most, start=1):
        assert iterations(mesh, degree) <= bound, f"degree {degree}, seed {FRESH}"


@pytest.mark.parametrize(("degree", "most"), [(1, 40), (2, 65)])
def test_a_coefficient_that_is_random_in_each_cell_as_well(degree: int, most: int) -> None:
    mesh = noisy_layer(24, 1e6, FRESH)
    kappa = 10.0 ** np.random.default_rng(FRESH).uniform(0, 6, mesh.n_cells)
    assert iterations(mesh, degree, kappa) <= most, f"seed {FRESH}"
