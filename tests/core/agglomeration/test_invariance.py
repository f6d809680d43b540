"""On asymmetric meshes neither numbering nor position, angle or scale change a partition."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial import Delaunay

import agglo_core as agglo
from agglo_core import Mesh, Target, samples
from agglo_core.arrays import frozen_int
from agglo_core.refine.connectivity import ConnectivityFixer
from agglo_core.refine.interface import InterfaceRefiner

TARGETS = ({"n_parts": (8, 32)}, {"h_factor": (2.0, 4.0)})
RIGID = ("renumbered", "rotated", "mirrored", "shifted", "far away", "scaled")


def same_partition(one, other) -> bool:
    """Whether two label arrays differ in the names of the parts alone."""
    pairs = np.unique(np.stack((one, other)), axis=1).shape[1]
    return pairs == one.max() + 1 == other.max() + 1


def loops_of(mesh: Mesh):
    loops = mesh.boundary_loops
    return np.split(loops.vertices, loops.loop_offsets[1:-1])


def rotation(rng, dim):
    frame = np.linalg.qr(rng.standard_normal((dim, dim)))[0]
    frame[0] *= np.sign(np.linalg.det(frame))
    return frame


def moved(points, change: str, rng):
    """The points after one change of the plane or of space."""
    dim = points.shape[1]
    diameter = np.linalg.norm(np.ptp(points, axis=0))
    direction = rng.standard_normal(dim)
    direction /= np.linalg.norm(direction)
    match change:
        case "rotated":
            return points @ rotation(rng, dim).T
        case "mirrored":
            return points * ([-1.0] + [1.0] * (dim - 1))
        case "shifted":
            return points + 10 ** rng.uniform(-1, 6) * diameter * direction
        case "far away":
            return points + 1e6 * diameter * direction
        case "scaled":
            return points * 10 ** rng.uniform(-6, 6)
    return points


def variant(mesh: Mesh, change: str, rng) -> tuple[Mesh, np.ndarray]:
    """The changed mesh, and the old number of each of its cells."""
    cells, order, points = loops_of(mesh), np.arange(mesh.n_cells), mesh.points
    if change == "renumbered":
        order, place = rng.permutation(mesh.n_cells), rng.permutation(len(points))
        cells = [np.roll(np.argsort(place)[cell], rng.integers(len(cell))) for cell in cells]
        points = points[place]
    return Mesh.from_polygons(moved(points, change, rng), [cells[i] for i in order]), order


def with_holes(mesh: Mesh, rng) -> Mesh:
    """Its largest component once some discs are cut out."""
    keep = np.ones(mesh.n_cells, bool)
    for _ in range(5):
        keep &= np.linalg.norm(mesh.cell_centroids - rng.random(2), axis=1) > rng.uniform(0.05, 0.15)
    mesh = Mesh.from_polygons(mesh.points, [cell for cell, k in zip(loops_of(mesh), keep, strict=True) if k])
    component = mesh.graph.components()
    keep = component == np.argmax(np.bincount(component))
    return Mesh.from_polygons(mesh.points, [cell for cell, k in zip(loops_of(mesh), keep, strict=True) if k])


@cache
def asymmetric(seed: int) -> Mesh:
    rng = np.random.default_rng(seed)
    mesh = samples.random_triangles(128, seed) if seed % 2 else samples.voronoi(256, seed)
    return with_holes(mesh, rng) if seed % 3 == 0 else mesh


@cache
def levels_before(make, seed, bisector):
    """Levels of an unchanged mesh for each target: every change is compared with them."""
    return [agglo.agglomerate(make(seed), bisector=bisector, **target).levels for target in TARGETS]


def assert_same(make, seed, other, order, bisector):
    for before, target in zip(levels_before(make, seed, bisector), TARGETS, strict=True):
        after = agglo.agglomerate(other, bisector=bisector, **target)
        for one, two in zip(before, after.levels, strict=True):
            assert same_partition(one[order], two)


_PLANE = [(name, change) for name in ("kmeans", "spectral", "inertial", "coordinate") for change in RIGID]
_PLANE.remove(("coordinate", "rotated"))  # it belongs to its axes


@pytest.mark.parametrize(("bisector", "change"), _PLANE)
def test_plane_meshes(bisector, change):
    for seed in range(2 if bisector == "spectral" else 4):
        other, order = variant(asymmetric(seed), change, np.random.default_rng(seed))
        assert_same(asymmetric, seed, other, order, bisector)


def tetrahedra(points, corners) -> Mesh:
    a, b, c, d = corners.T
    faces = np.stack([np.stack(f, axis=1) for f in ((a, b, c), (a, d, b), (b, d, c), (a, c, d))], axis=1)
    return Mesh.from_polyhedra(points, faces.tolist())


@cache
def cloud(seed: int):
    """Delaunay tetrahedra of random points, flat ones left out."""
    points = np.random.default_rng(seed).random((60, 3))
    corners = Delaunay(points).simplices
    volume = np.linalg.det(points[corners[:, 1:]] - points[corners[:, :1]])
    corners[volume < 0] = corners[volume < 0][:, [0, 2, 1, 3]]
    return points, corners[np.abs(volume) > 1e-4]


@cache
def solid(seed: int) -> Mesh:
    return tetrahedra(*cloud(seed))


@pytest.mark.parametrize("change", [each for each in RIGID if each != "mirrored"])
@pytest.mark.parametrize("bisector", ["kmeans", "spectral", "inertial"])
def test_tetrahedra(bisector, change):
    for seed in range(1 if bisector == "spectral" else 3):
        rng = np.random.default_rng(seed)
        points, corners = cloud(seed)
        order = rng.permutation(len(corners)) if change == "renumbered" else np.arange(len(corners))
        other = tetrahedra(moved(points, change, rng), corners[order])
        assert_same(solid, seed, other, order, bisector)


@pytest.mark.parametrize("unit", [1e-48, 1e48])
@pytest.mark.parametrize("bisector", ["kmeans", "inertial", "sweep", "gnn", "coordinate"])
def test_lengths_near_both_ends_of_what_a_mesh_may_have(bisector, unit):
    """Single precision has none of them; the squares of their squares leave double precision."""
    for make in (asymmetric, solid):
        mesh = make(1)
        other = replace(mesh, points=mesh.points * unit)
        assert_same(make, 1, other, np.arange(mesh.n_cells), bisector)


@pytest.mark.parametrize("refiners", [(), ("interface",)])
@pytest.mark.parametrize("n", [20, 1500])
def test_sizes_far_from_the_usual(n, refiners):
    for seed in range(2):
        mesh = samples.voronoi(n, seed)
        if n > 100:
            mesh = with_holes(samples.random_triangles(n, seed), np.random.default_rng(seed))
        for change in ("renumbered", "rotated"):
            other, order = variant(mesh, change, np.random.default_rng(seed))
            one = agglo.agglomerate(mesh, refiners=refiners, cells_per_part=8).levels[0]
            two = agglo.agglomerate(other, refiners=refiners, cells_per_part=8).levels[0]
            assert same_partition(one[order], two)


@pytest.mark.parametrize(
    ("make", "size", "seed"),
    [
        (samples.voronoi, 1000, 105),
        (samples.random_triangles, 500, 55),
        (samples.random_triangles, 500, 189),
        (samples.random_tetrahedra, 300, 28),
        (samples.random_tetrahedra, 300, 141),
    ],
)
def test_cells_close_to_a_separator_keep_their_side(make, size: int, seed: int) -> None:
    """In single precision rounding decided the side of a cell in these meshes."""
    mesh = make(size, seed=seed)
    turn = rotation(np.random.default_rng(seed), mesh.dim)
    one, two = (
        agglo.agglomerate(replace(mesh, points=points), n_parts=mesh.n_cells // 80).levels[0]
        for points in (mesh.points, mesh.points @ turn.T)
    )
    assert same_partition(one, two)


@pytest.mark.parametrize("parts", [2, 12])
def test_the_refiner_alone_does_not_depend_on_numbering(parts):
    """Long ways around holes: how far it looks must not depend on where it starts to look."""
    for seed in range(8):
        rng = np.random.default_rng(seed)
        mesh = with_holes(samples.random_triangles(400, seed), rng)
        other, order = variant(mesh, "renumbered", rng)
        seeds = rng.random((parts, 2))
        labels = np.argmin(np.linalg.norm(mesh.cell_centroids[:, None] - seeds, axis=2), axis=1)
        one, two = (
            InterfaceRefiner().refine(each.graph, given, np.zeros(1, np.uint64), Target())
            for each, given in ((mesh, labels), (other, labels[order]))
        )
        np.testing.assert_array_equal(one[order], two)


def test_merging_and_polishing_do_not_depend_on_numbering():
    options = {"merge": True, "post_refiners": ["interface"], "h_factor": (2.0, 4.0)}
    for seed in range(4):
        mesh = asymmetric(seed)
        other, order = variant(mesh, "renumbered", np.random.default_rng(seed))
        before, after = (agglo.agglomerate(each, **options) for each in (mesh, other))
        for one, two in zip(before.levels, after.levels, strict=True):
            assert same_partition(one[order], two)


@pytest.mark.parametrize("grid", ["squares", "triangles"])
@pytest.mark.parametrize("bisector", ["kmeans", "inertial"])
def test_symmetric_grids_keep_number_and_shape(bisector, grid):
    """Halving a square must choose an axis: the partition is the same up to a symmetry of the grid."""
    mesh = samples.paper(grid)
    expected = _shape(mesh, bisector)
    for seed, change in enumerate(RIGID):
        other, _ = variant(mesh, change, np.random.default_rng(seed))
        np.testing.assert_allclose(_shape(other, bisector), expected, atol=1e-6)


def _shape(mesh, bisector):
    labels = agglo.agglomerate(mesh, bisector=bisector, h_factor=4).levels[0]
    values = agglo.quality(mesh, labels, metrics=("UF", "CR"))
    return labels.max() + 1, values["UF"].mean(), values["CR"].mean()


@pytest.mark.parametrize("change", RIGID)
@pytest.mark.parametrize("mesh", [samples.squares(8), samples.hexagons(7)], ids=lambda mesh: mesh.name)
def test_equal_pieces_and_equal_interfaces_are_settled_by_place(mesh: Mesh, change: str) -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        labels = frozen_int(rng.integers(3, size=mesh.n_cells))
        other, order = variant(mesh, change, rng)
        fixed = ConnectivityFixer().fix(mesh.graph, labels)
        again = ConnectivityFixer().fix(other.graph, frozen_int(labels[order]))
        np.testing.assert_array_equal(again, fixed[order])
