"""Random solids: they fill the cube, and Voronoi cells belong to their points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from agglo_core import samples
from agglo_core.errors import OptionError
from agglo_core.mesh import Mesh

SOLIDS = st.sampled_from([samples.random_tetrahedra, samples.voronoi3d])


@settings(max_examples=12, deadline=None)
@given(SOLIDS, st.integers(1, 60), st.integers(0, 2**32 - 1))
def test_random_solids_fill_the_cube(make: Callable[..., Mesh], n: int, seed: int) -> None:
    mesh = make(n, seed=seed)
    assert mesh.cell_measures.sum() == pytest.approx(1.0, rel=1e-12)
    assert mesh.cell_measures.min() > 0.0
    assert mesh.face_measures[mesh.face_cells[:, 1] < 0].sum() == pytest.approx(6.0, rel=1e-12)
    np.testing.assert_array_equal(make(n, seed=seed).points, mesh.points)
    if make is samples.voronoi3d:
        assert mesh.n_cells == n


def test_cells_of_solid_voronoi_meshes_belong_to_their_points() -> None:
    mesh = samples.voronoi3d(40, seed=4)
    seeds = np.random.default_rng(4).random((40, 3))
    faces = np.repeat(np.arange(mesh.n_faces), np.diff(mesh.face_offsets))
    for v in range(mesh.n_points):
        own = np.unique(mesh.face_cells[faces[mesh.face_vertices == v]])
        away = np.linalg.norm(seeds - mesh.points[v], axis=1)
        assert away[own[own >= 0]].max() == pytest.approx(away.min(), abs=1e-9)


def faces_between(mesh: Mesh, marked: np.ndarray) -> np.ndarray:
    """Centroids of the marked faces, all of which have two cells."""
    assert (mesh.face_cells[marked] >= 0).all()
    return np.asarray(mesh.face_centroids[marked])


@pytest.mark.parametrize("layers", [0, 1, 7])
def test_prisms_are_extruded_triangles(layers: int) -> None:
    plane, mesh = samples.random_triangles(60, seed=2), samples.prisms(60, layers, seed=2)
    high = layers or 8
    assert mesh.n_cells == high * plane.n_cells
    assert mesh.repairs == {}
    np.testing.assert_allclose(mesh.cell_measures, np.tile(plane.cell_measures / high, high), rtol=1e-9)
    assert sorted(set(np.diff(mesh.face_offsets))) == [3, 4]


@pytest.mark.parametrize("n", [4, 11, 24])
def test_layered_ground_has_what_it_says(n: int) -> None:
    mesh = samples.layered(n)
    tags, sides = mesh.cell_tags["material"], mesh.face_tags["side"]
    assert mesh.repairs == {}
    assert mesh.n_cells == n * n * max(2, n // 2)
    assert mesh.cell_measures.min() > 0.0
    assert set(tags) <= set(range(1, 7))
    outer = mesh.face_cells[:, 1] < 0
    np.testing.assert_array_equal(sides > 0, outer)
    assert set(sides[outer]) == set(range(1, 7))
    for number in (1, 2):
        assert len(faces_between(mesh, mesh.face_tags["fault"] == number)) == n * max(2, n // 2)
    corners = mesh.points[mesh.face_vertices.reshape(-1, 4)]
    away = np.einsum("fvd,fd->fv", corners - corners[:, :1], mesh.face_normals)
    assert np.abs(away).max() < 1e-12  # faces are plane


def test_faults_displace_layers_and_nothing_else_does() -> None:
    mesh = samples.layered(24)
    one, other = mesh.face_cells[mesh.face_cells[:, 1] >= 0].T
    across = np.abs(mesh.face_normals[mesh.face_cells[:, 1] >= 0][:, 1]) > 0.99
    material, fault = mesh.cell_tags["material"], mesh.face_tags["fault"][mesh.face_cells[:, 1] >= 0]
    assert (material[one[across]] == material[other[across]]).all()  # layers go on along y
    displaced = material[one[fault > 0]] != material[other[fault > 0]]
    assert 0.2 < displaced.mean() < 0.9
    assert np.bincount(material)[1:].min() > 0


@pytest.mark.parametrize("mm", [4.0, 7, 20])
def test_the_brain_in_voxels(mm: float) -> None:
    mesh = samples.brain3d(mm)
    assert mesh.repairs == {}
    np.testing.assert_allclose(mesh.cell_measures, mm**3, rtol=1e-9)
    assert mesh.cell_measures.sum() == pytest.approx(1.886e6, rel=0.02)
    assert mesh.graph.components().max() == 0
    centres = mesh.cell_centroids / mm
    np.testing.assert_allclose(centres, np.rint(centres), atol=1e-9)  # a voxel's middle is at x = 0
    mirrored = {tuple(each) for each in np.rint(centres * [-1, 1, 1]).astype(int)}
    same = len(mirrored & {tuple(each) for each in np.rint(centres).astype(int)})
    assert same == mesh.n_cells  # as the template is


def test_tissues_of_the_brain_lie_where_they_should() -> None:
    mesh = samples.brain3d(4)
    tissue = mesh.cell_tags["tissue"]
    fluid, grey, white = (mesh.cell_centroids[tissue == t] for t in (1, 2, 3))
    assert 0.55 < len(grey) / mesh.n_cells < 0.75
    assert 0.25 < len(white) / mesh.n_cells < 0.4
    assert len(fluid) > 500
    middle = mesh.cell_centroids.mean(axis=0)
    assert np.linalg.norm(white - middle, axis=1).mean() < np.linalg.norm(grey - middle, axis=1).mean() - 5
    one, other = mesh.face_cells[mesh.face_cells[:, 1] >= 0].T
    assert (tissue[one] == tissue[other]).mean() > 0.7


@pytest.mark.parametrize("mm", [1.9, 21, "4", float("nan"), True])
def test_the_brain_has_a_finest_and_a_coarsest_size(mm: object) -> None:
    with pytest.raises(OptionError, match="mm of sample brain3d must be a number from 2 to 20"):
        samples.brain3d(mm)  # type: ignore[arg-type]
