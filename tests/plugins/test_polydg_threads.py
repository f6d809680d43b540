"""Matrices and right-hand sides of PolyDG are the same, bit by bit, for any number of threads."""

from __future__ import annotations

import numpy as np
import pytest

from agglo_core import Diffusion, Mesh, samples
from agglo_core.threads import using_threads
from agglo_polydg_mg.forms.assembly import discretise

WAVE = Diffusion(source=lambda x: np.sin(x[:, 0]), kappa=lambda x: 2.0 + np.cos(9.0 * x[:, 1]))


def meshes() -> list[Mesh]:
    """Cells in random order, and agglomerates with many faces."""
    fine = samples.voronoi(900, seed=4)
    near = np.linalg.norm(fine.cell_centroids[:, None] - fine.cell_centroids[:60], axis=2).argmin(axis=1)
    return [samples.random_triangles(150, seed=2), fine.coarsen(near)]


@pytest.mark.parametrize("penalty", ["paper", "sharp"])
@pytest.mark.parametrize("problem", [WAVE, Diffusion(source=8.0)], ids=["callable", "constant"])
def test_matrix_and_load_do_not_depend_on_threads(problem: Diffusion, penalty: str) -> None:
    for mesh in meshes():
        wanted = discretise(mesh, 2, problem, penalty=penalty, scaled_basis=True)
        for count in (2, 3, 5):
            with using_threads(count, few=1):
                found = discretise(mesh, 2, problem, penalty=penalty, scaled_basis=True)
            assert found.A.data.tobytes() == wanted.A.data.tobytes()
            assert np.array_equal(found.A.indices, wanted.A.indices)
            assert found.b.tobytes() == wanted.b.tobytes()
