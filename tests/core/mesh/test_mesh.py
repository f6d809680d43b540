"""2-D meshes: exact values, the same mesh given in other ways, coarsening, loops; shapely as oracle."""

from __future__ import annotations

import pickle
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings, strategies as st
from scipy.spatial import ConvexHull, Delaunay
from scipy.spatial.distance import pdist

import agglo_core as agglo
from agglo_core import Mesh, MeshError, samples

ARRAYS = ("face_offsets", "face_vertices", "face_cells")
SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1]]
# a triangle, a quadrilateral and a non-convex pentagon that fill the square (0, 3) x (0, 3)
MIXED_POINTS = [[0, 0], [3, 0], [3, 3], [0, 3], [1, 1]]
MIXED_CELLS = [[0, 1, 4], [1, 2, 4], [2, 3, 0, 4]]


def polygons_of(mesh: Mesh) -> np.ndarray:
    """Each cell as a shapely geometry: its loops combined by the even-odd rule."""
    loops = mesh.boundary_loops
    rings = [shapely.Polygon(mesh.points[loops.vertices[i:j]]) for i, j in pairwise(loops.loop_offsets)]
    shapes = []
    for i, j in pairwise(loops.cell_offsets):
        shape = shapely.Polygon()
        for ring in sorted(rings[i:j], key=lambda ring: -ring.area):
            shape = shape.symmetric_difference(ring)
        shapes.append(shape)
    return np.array(shapes)


def compact(labels: np.ndarray) -> np.ndarray:
    return np.unique(labels, return_inverse=True)[1]


def geometry(mesh: Mesh) -> list[np.ndarray]:
    return [
        mesh.cell_measures,
        mesh.cell_centroids,
        mesh.face_measures,
        mesh.face_normals,
        mesh.cell_diameters,
        mesh.graph.indptr,
        mesh.graph.indices,
        mesh.graph.interface,
        mesh.boundary_loops.vertices,
    ]


@st.composite
def labelled(draw: st.DrawFn) -> tuple[Mesh, np.ndarray]:
    """A small mesh of one of several families with arbitrary labels: islands, holes, pinches."""
    n, seed = draw(st.integers(2, 5)), draw(st.integers(0, 10**6))
    rng = np.random.default_rng(seed)
    kind = draw(st.sampled_from(["squares", "delaunay", "scattered"]))
    if kind == "delaunay":
        points = rng.random((n * n + 3, 2))
        mesh = Mesh.from_polygons(points, Delaunay(points).simplices)
    else:
        mesh = samples.squares(n)
        if kind == "scattered":  # a part of the squares: holes, pinches and loose cells in the domain
            kept = np.flatnonzero(rng.random(n * n) < 0.7) if n > 2 else np.arange(4)
            corners = mesh.boundary_loops.vertices.reshape(-1, 4)[kept if len(kept) else [0]]
            mesh = Mesh.from_polygons(mesh.points, corners)
    return mesh, compact(rng.integers(0, draw(st.integers(1, 6)), mesh.n_cells))


# --- exact values -------------------------------------------------------------------------------------


def test_one_square() -> None:
    mesh = Mesh.from_polygons(SQUARE, [[0, 1, 2, 3]], name="one")
    assert (mesh.dim, mesh.n_cells, mesh.n_faces, mesh.n_points) == (2, 1, 4, 4)
    assert mesh.cell_measures.tolist() == [1.0]
    assert mesh.cell_centroids.tolist() == [[0.5, 0.5]]
    assert mesh.origin.tolist() == [0.5, 0.5]
    assert mesh.face_measures.tolist() == [1.0] * 4
    assert mesh.face_normals.tolist() == [[0, -1], [1, 0], [0, 1], [-1, 0]]
    assert mesh.h == mesh.cell_diameters[0] == np.sqrt(2)
    assert mesh.face_cells.tolist() == [[0, -1]] * 4
    assert repr(mesh) == "Mesh('one', 2-D, 1 cells, 4 faces, 4 points)"
    assert dict(mesh.repairs) == {}


