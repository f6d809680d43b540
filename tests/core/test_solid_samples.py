"""Random solids: they fill the cube, and Voronoi cells belong to their points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agglo_core import samples
from agglo_core.mesh import Mesh

SOLIDS = st.sampled_from([samples.random_tetrahedra, samples.voronoi_solids])


@settings(max_examples=12, deadline=None)
@given(SOLIDS, st.integers(1, 60), st.integers(0, 2**32 - 1))
def test_random_solids_fill_the_cube(make: Callable[..., Mesh], n: int, seed: int) -> None:
    mesh = make(n, seed=seed)
    assert mesh.cell_measures.sum() == pytest.approx(1.0, rel=1e-12)
    assert mesh.cell_measures.min() > 0.0
    assert mesh.face_measures[mesh.face_cells[:, 1] < 0].sum() == pytest.approx(6.0, rel=1e-12)
    np.testing.assert_array_equal(make(n, seed=seed).points, mesh.points)
    if make is samples.voronoi_solids:
        assert mesh.n_cells == n


def test_cells_of_solid_voronoi_meshes_belong_to_their_points() -> None:
    mesh = samples.voronoi_solids(40, seed=4)
    seeds = np.random.default_rng(4).random((40, 3))
    faces = np.repeat(np.arange(mesh.n_faces), np.diff(mesh.face_offsets))
    for v in range(mesh.n_points):
        own = np.unique(mesh.face_cells[faces[mesh.face_vertices == v]])
        away = np.linalg.norm(seeds - mesh.points[v], axis=1)
        assert away[own[own >= 0]].max() == pytest.approx(away.min(), abs=1e-9)
