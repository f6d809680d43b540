"""Samples: exact counts and areas, conformity, and agreement with the published grids where at hand."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from agglo_core import samples
from agglo_core.errors import OptionError
from agglo_core.mesh import Mesh

_PUBLISHED = Path(os.environ.get("AGGLO_PAPER_DATA", Path(__file__).parents[3] / "shared/data/paper"))


def _rebuilt_strictly(mesh: Mesh) -> Mesh:
    loops = mesh.boundary_loops
    return Mesh.from_polygons(mesh.points, (loops.loop_offsets, loops.vertices), strict=True)


@pytest.mark.parametrize(
    ("spec", "cells", "area"),
    [
        ("triangles:5", 50, 1.0),
        ("squares:n=5", 25, 1.0),
        ("random_triangles:n=40,seed=3", None, 1.0),
        ("voronoi:n=1", 1, 1.0),
        ("voronoi:n=2,seed=1", 2, 1.0),
        ("voronoi:n=300,seed=4", 300, 1.0),
        ("hexagons:4", 16, None),
        ("ring:n=3", 3, 0.75 * 1.5 * np.sin(2 * np.pi / 3)),
        ("ring:n=30", 90, 0.75 * 15 * np.sin(2 * np.pi / 30)),
        ("strip:7", 7, 1 / 7),
        ("disconnected:3", 18, 2.0),
    ],
)
def test_planar_samples_cover_their_domain_and_conform(
    spec: str, cells: int | None, area: float | None
) -> None:
    mesh = samples.from_spec(spec)
    assert mesh.dim == 2
    assert mesh.repairs == {}
    assert mesh.name
    assert cells is None or mesh.n_cells == cells
    assert area is None or mesh.cell_measures.sum() == pytest.approx(area, rel=1e-12)
    assert _rebuilt_strictly(mesh).n_cells == mesh.n_cells


def test_triangles_are_split_along_the_falling_diagonal() -> None:
    mesh = samples.triangles(3)
    ends = mesh.points[mesh.face_pairs]
    across = ends[:, 1] - ends[:, 0]
    slanted = across[(np.abs(across) > 1e-12).all(axis=1)]
    assert len(slanted) == 9
    np.testing.assert_allclose(slanted[:, 0], -slanted[:, 1])


def test_hexagons_are_regular_and_share_their_sides() -> None:
    mesh = samples.hexagons(4)
    np.testing.assert_allclose(mesh.face_measures, mesh.face_measures[0])
    np.testing.assert_allclose(mesh.cell_diameters, 2 * mesh.face_measures[0])
    assert (mesh.face_cells[:, 1] >= 0).sum() == 4 * 3 + 3 * 7  # along rows, between rows


def test_disconnected_has_two_components() -> None:
    assert samples.disconnected(4).graph.components().max() == 1


def test_voronoi_cells_hold_the_points_nearest_to_their_seed() -> None:
    n, seed = 4000, 5  # large enough for the short list of mirror images
    mesh = samples.voronoi(n, seed)
    seeds = np.random.default_rng(seed).random((n, 2))
    assert mesh.cell_measures.sum() == pytest.approx(1.0, rel=1e-12)
    assert mesh.points.min() == 0.0
    assert mesh.points.max() == 1.0
    owner, other = mesh.face_cells.T
    middle = mesh.points[mesh.face_pairs].mean(axis=1)
    own = np.linalg.norm(middle - seeds[owner], axis=1)
    inner = other >= 0
    np.testing.assert_allclose(np.linalg.norm(middle - seeds[other], axis=1)[inner], own[inner], atol=1e-9)
    np.testing.assert_allclose(cKDTree(seeds).query(middle)[0], own, atol=1e-9)


def test_random_samples_depend_on_their_seed_alone() -> None:
    for sample in (samples.voronoi, samples.random_triangles):
        assert sample(30, seed=1).fingerprint == sample(30, seed=1).fingerprint
        assert sample(30, seed=1).fingerprint != sample(30, seed=2).fingerprint


@pytest.mark.parametrize(("sample", "per_box"), [(samples.boxes, 1), (samples.tetrahedra, 6)])
def test_solids_fill_the_unit_cube_and_conform(sample, per_box: int) -> None:
    n = 3
    mesh = sample(n)
    assert mesh.dim == 3
    assert mesh.n_cells == per_box * n**3
    np.testing.assert_allclose(mesh.cell_measures, 1 / mesh.n_cells)
    outside = mesh.face_cells[:, 1] < 0
    assert mesh.face_measures[outside].sum() == pytest.approx(6.0)
    assert outside.sum() == 6 * n**2 * (1 if per_box == 1 else 2)


@pytest.mark.parametrize(
    ("name", "cells", "h0"),
    [("triangles", 128, 0.1768), ("squares", 256, 0.0884), ("random", 286, 0.3233), ("voronoi", 256, 0.1902)],
)
def test_paper_grids(name: str, cells: int, h0: float) -> None:
    mesh = samples.paper(name)
    assert mesh.n_cells == cells
    assert mesh.name == f"paper {name}"
    assert mesh.h == pytest.approx(h0, abs=5e-5)


@pytest.mark.parametrize(
    ("name", "file"),
    [("triangles", "tria"), ("squares", "quads"), ("random", "rand_tria"), ("voronoi", "rand_voro")],
)
def test_paper_grids_agree_with_the_published_ones(name: str, file: str) -> None:
    path = _PUBLISHED / f"{file}.npz"
    if not path.exists():
        pytest.skip(f"the authors' grids are not at {_PUBLISHED}")
    data = np.load(path)
    theirs = Mesh.from_polygons(data["points"], (data["cell_offsets"], data["cell_vertices"]))
    ours = samples.paper(name)
    distance, match = cKDTree(theirs.cell_centroids).query(ours.cell_centroids)
    assert np.array_equal(np.sort(match), np.arange(theirs.n_cells))
    assert distance.max() < 1e-9
    np.testing.assert_allclose(theirs.cell_measures[match], ours.cell_measures, atol=1e-9)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("voronoy:n=3", "did you mean 'voronoi'"),
        ("squares", "needs a value for n"),
        ("squares:n=many", "n of sample 'squares' .* must be a whole number, given 'many'; squares takes n"),
        ("squares:n=", "takes n"),
        ("squares:n=0", ">= 1"),
        ("voronoi:n=5,sede=1", r"takes n, seed \(default 0\)"),
        ("voronoi:n=5,seed=-1", ">= 0"),
        ("voronoi:n=5,n=6", "cannot use"),
        ("paper:brain", "'triangles' or 'squares' or 'random' or 'voronoi', given 'brain'"),
    ],
)
def test_bad_specs_are_explained(spec: str, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        samples.from_spec(spec)


def test_bad_sizes_are_refused() -> None:
    for size in (0, -1, 2.5, True, "3"):
        with pytest.raises(OptionError, match="squares must be a whole number"):
            samples.squares(size)  # type: ignore[arg-type]


def test_every_sample_is_listed() -> None:
    assert set(samples.names()) == set(samples.__all__) - {"names", "from_spec"}