def test_mixed_polygons() -> None:
    mesh = Mesh.from_polygons(MIXED_POINTS, MIXED_CELLS)
    assert mesh.cell_measures.tolist() == [1.5, 3.0, 4.5]
    assert mesh.n_faces == 7
    inner = mesh.face_cells[mesh.face_cells[:, 1] >= 0]
    assert sorted(map(sorted, inner.tolist())) == [[0, 1], [0, 2], [1, 2]]
    centroid = shapely.centroid(shapely.Polygon(np.array(MIXED_POINTS)[MIXED_CELLS[2]]))
    np.testing.assert_allclose(mesh.cell_centroids[2], [centroid.x, centroid.y], rtol=1e-14)
    np.testing.assert_allclose(mesh.cell_diameters, [3, 3, np.hypot(3, 3)])


def test_the_owner_lies_on_the_left_and_normals_point_outwards() -> None:
    mesh = samples.voronoi(40, seed=1)
    middle = mesh.points[mesh.face_pairs].mean(axis=1)
    outward = middle - mesh.cell_centroids[mesh.face_cells[:, 0]]
    assert ((outward * mesh.face_normals).sum(axis=1) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(mesh.face_normals, axis=1), 1)


def test_a_disconnected_mesh_is_legal() -> None:
    points = [*SQUARE, *(np.array(SQUARE) + 5).tolist()]
    mesh = Mesh.from_polygons(points, [[0, 1, 2, 3], [4, 5, 6, 7]])
    assert mesh.graph.components().tolist() == [0, 1]


def test_listed_hanging_nodes_are_legal_polygons() -> None:
    points = [[0, 0], [1, 0], [1, 0.5], [1, 1], [0, 1], [2, 0], [2, 0.5], [2, 1]]
    mesh = Mesh.from_polygons(points, [[0, 1, 2, 3, 4], [1, 5, 6, 2], [2, 6, 7, 3]], strict=True)
    assert mesh.cell_measures.tolist() == [1.0, 0.5, 0.5]
    assert mesh.graph.indptr.tolist() == [0, 2, 4, 6]


# --- the same mesh given in other ways ----------------------------------------------------------------


def test_however_it_is_given_the_geometry_is_the_same() -> None:
    squares = samples.squares(4)
    corners = squares.boundary_loops.vertices.reshape(-1, 4)
    points = squares.points
    wanted = geometry(Mesh.from_polygons(points, corners))
    ways = {
        "list": corners.tolist(),
        "tuples": tuple(map(tuple, corners.tolist())),
        "arrays": list(corners),
        "generator": (loop for loop in corners.tolist()),
        "offsets": (np.arange(0, 65, 4), corners.ravel()),
        "int32": corners.astype(np.int32),
        "uint64": corners.astype(np.uint64),
        "Fortran order": np.asfortranarray(corners),
        "a list beside an array": (np.arange(0, 65, 4), corners.ravel().tolist()),
    }
    for way, cells in ways.items():
        mesh = Mesh.from_polygons(points, cells)
        for value, expected in zip(geometry(mesh), wanted, strict=True):
            np.testing.assert_array_equal(value, expected, err_msg=way)
        assert dict(mesh.repairs) == {}
    clockwise = Mesh.from_polygons(points, corners[:, ::-1])
    assert dict(clockwise.repairs) == {"clockwise cells reversed": 16}
    np.testing.assert_array_equal(clockwise.cell_measures, wanted[0])
    np.testing.assert_array_equal(clockwise.cell_centroids, wanted[1])
    assert (clockwise.graph.to_scipy() != squares.graph.to_scipy()).nnz == 0


def test_some_cells_clockwise() -> None:
    loops = [MIXED_CELLS[0][::-1], MIXED_CELLS[1], MIXED_CELLS[2][::-1]]
    mesh = Mesh.from_polygons(MIXED_POINTS, loops)
    assert mesh.cell_measures.tolist() == [1.5, 3.0, 4.5]
    assert dict(mesh.repairs) == {"clockwise cells reversed": 2}


def test_a_constant_third_coordinate_is_dropped() -> None:
    points = np.column_stack((SQUARE, np.full(4, 7.5)))
    assert Mesh.from_polygons(points, [[0, 1, 2, 3]]).dim == 2


def test_orphans_are_dropped_and_equal_points_merged_and_both_counted() -> None:
    left, right = np.array(SQUARE, float), np.add(SQUARE, [1, 0])
    points = np.concatenate((left, right, [[9, 9], [9, 9], [-0.0, 5]]))
    cells = [[0, 1, 2, 3], [4, 5, 6, 7]]
    apart = Mesh.from_polygons(points, cells, allow_gaps=True)
    assert apart.graph.n_blocks == 1
    assert len(apart.graph.indices) == 0
    assert dict(apart.repairs) == {"orphan points dropped": 3}
    joined = Mesh.from_polygons(points, cells, merge_points=True)
    assert joined.n_points == 6
    assert joined.graph.interface.tolist() == [1.0, 1.0]
    assert dict(joined.repairs) == {"equal points merged": 3, "orphan points dropped": 2}


