"""Polyhedral meshes: exact volumes, faces however they are wound, coarsening, the hull as oracle."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial import ConvexHull, Delaunay
from scipy.spatial.distance import pdist

from agglo_core import Mesh, MeshError, samples
from agglo_core.mesh.elements import polyhedra_from_elements

CUBE = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
HEX = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]


def solid(mesh: Mesh, cell: int) -> list[list[int]]:
    """Faces of a cell as loops that are counter-clockwise seen from outside."""
    offsets, faces = mesh.cell_faces
    loops = []
    for f in faces[offsets[cell] : offsets[cell + 1]]:
        loop = mesh.face_vertices[mesh.face_offsets[f] : mesh.face_offsets[f + 1]].tolist()
        loops.append(loop if mesh.face_cells[f, 0] == cell else loop[::-1])
    return loops


def random_tetrahedra(n: int, seed: int) -> Mesh:
    points = np.random.default_rng(seed).random((n, 3))
    cells = Delaunay(points).simplices
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    volume = np.linalg.det(edges)
    cells = np.where(volume[:, None] > 0, cells, cells[:, [0, 2, 1, 3]])[np.abs(volume) > 1e-9]
    return Mesh.from_polyhedra(points, polyhedra_from_elements({"tetra": cells}))


def compact(labels: np.ndarray) -> np.ndarray:
    return np.unique(labels, return_inverse=True)[1]


# --- exact values -------------------------------------------------------------------------------------


def test_one_cube() -> None:
    mesh = Mesh.from_polyhedra(CUBE, [HEX])
    assert (mesh.dim, mesh.n_cells, mesh.n_faces, mesh.n_points) == (3, 1, 6, 8)
    assert mesh.cell_measures.tolist() == [1.0]
    assert mesh.cell_centroids.tolist() == [[0.5, 0.5, 0.5]]
    assert mesh.face_measures.tolist() == [1.0] * 6
    assert mesh.face_normals.tolist() == [[0, 0, -1], [0, 0, 1], [0, -1, 0], [0, 1, 0], [-1, 0, 0], [1, 0, 0]]
    assert mesh.h == np.sqrt(3)
    assert dict(mesh.repairs) == {}
    assert mesh.graph.boundary.tolist() == [6.0]


def test_elements_of_every_kind() -> None:
    points = [*CUBE.tolist(), [0.5, 0.5, 2], [2, 0, 0], [2, 0, 1], [0, -1, 0]]
    blocks = {
        "hexahedron": [[0, 1, 3, 2, 4, 5, 7, 6]],
        "pyramid": [[4, 5, 7, 6, 8]],
        "wedge": [[1, 3, 9, 5, 7, 10]],
        "tetra": [[0, 11, 1, 4]],
    }
    mesh = Mesh.from_polyhedra(points, polyhedra_from_elements(blocks), allow_gaps=True)  # half a square
    np.testing.assert_allclose(mesh.cell_measures, [1, 1 / 3, 1 / 2, 1 / 6])
    np.testing.assert_allclose(mesh.cell_centroids[1], [0.5, 0.5, 1.25])
    np.testing.assert_allclose(mesh.cell_centroids[2], [4 / 3, 1 / 3, 0.5])
    assert mesh.graph.to_scipy().toarray()[0].tolist() == [0, 1, 1, 0]


def test_boxes() -> None:
    mesh = samples.boxes(3)
    np.testing.assert_allclose(mesh.cell_measures, 1 / 27)
    np.testing.assert_allclose(mesh.face_measures, 1 / 9)
    assert mesh.n_faces == 3 * 4 * 9
    neighbours = np.diff(mesh.graph.indptr)
    assert np.bincount(neighbours).tolist() == [0, 0, 0, 8, 12, 6, 1]
    assert mesh.graph.boundary.sum() == pytest.approx(6)
    assert mesh.h == pytest.approx(np.sqrt(3) / 3)


@pytest.mark.parametrize("seed", range(3))
def test_tetrahedra_fill_their_hull(seed: int) -> None:
    mesh = random_tetrahedra(30, seed)
    hull = ConvexHull(mesh.points)
    assert mesh.cell_measures.sum() == pytest.approx(hull.volume)
    assert mesh.face_measures[mesh.face_cells[:, 1] < 0].sum() == pytest.approx(hull.area)
    corners = [np.unique(np.concatenate(solid(mesh, c))) for c in range(mesh.n_cells)]
    middles = [mesh.points[v].mean(axis=0) for v in corners]
    np.testing.assert_allclose(mesh.cell_centroids, middles, atol=1e-10)
    np.testing.assert_allclose(mesh.cell_diameters, [pdist(mesh.points[v]).max() for v in corners])


def test_far_from_the_origin() -> None:
    near = samples.boxes(4)
    cells = [solid(near, c) for c in range(64)]
    far = Mesh.from_polyhedra(near.points + 1e9, cells)
    np.testing.assert_array_equal(far.cell_measures, near.cell_measures)
    np.testing.assert_array_equal(far.cell_diameters, near.cell_diameters)


# --- faces in any direction ---------------------------------------------------------------------------


def test_half_faces_and_lists_are_the_same_mesh() -> None:
    mesh = samples.tetrahedra(2)
    cells = [solid(mesh, c) for c in range(mesh.n_cells)]
    loops = [loop for cell in cells for loop in cell]
    csr = (
        np.cumsum([0, *map(len, cells)]),
        np.cumsum([0, *map(len, loops)]),
        np.concatenate(loops),
    )
    listed, given = Mesh.from_polyhedra(mesh.points, cells), Mesh.from_polyhedra(mesh.points, csr)
    assert listed.fingerprint == given.fingerprint == mesh.fingerprint


@pytest.mark.parametrize("turned", list(product([False, True], repeat=6)))
def test_every_choice_of_winding_gives_the_same_cube(turned: tuple[bool, ...]) -> None:
    faces = [face[::-1] if turn else face for face, turn in zip(HEX, turned, strict=True)]
    mesh = Mesh.from_polyhedra(CUBE, [faces])
    assert mesh.cell_measures.tolist() == [1.0]
    assert mesh.face_normals.sum(axis=0).tolist() == [0, 0, 0]
    assert ((mesh.face_normals * (mesh.points[mesh.face_vertices[::4]] - 0.5)).sum(axis=1) > 0).all()
    assert mesh.repairs.get("faces turned outward", 0) == sum(turned)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 5))
def test_winding_of_concave_agglomerates_is_repaired(seed: int, parts: int) -> None:
    """Connected parts of a block of cubes: H shapes, rings, parts that touch themselves along edges."""
    rng = np.random.default_rng(seed)
    boxes = samples.boxes(3)
    labels = compact(boxes.graph.components(compact(rng.integers(0, parts, 27))))
    coarse = boxes.coarsen(labels)
    cells = [solid(coarse, c) for c in range(coarse.n_cells)]
    again = Mesh.from_polyhedra(coarse.points, cells)
    np.testing.assert_allclose(again.cell_measures, coarse.cell_measures, rtol=1e-12)
    np.testing.assert_allclose(again.cell_centroids, coarse.cell_centroids, atol=1e-12)
    assert "faces turned outward" not in again.repairs
    inverted = Mesh.from_polyhedra(coarse.points, [[loop[::-1] for loop in cell] for cell in cells])
    np.testing.assert_allclose(inverted.cell_measures, coarse.cell_measures, rtol=1e-12)


def test_a_concave_cell_wound_at_random() -> None:
    """An H of seven cubes: both walls of a notch look towards the middle, and their vectors cancel."""
    boxes = samples.boxes(3)
    x, y, z = np.round(boxes.cell_centroids.T * 3 - 0.5).astype(int)
    h = (z == 1) & ((x != 1) | (y == 1))
    cell = solid(boxes.coarsen(h.astype(int)), 1)
    rng = np.random.default_rng(0)
    for _ in range(20):
        turned = [loop[::-1] if rng.random() < 0.5 else loop for loop in cell]
        mesh = Mesh.from_polyhedra(boxes.points, [turned])
        assert mesh.cell_measures[0] == pytest.approx(7 / 27)


def test_a_mixture_of_cells_is_repaired_cell_by_cell() -> None:
    mesh = random_tetrahedra(20, 5)
    rng = np.random.default_rng(1)
    cells = [[loop[:: rng.choice([1, -1])] for loop in solid(mesh, c)] for c in range(mesh.n_cells)]
    np.testing.assert_allclose(Mesh.from_polyhedra(mesh.points, cells).cell_measures, mesh.cell_measures)


def test_orphans_and_equal_points() -> None:
    points = np.concatenate((CUBE, np.add(CUBE, [1, 0, 0]), [[9, 9, 9]]))
    right = [[v + 8 for v in face] for face in HEX]
    mesh = Mesh.from_polyhedra(points, [HEX, right], merge_points=True, cell_tags={"m": [4, 5]})
    assert dict(mesh.repairs) == {"equal points merged": 4, "orphan points dropped": 1}
    assert mesh.graph.interface.tolist() == [1.0, 1.0]
    assert mesh.graph.data["m"].tolist() == [4, 5]


def test_faces_split_by_a_neighbour_may_leave_hanging_edges() -> None:
    """The top of the cube is two rectangles; the sides do not list the points in the middle."""
    points = [*CUBE.tolist(), [0.5, 0, 1], [0.5, 1, 1]]
    faces = [HEX[0], [4, 8, 9, 6], [8, 5, 7, 9], *HEX[2:]]
    assert Mesh.from_polyhedra(points, [faces]).cell_measures.tolist() == [1.0]


# --- coarsening ---------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 6), st.sampled_from(["boxes", "tetrahedra", "random"]))
def test_coarsening(seed: int, parts: int, kind: str) -> None:
    meshes = {"boxes": samples.boxes(3), "tetrahedra": samples.tetrahedra(2)}
    mesh = meshes.get(kind) or random_tetrahedra(15, seed)
    labels = compact(np.random.default_rng(seed).integers(0, parts, mesh.n_cells))
    coarse = mesh.coarsen(labels)
    np.testing.assert_allclose(coarse.cell_measures, np.bincount(labels, mesh.cell_measures), rtol=1e-10)
    moments = np.array([np.bincount(labels, mesh.cell_measures * x) for x in mesh.cell_centroids.T])
    np.testing.assert_allclose(coarse.cell_centroids.T, moments / coarse.cell_measures, atol=1e-9)
    offsets, vertices = mesh.cell_vertices
    for label in range(coarse.n_cells):
        cells = np.flatnonzero(labels == label)
        corners = np.unique(np.concatenate([vertices[offsets[c] : offsets[c + 1]] for c in cells]))
        assert coarse.cell_diameters[label] == pytest.approx(pdist(mesh.points[corners]).max(), rel=1e-12)
    vectors = coarse.face_normals * coarse.face_measures[:, None]
    inner = coarse.face_cells[:, 1] >= 0
    total = np.zeros((coarse.n_cells, 3))
    np.add.at(total, coarse.face_cells[:, 0], vectors)
    np.subtract.at(total, coarse.face_cells[inner, 1], vectors[inner])
    assert np.abs(total).max() < 1e-12
    assert np.abs(vectors[~inner].sum(axis=0)).max() < 1e-12


def test_a_cavity() -> None:
    mesh = samples.boxes(3)
    labels = np.zeros(27, int)
    labels[np.argmin(np.linalg.norm(mesh.cell_centroids - 0.5, axis=1))] = 1
    coarse = mesh.coarsen(labels)
    np.testing.assert_allclose(coarse.cell_measures, [26 / 27, 1 / 27])
    np.testing.assert_allclose(coarse.cell_centroids, 0.5)
    cells = [solid(coarse, 0), solid(coarse, 1)]
    again = Mesh.from_polyhedra(coarse.points, cells)
    np.testing.assert_allclose(again.cell_measures, [26 / 27, 1 / 27])


def test_plane_things_are_refused_in_3d() -> None:
    with pytest.raises(MeshError, match="2-D"):
        _ = samples.boxes(1).boundary_loops