def test_minus_zero_equals_zero() -> None:
    points = [[0.0, 0], [1, 0], [0, 1], [-0.0, 0], [0, 1], [-1, 0]]
    mesh = Mesh.from_polygons(points, [[0, 1, 2], [3, 4, 5]], merge_points=True)
    assert mesh.n_points == 4


def test_later_changes_of_the_callers_arrays_do_not_matter() -> None:
    points, tags = np.array(SQUARE, float), np.array([4])
    mesh = Mesh.from_polygons(points, [[0, 1, 2, 3]], cell_tags={"material": tags})
    points[:] = np.nan
    tags[:] = 0
    assert mesh.cell_measures.tolist() == [1.0]
    assert mesh.cell_tags["material"].tolist() == [4]
    with pytest.raises(ValueError, match="read-only"):
        mesh.points[0, 0] = 3


@pytest.mark.parametrize("shift", [1e6, 1e9])
def test_far_from_the_origin_a_regular_grid_stays_regular(shift: float) -> None:
    near, far = samples.squares(8), samples.squares(8)
    far = Mesh.from_polygons(near.points + shift, near.boundary_loops.vertices.reshape(-1, 4))
    np.testing.assert_array_equal(far.cell_measures, near.cell_measures)
    np.testing.assert_array_equal(far.cell_diameters, near.cell_diameters)
    np.testing.assert_array_equal(far.local_centroids, near.local_centroids)


def test_bridges_to_holes_are_dropped_on_request() -> None:
    outer, inner = [[0, 0], [4, 0], [4, 4], [0, 4]], [[1, 1], [1, 3], [3, 3], [3, 1]]
    points = [*outer, *inner]
    ring = [0, 1, 2, 3, 0, 4, 5, 6, 7, 4]
    with pytest.raises(MeshError, match="cell 0: a repeated vertex"):
        Mesh.from_polygons(points, [ring, [4, 7, 6, 5]])
    mesh = Mesh.from_polygons(points, [ring, [4, 7, 6, 5]], weak=True)
    assert mesh.n_faces == 8
    assert mesh.cell_measures.tolist() == [12.0, 4.0]
    assert np.diff(mesh.boundary_loops.cell_offsets).tolist() == [2, 1]


# --- loops --------------------------------------------------------------------------------------------


def loops_of(mesh: Mesh, cell: int = 0) -> list[set[int]]:
    found = mesh.boundary_loops
    ends = found.loop_offsets[found.cell_offsets[cell] : found.cell_offsets[cell + 1] + 1]
    return [set(found.vertices[i:j].tolist()) for i, j in pairwise(ends)]


def test_loops_part_where_squares_touch_at_a_corner() -> None:
    mesh = samples.squares(2)
    order = np.lexsort((mesh.cell_centroids[:, 1], mesh.cell_centroids[:, 0]))
    labels = np.zeros(4, int)
    labels[order[[1, 2]]] = 1
    coarse = mesh.coarsen(labels)
    assert [len(loop) for loop in loops_of(coarse)] == [4, 4]
    assert coarse.cell_measures.tolist() == [0.5, 0.5]


def test_a_hole_that_touches_the_outer_boundary_is_a_loop_of_its_own() -> None:
    """Square 4 of 3 x 3 and its diagonal neighbour are missing from the agglomerate."""
    mesh = samples.squares(3)
    x, y = np.round(mesh.cell_centroids.T * 3 - 0.5).astype(int)
    labels = ((x == 1) & (y == 1)) | ((x == 0) & (y == 0))
    coarse = mesh.coarsen(labels.astype(int))
    sizes = sorted(len(loop) for loop in loops_of(coarse))
    assert sizes == [4, 12]  # the hole, and the outer loop with the notch
    assert polygons_of(coarse)[0].area == pytest.approx(7 / 9)


@settings(max_examples=30, deadline=None)
@given(labelled())
def test_loops_and_measures_agree(case: tuple[Mesh, np.ndarray]) -> None:
    mesh, labels = case
    coarse = mesh.coarsen(labels)
    loops = coarse.boundary_loops
    edges = 0
    for i, j in pairwise(loops.loop_offsets):
        assert len(set(loops.vertices[i:j].tolist())) == j - i >= 3
        edges += j - i
    assert edges == len(coarse.cell_faces[1])
    shapes = polygons_of(coarse)
    np.testing.assert_allclose(shapely.area(shapes), coarse.cell_measures, rtol=1e-9)
    centres = shapely.get_coordinates(shapely.centroid(shapes))
    np.testing.assert_allclose(centres, coarse.cell_centroids, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(shapely.length(shapes), perimeters(coarse), rtol=1e-9)
    fine = polygons_of(mesh)
    for label in range(coarse.n_cells):
        union = shapely.union_all(fine[labels == label])
        assert union.symmetric_difference(shapes[label]).area < 1e-9


def perimeters(mesh: Mesh) -> np.ndarray:
    owners = mesh.face_cells.ravel()
    length = np.repeat(mesh.face_measures, 2)
    return np.bincount(owners[owners >= 0], weights=length[owners >= 0], minlength=mesh.n_cells)


# --- coarsening ---------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(labelled())
def test_coarsening_keeps_measures_boundary_and_diameters(case: tuple[Mesh, np.ndarray]) -> None:
    mesh, labels = case
    coarse = mesh.coarsen(labels)
    np.testing.assert_allclose(coarse.cell_measures, np.bincount(labels, mesh.cell_measures), rtol=1e-9)
    moments = [np.bincount(labels, mesh.cell_measures * x) for x in mesh.cell_centroids.T]
    np.testing.assert_allclose(
        coarse.cell_centroids.T, np.array(moments) / coarse.cell_measures, rtol=1e-8, atol=1e-9
    )
    np.testing.assert_array_equal(coarse.origin, mesh.origin)
    outer = mesh.face_measures[mesh.face_cells[:, 1] < 0].sum()
    assert coarse.face_measures[coarse.face_cells[:, 1] < 0].sum() == pytest.approx(outer)
    corners = [mesh.points[loop] for loop in vertices_of(mesh)]
    for label in range(coarse.n_cells):
        cloud = np.concatenate([corners[c] for c in np.flatnonzero(labels == label)])
        assert coarse.cell_diameters[label] == pytest.approx(pdist(cloud).max(), rel=1e-12)


def vertices_of(mesh: Mesh) -> list[np.ndarray]:
    offsets, vertices = mesh.cell_vertices
    return np.split(vertices, offsets[1:-1])


@settings(max_examples=30, deadline=None)
@given(labelled())
def test_faces_close_around_every_cell_and_the_domain(case: tuple[Mesh, np.ndarray]) -> None:
    mesh, labels = case
    for each in (mesh, mesh.coarsen(labels)):
        vectors = each.face_normals * each.face_measures[:, None]
        total = np.zeros((each.n_cells, 2))
        np.add.at(total, each.face_cells[:, 0], vectors)
        inner = each.face_cells[:, 1] >= 0
        np.subtract.at(total, each.face_cells[inner, 1], vectors[inner])
        assert np.abs(total).max() < 1e-12
        assert np.abs(vectors[~inner].sum(axis=0)).max() < 1e-12


def test_coarsening_twice_is_coarsening_once() -> None:
    mesh = samples.random_triangles(60, seed=2)
    rng = np.random.default_rng(0)
    fine = compact(rng.integers(0, 20, mesh.n_cells))
    coarse = compact(rng.integers(0, 4, fine.max() + 1))
    once, twice = mesh.coarsen(coarse[fine]), mesh.coarsen(fine).coarsen(coarse)
    assert once.fingerprint == twice.fingerprint


def test_an_agglomerate_may_have_a_hole_and_several_faces_with_one_neighbour() -> None:
    mesh = samples.squares(3)
    labels = np.zeros(9, int)
    labels[np.argmin(np.linalg.norm(mesh.cell_centroids - 0.5, axis=1))] = 1
    coarse = mesh.coarsen(labels)
    np.testing.assert_allclose(coarse.cell_measures, [8 / 9, 1 / 9])
    np.testing.assert_allclose(coarse.cell_centroids, [[0.5, 0.5]] * 2)
    assert sorted(map(len, loops_of(coarse))) == [4, 12]
    np.testing.assert_allclose(coarse.graph.interface, [4 / 3, 4 / 3])


def test_tags_survive_coarsening_where_they_make_sense() -> None:
    mesh = Mesh.from_polygons(
        MIXED_POINTS, MIXED_CELLS, cell_tags={"same": [7, 7, 8], "mixed": np.array([1, 2, 3], np.int8)}
    )
    tagged = Mesh(
        mesh.points, mesh.face_offsets, mesh.face_vertices, mesh.face_cells, mesh.cell_tags,
        face_tags={"side": np.arange(7)},
    )  # fmt: skip
    coarse = tagged.coarsen([0, 0, 1])
    assert {name: values.tolist() for name, values in coarse.cell_tags.items()} == {"same": [7, 8]}
    kept = coarse.face_tags["side"]
    np.testing.assert_array_equal(coarse.face_pairs, mesh.face_pairs[kept])


def test_the_whole_domain_as_one_cell() -> None:
    mesh = samples.voronoi(60, seed=4)
    whole = mesh.coarsen(np.zeros(60, int))
    assert whole.cell_measures[0] == pytest.approx(1.0)
    assert whole.cell_diameters[0] == pytest.approx(np.sqrt(2))
    assert whole.graph.boundary[0] == pytest.approx(4.0)


# --- identity, and what is only 2-D -------------------------------------------------------------------


def test_different_meshes_have_different_fingerprints() -> None:
    a, b = samples.squares(4), samples.squares(4)
    assert a.fingerprint == b.fingerprint
    moved = Mesh.from_polygons(a.points + 1e-9, a.boundary_loops.vertices.reshape(-1, 4))
    assert a.fingerprint != moved.fingerprint
    assert a.fingerprint != a.coarsen(np.arange(16) // 2).fingerprint


@pytest.mark.parametrize("attribute", ["boundary_loops", "face_pairs"])
def test_what_exists_only_in_the_plane_says_so(attribute: str) -> None:
    with pytest.raises(MeshError, match=f"{attribute} exists only for 2-D"):
        getattr(samples.boxes(1), attribute)


def test_diameters_of_large_cells_are_those_of_their_hull() -> None:
    mesh = samples.voronoi(300, seed=9)
    labels = compact(np.floor(mesh.cell_centroids[:, 0] * 3).astype(int))
    coarse = mesh.coarsen(labels)
    for cell, vertices in enumerate(vertices_of(coarse)):
        cloud = coarse.points[vertices]
        assert coarse.cell_diameters[cell] == pytest.approx(pdist(cloud[ConvexHull(cloud).vertices]).max())


def test_public_names() -> None:
    assert agglo.Mesh is Mesh
    assert issubclass(MeshError, ValueError)


@pytest.mark.parametrize("mesh", [samples.squares(3), samples.boxes(2)], ids=["plane", "solid"])
def test_a_mesh_does_not_share_arrays_that_can_be_written_to(mesh: Mesh) -> None:
    points, cells, rock = mesh.points.copy(), mesh.face_cells.copy(), np.arange(mesh.n_cells)
    made = Mesh(points, mesh.face_offsets, mesh.face_vertices, cells, {"rock": rock})
    points *= 2
    cells[:] = 0
    rock += 1
    np.testing.assert_array_equal(made.points, mesh.points)
    np.testing.assert_array_equal(made.face_cells, mesh.face_cells)
    assert made.cell_tags["rock"].tolist() == list(range(mesh.n_cells))
    view = mesh.points.copy()
    view.flags.writeable = False
    assert np.shares_memory(Mesh(view, *(getattr(mesh, name) for name in ARRAYS)).points, view)


@pytest.mark.parametrize("mesh", [samples.squares(3), samples.boxes(2)], ids=["plane", "solid"])
def test_equal_meshes_have_equal_pickles_whatever_was_computed(mesh: Mesh) -> None:
    used = Mesh(mesh.points, *(getattr(mesh, name) for name in ARRAYS), name=mesh.name)
    before = pickle.dumps(used)
    assert used.graph.n == len(used.cell_diameters) == mesh.n_cells
    assert used.fingerprint == mesh.fingerprint
    assert pickle.dumps(used) == before
    copy = pickle.loads(before)
    assert copy.fingerprint == mesh.fingerprint
    assert not copy.points.flags.writeable
    np.testing.assert_array_equal(copy.cell_measures, mesh.cell_measures)
