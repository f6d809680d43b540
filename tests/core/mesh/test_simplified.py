"""Meshes with fewer faces: exact where straight, valid within a tolerance, told what changed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings, strategies as st

from agglo_core import Diffusion, Hierarchy, Mesh, OptionError, Registry, agglomerate, read, samples, write
from agglo_core.arrays import frozen_float, frozen_int
from agglo_core.hierarchy import by_first_cell
from agglo_core.mesh.kernels.cell_crossings import mark_crossings
from agglo_core.mesh.kernels.edge_chains import thin_chains
from agglo_core.mesh.kernels.patch_loops import outlines


def compact(labels: np.ndarray) -> np.ndarray:
    return np.unique(labels, return_inverse=True)[1]


def random_parts(mesh: Mesh, k: int, seed: int, scattered: float) -> np.ndarray:
    """Labels: cells by the nearest of k points, some of them anybody's: islands, holes, loose pieces."""
    rng = np.random.default_rng(seed)
    seeds = mesh.cell_centroids[rng.integers(0, mesh.n_cells, k)]
    labels = ((mesh.cell_centroids[:, None] - seeds) ** 2).sum(axis=2).argmin(axis=1)
    loose = rng.random(mesh.n_cells) < scattered
    labels[loose] = rng.integers(0, k, loose.sum())
    return compact(labels)


@st.composite
def coarse(draw: st.DrawFn) -> Mesh:
    kind, seed = (
        draw(st.sampled_from(["voronoi", "triangles", "squares", "hexagons"])),
        draw(st.integers(0, 10**6)),
    )
    mesh = {
        "voronoi": lambda: samples.voronoi(120, seed=seed),
        "triangles": lambda: samples.random_triangles(80, seed=seed),
        "squares": lambda: samples.squares(11),
        "hexagons": lambda: samples.hexagons(9),
    }[kind]()
    scattered = draw(st.sampled_from([0.0, 0.02, 0.3]))
    return mesh.coarsen(random_parts(mesh, draw(st.integers(1, 25)), seed, scattered))


def same_geometry(a: Mesh, b: Mesh) -> None:
    size = np.ptp(b.local_points[np.unique(b.face_vertices)], axis=0).max()
    np.testing.assert_allclose(a.cell_measures, b.cell_measures, rtol=1e-12)
    np.testing.assert_allclose(a.cell_centroids, b.cell_centroids, atol=1e-12 * size)
    np.testing.assert_allclose(a.cell_diameters, b.cell_diameters, rtol=1e-12)
    np.testing.assert_allclose(a.cell_inertias, b.cell_inertias, rtol=1e-11)
    np.testing.assert_array_equal(a.graph.indices, b.graph.indices)
    np.testing.assert_allclose(a.graph.interface, b.graph.interface, rtol=1e-12)
    np.testing.assert_allclose(a.graph.boundary, b.graph.boundary, rtol=1e-12, atol=1e-13 * size)


# --- exact, in the plane -----------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(coarse())
def test_nothing_but_the_number_of_faces_changes(mesh: Mesh) -> None:
    made = mesh.simplified()
    same_geometry(made, mesh)
    record = made.simplification
    assert record is not None
    assert record.exact
    assert mesh.n_faces - made.n_faces == record.faces_saved >= 0
    assert record.vertices_saved == len(np.unique(mesh.face_vertices)) - made.n_points
    np.testing.assert_array_equal(made.points, mesh.points[record.points])
    np.testing.assert_array_equal(np.sort(made.face_cells[record.faces]), np.sort(mesh.face_cells))
    again = made.simplified()
    assert again.fingerprint == made.fingerprint
    assert again.simplification.faces_saved == 0
    assert made.coarsen(np.zeros(made.n_cells, int)).simplification is None


def straight_vertices(mesh: Mesh) -> int:
    """How many vertices have just two edges, on one line, between the same cells; whole coordinates."""
    points = np.round(mesh.points).astype(int)
    edges: dict[int, list[int]] = {}
    for face, pair in enumerate(mesh.face_pairs.tolist()):
        for vertex in pair:
            edges.setdefault(vertex, []).append(face)
    count = 0
    for vertex, own in edges.items():
        if len(own) == 2 and len({tuple(sorted(mesh.face_cells[face].tolist())) for face in own}) == 1:
            a, b = (points[mesh.face_pairs[face].sum() - vertex] - points[vertex] for face in own)
            count += a[0] * b[1] == a[1] * b[0]
    return count


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 30), st.integers(0, 10**6), st.sampled_from([0.0, 0.02, 0.3]))
def test_on_whole_coordinates_every_straight_vertex_goes_and_no_other(
    k: int, seed: int, scattered: float
) -> None:
    n = 12
    x, y = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0))
    low = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    cells = low[:, None] + [0, 1, n + 2, n + 1]
    rng = np.random.default_rng(seed)
    cells = np.concatenate((cells[:, :3], cells[:, [0, 2, 3]])) if rng.integers(2) else cells
    fine = Mesh.from_polygons(np.column_stack((x.ravel() + y.ravel(), y.ravel())), cells)
    mesh = fine.coarsen(random_parts(fine, k, seed, scattered))
    made = mesh.simplified()
    assert made.simplification.vertices_saved == made.simplification.faces_saved == straight_vertices(mesh)
    assert straight_vertices(made) == 0
    assert shapely.equals(made.to_shapely(), mesh.to_shapely()).all()


@pytest.mark.parametrize("angle", [0.3, 1.0, 2.0])
@pytest.mark.parametrize("far", [0.0, 1e3])
def test_rounding_does_not_hide_what_is_straight(angle: float, far: float) -> None:
    fine = samples.squares(16)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    x, y = np.round(fine.cell_centroids.T * 16 - 0.5).astype(int)
    fine = Mesh(fine.points @ turn + far, fine.face_offsets, fine.face_vertices, fine.face_cells)
    mesh = fine.coarsen(by_first_cell((x // 4) * 4 + y // 4)).simplified()
    assert (mesh.n_cells, mesh.n_faces, mesh.n_points) == (16, 40, 25)
    np.testing.assert_allclose(mesh.cell_measures, 1 / 16, rtol=1e-11 if far else 1e-13)


def test_a_slight_bend_is_kept() -> None:
    points = np.array([[0, 0], [1, 0], [2, 0], [2, 1], [0, 1]], float)
    for bend, n_faces in ((0.0, 4), (1e-16, 4), (1e-13, 5)):
        points[1, 1] = -bend
        assert Mesh.from_polygons(points, [[0, 1, 2, 3, 4]]).simplified().n_faces == n_faces


def test_tags_stay_with_their_cells_and_faces() -> None:
    fine = samples.squares(8)
    x = np.round(fine.cell_centroids[:, 0] * 8 - 0.5).astype(int)
    middle = fine.points[fine.face_pairs].mean(axis=1)
    wall, half = (middle[:, 0] == 0.5).astype(int), (middle[:, 1] > 0.5).astype(int)
    tags = {"wall": wall, "half": half}
    fine = Mesh(
        fine.points,
        fine.face_offsets,
        fine.face_vertices,
        fine.face_cells,
        {"material": x // 4},
        tags,
        {},
        "it",
    )
    mesh = fine.coarsen(x // 4)
    made = mesh.simplified()
    assert mesh.n_faces == 32 + 8
    assert made.n_faces == 4 + 2 + 2 + 2  # bottom and top, both sides and the wall in two pieces each
    assert made.face_tags["wall"].sum() == made.face_tags["half"][made.face_tags["wall"] == 1].size == 2
    for name in tags:
        np.testing.assert_array_equal(made.face_tags[name][made.simplification.faces], mesh.face_tags[name])
    np.testing.assert_array_equal(made.cell_tags["material"], mesh.cell_tags["material"])
    assert made.name == "it"


# --- within a tolerance ------------------------------------------------------------------------------------


def windings(mesh: Mesh, at: np.ndarray) -> np.ndarray:
    """How often the boundary of each cell winds around points ``(k, 2)``: (n_cells, k)."""
    total = np.zeros((mesh.n_cells, len(at)), int)
    pairs = mesh.points[mesh.face_pairs]
    for (p, q), (owner, other) in zip(pairs, mesh.face_cells, strict=True):
        u, v = p - at, q - at
        crosses = (u[:, 1] <= 0) != (v[:, 1] <= 0)
        left = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] > 0
        step = np.where(crosses & (left == (v[:, 1] > u[:, 1])), np.where(left, 1, -1), 0)
        total[owner] += step
        if other >= 0:
            total[other] -= step
    return total


def check_within(mesh: Mesh, made: Mesh, tolerance: float) -> None:
    """All that is promised of a mesh simplified within a tolerance."""
    record = made.simplification
    assert made.n_cells == mesh.n_cells
    assert made.cell_measures.sum() == pytest.approx(mesh.cell_measures.sum(), rel=1e-12)
    np.testing.assert_allclose(record.measure_change, made.cell_measures - mesh.cell_measures, atol=1e-15)
    assert (made.cell_measures >= 0.5 * mesh.cell_measures * (1 - 1e-12)).all()
    polygons = made.to_shapely()
    assert shapely.is_valid(polygons).all()
    np.testing.assert_allclose(shapely.area(polygons), made.cell_measures, rtol=1e-9)
    np.testing.assert_array_equal(made.graph.indices, mesh.graph.indices)
    np.testing.assert_allclose(made.graph.boundary, mesh.graph.boundary, rtol=1e-12, atol=1e-13)
    # every vertex of an old face near the face that took its place
    h = mesh.cell_diameters[mesh.face_cells]
    h[mesh.face_cells[:, 1] < 0] = 0.0
    ends = made.points[made.face_pairs[record.faces]]
    lines = shapely.linestrings(ends)
    for vertex in mesh.face_pairs.T:
        off = shapely.distance(shapely.points(mesh.points[vertex]), lines)
        assert (off <= tolerance * h.min(axis=1) * (1 + 1e-9) + 1e-14).all()


@settings(max_examples=50, deadline=None)
@given(coarse())
def test_cells_stay_valid_and_the_domain_as_it_is(mesh: Mesh) -> None:
    check_tiling(mesh, 0.1)


@settings(max_examples=50, deadline=None)
@given(coarse(), st.floats(0.001, 0.5))
def test_simplified_cells_tile_the_mesh_within_a_tolerance(mesh: Mesh, tolerance: float) -> None:
    check_tiling(mesh, tolerance)


def check_tiling(mesh: Mesh, tolerance: float) -> None:
    """Cells as promised, and each point of the domain in one of them."""
    assume(shapely.is_valid(mesh.to_shapely()).all())
    made = mesh.simplified(tolerance)
    check_within(mesh, made, tolerance)
    assert not made.simplification.exact
    assert made.n_faces <= mesh.simplified().n_faces
    at = np.random.default_rng([1, 2, 3]).random((40, 2))  # no vertices of samples
    found = windings(made, at)
    assert set(np.unique(found)) <= {0, 1}
    np.testing.assert_array_equal(found.sum(axis=0), windings(mesh, at).sum(axis=0))


@pytest.mark.parametrize("seed", range(5))
def test_agglomerates_of_random_meshes(seed: int) -> None:
    fine = samples.voronoi(600, seed=seed) if seed % 2 else samples.random_triangles(400, seed=seed)
    mesh = fine.coarsen(agglomerate(fine, bisector="coordinate", cells_per_part=10, seed=seed).levels[0])
    made = mesh.simplified(0.1)
    check_within(mesh, made, 0.1)
    assert made.n_faces < 0.8 * mesh.simplified().n_faces


def test_an_interface_that_would_take_a_cell_along_is_held_back() -> None:
    points = [[0, 0], [4, 0], [4, 4], [0, 4], [0, 2], [1, 2.3], [3, 2.3], [4, 2], [2, 2.2], [2, 2.4]]
    lens = [5, 8, 6, 9]  # between two cells, flat: straightened it would have no measure
    cells = [[0, 1, 7, 6, 8, 5, 4], lens, [4, 5, 9, 6, 7, 2, 3]]
    mesh = Mesh.from_polygons(points, cells)
    made = mesh.simplified(0.2)
    check_within(mesh, made, 0.2)
    assert made.simplification.held_back == 2
    assert made.simplification.faces_saved == 1  # one side of the lens, which keeps half its measure


def test_an_island_is_not_left_on_the_other_side() -> None:
    points = [[0, 0], [10, 0], [10, 10], [0, 10], [0, 5], [5, 6], [10, 5]]
    island = [[4.9, 5.4], [5.1, 5.4], [5.0, 5.6]]  # under the roof: a straight interface would pass below it
    hole = Mesh.from_polygons(points + island, [[0, 1, 6, 5, 4], [4, 5, 6, 2, 3], [7, 8, 9]], allow_gaps=True)
    faces = hole.face_cells.copy()
    inside = (faces[:, 0] == 2) & (faces[:, 1] < 0)
    faces[inside, 1] = 0  # the lower cell surrounds the island
    mesh = Mesh(hole.points, hole.face_offsets, hole.face_vertices, faces)
    assert mesh.cell_measures.sum() == pytest.approx(100)
    made = mesh.simplified(0.3)
    check_within(mesh, made, 0.3)
    assert made.simplification.held_back > 0
    assert made.n_faces == mesh.n_faces
    far = Mesh(mesh.points + np.array([0, -4.0]) * (np.arange(10) >= 7)[:, None], *(
        mesh.face_offsets, mesh.face_vertices, mesh.face_cells
    ))  # fmt: skip
    assert far.simplified(0.3).n_faces == far.n_faces - 1


@pytest.mark.parametrize("tolerance", [-0.1, 0.6, np.nan, np.inf])
def test_a_tolerance_is_a_small_number(tolerance: float) -> None:
    with pytest.raises(OptionError, match=r"tolerance must lie between 0 and 0\.5"):
        samples.squares(2).simplified(tolerance)


def test_files_keep_what_was_done(tmp_path: object) -> None:
    fine = samples.voronoi(100, seed=1)
    mesh = fine.coarsen(random_parts(fine, 9, 0, 0.0)).simplified(0.1)
    write(tmp_path / "it.npz", mesh)
    (text,) = read(tmp_path / "it.npz").repairs
    assert text == "faces fewer, interfaces moved within 0.1 of the cells"


# --- kernels beside their slow twins -----------------------------------------------------------------------


def distance(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    along = np.clip((points - a) @ (b - a) / max((b - a) @ (b - a), 1e-300), 0, 1)
    return np.linalg.norm(points - a - along[:, None] * (b - a), axis=1)


def douglas_peucker(points: np.ndarray, limit: float) -> list[int]:
    if len(points) < 3:
        return list(range(len(points)))
    off = distance(points[1:-1], points[0], points[-1])
    if off.max() <= limit:
        return [0, len(points) - 1]
    k = int(off.argmax()) + 1
    left, right = douglas_peucker(points[: k + 1], limit), douglas_peucker(points[k:], limit)
    return left[:-1] + [k + other for other in right]


@settings(max_examples=100, deadline=None)
@given(st.integers(2, 40), st.integers(0, 10**6), st.floats(0, 1), st.integers(2, 3), st.booleans())
def test_thinned_chains_stay_within_the_limit(n: int, seed: int, limit: float, d: int, closed: bool) -> None:
    rng = np.random.default_rng(seed)
    points = rng.random((n, d)).cumsum(axis=0) * 0.3 if rng.integers(2) else rng.random((n, d))
    closed = closed and n >= 3
    vertices = np.append(np.arange(n), 0) if closed else np.arange(n)
    keep = np.zeros(len(vertices), bool)
    offsets = frozen_int([0, len(vertices) - 1])
    thin_chains(
        frozen_float(points), offsets, frozen_int(vertices), frozen_float([limit]), frozen_int([0]), keep
    )
    kept = np.flatnonzero(keep)
    assert kept[0] == 0
    assert kept[-1] == len(vertices) - 1
    assert len(kept) >= (4 if closed else 2)
    for a, b in pairwise(kept):
        assert (
            distance(points[vertices[a : b + 1]], points[vertices[a]], points[vertices[b]]).max()
            <= limit + 1e-12
        )
    if not closed:
        assert set(kept) <= set(douglas_peucker(points, limit))
        for a, b, c in zip(
            kept, kept[1:], kept[2:], strict=False
        ):  # none that its neighbours could do without
            off = distance(points[a : c + 1], points[a], points[c])
            assert off.max() > limit - 1e-12 or set(kept) == set(douglas_peucker(points, limit)), b


@pytest.mark.parametrize(
    ("points", "closed", "kept"),
    [  # what is met first is the middle of a straight run, parallel to what it is seen from
        ([[0, 0], [0, 1], [1, 1 + 1e-15], [3, 1], [3, 0]], False, [0, 1, 3, 4]),
        ([[0, 0], [1, -1], [2, -1 - 1e-15], [3, -1], [4, 0], [2, 0.5]], True, [0, 1, 3, 4, 5, 6]),
        ([[0, 0], [4, 0], [2, 1]], True, [0, 1, 2, 3]),
        ([[0, 0], [1, 0]], True, [0, 1, 2]),
    ],
)
def test_straight_runs_lose_their_middle_whatever_is_seen_first(
    points: list[list[float]], closed: bool, kept: list[int]
) -> None:
    vertices = [*range(len(points)), *([0] if closed else [])]
    keep = np.zeros(len(vertices), bool)
    arrays = frozen_float(points), frozen_int([0, len(vertices) - 1]), frozen_int(vertices)
    thin_chains(*arrays, frozen_float([1e-13]), frozen_int([0]), keep)
    assert np.flatnonzero(keep).tolist() == kept


@settings(max_examples=100, deadline=None)
@given(st.integers(3, 9), st.integers(0, 10**6), st.booleans())
def test_cells_that_cross_themselves_are_found_as_shapely_does(n: int, seed: int, whole: bool) -> None:
    rng = np.random.default_rng(seed)
    points = rng.integers(0, 6, (n, 2)).astype(float) if whole else rng.random((n, 2))
    if len(np.unique(points, axis=0)) < n:
        return
    if rng.integers(2):  # a star around the middle, most often simple
        arm = points - points.mean(axis=0)
        points = points[np.argsort(np.arctan2(arm[:, 1], arm[:, 0]))]
    ring = shapely.linearrings(points)
    wanted = bool(shapely.is_valid(shapely.polygons(ring)) and shapely.is_ccw(ring))
    tails, heads = np.arange(n), np.roll(np.arange(n), -1)
    order = np.argsort(np.minimum(points[tails, 0], points[heads, 0]), kind="stable")
    bad = np.zeros(n, bool)
    arrays = frozen_float(points), frozen_int([0, n]), frozen_int(tails[order]), frozen_int(heads[order])
    mark_crossings(*arrays, frozen_int(np.arange(n)), frozen_int([0]), bad)
    assert bool(bad.any()) == (not wanted)


def test_outlines_are_single_loops_or_none() -> None:
    edges = [(0, 1), (2, 0), (1, 2)], [(5, 6), (6, 7), (7, 5), (5, 8), (8, 9), (9, 5)], [], [(3, 4), (4, 3)]
    two = [(10, 11), (11, 12), (12, 10), (13, 14), (14, 15), (15, 13)]
    open_end = [(1, 2), (2, 3)]
    every = [*edges, two, open_end]
    offsets = np.cumsum([0, *map(len, every)])
    tails, heads = np.array([edge for own in every for edge in own]).T
    vertices, whole = outlines(frozen_int(offsets), frozen_int(tails), frozen_int(heads), 16)
    assert whole.tolist() == [True, False, False, True, False, False]
    assert vertices[:3].tolist() == [0, 1, 2]
    assert vertices[9:11].tolist() == [3, 4]


# --- solids ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_flat_patches_of_solids_become_one_face(seed: int) -> None:
    rng = np.random.default_rng(seed)
    fine = samples.boxes(5) if seed % 2 else samples.tetrahedra(3)
    if seed % 3 == 0:
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        fine = Mesh(fine.points @ turn, fine.face_offsets, fine.face_vertices, fine.face_cells)
    mesh = fine.coarsen(random_parts(fine, int(rng.integers(1, 15)), seed, 0.3 if seed % 4 == 3 else 0.0))
    made = mesh.simplified()
    same_geometry(made, mesh)
    np.testing.assert_allclose(made.face_measures.sum(), mesh.face_measures.sum(), rtol=1e-12)
    faces = made.simplification.faces
    np.testing.assert_array_equal(np.sort(made.face_cells[faces]), np.sort(mesh.face_cells))
    np.testing.assert_allclose(np.bincount(faces, mesh.face_measures), made.face_measures, rtol=1e-12)
    same_way = np.where(made.face_cells[faces, 0] == mesh.face_cells[:, 0], 1, -1)[:, None]
    np.testing.assert_allclose(made.face_normals[faces] * same_way, mesh.face_normals, atol=1e-9)
    assert made.n_faces < mesh.n_faces
    assert made.simplified().fingerprint == made.fingerprint


def test_bricks_of_bricks_have_six_faces_and_eight_vertices() -> None:
    fine = samples.boxes(6)
    i, j, k = np.round(fine.cell_centroids.T * 6 - 0.5).astype(int)
    made = fine.coarsen(by_first_cell((i // 3) * 4 + (j // 3) * 2 + k // 3)).simplified()
    plain = samples.boxes(2)
    assert (made.n_faces, made.n_points, len(made.face_vertices)) == (36, 27, 144)
    np.testing.assert_allclose(made.cell_measures, 1 / 8)
    np.testing.assert_allclose(np.sort(made.points, axis=0), np.sort(plain.points, axis=0))


def test_a_patch_with_a_hole_stays_and_its_straight_edges_go() -> None:
    fine = samples.boxes(4)
    i, j, k = np.round(fine.cell_centroids.T * 4 - 0.5).astype(int)
    core = np.isin(i, (1, 2)) & np.isin(j, (1, 2)) & (k < 2)
    mesh = fine.coarsen(core.astype(int))  # a plug in the bottom of a cube
    made = mesh.simplified()
    same_geometry(made, mesh)
    around = (made.face_cells == [0, -1]).all(axis=1) & (made.face_normals[:, 2] < -0.5)
    assert around.sum() == 12  # the ring around the plug is no single loop
    assert made.n_faces == 12 + 5 + 5 + 1


@pytest.mark.parametrize(("bend", "n_faces"), [(0.0, 6), (4e-13, 21), (1e-9, 21)])
def test_a_patch_that_bends_little_by_little_is_not_flat(bend: float, n_faces: int) -> None:
    x = np.linspace(0, 1, 17)
    curve = np.append(np.stack((x, -bend * x**2), axis=1), [[1, 1], [0, 1]], axis=0)
    n = len(curve)
    points = np.concatenate([np.insert(curve, 2, z, axis=1) for z in (0.0, 1.0)])
    around = [[k, (k + 1) % n, n + (k + 1) % n, n + k] for k in range(n)]
    solid = Mesh.from_polyhedra(points, [[*around, list(range(n)), list(range(n, 2 * n))]])
    assert (solid.n_faces, solid.simplified().n_faces) == (21, n_faces)


def test_faces_of_solids_with_different_tags_stay_apart() -> None:
    fine = samples.boxes(2)
    middle = np.array(
        [fine.points[fine.face_vertices[a : a + 4]].mean(axis=0) for a in fine.face_offsets[:-1]]
    )
    tag = np.where((middle[:, 2] == 1) & (middle[:, 0] > 0.5), 7, 0)
    mesh = Mesh(fine.points, fine.face_offsets, fine.face_vertices, fine.face_cells, {}, {"inlet": tag})
    made = mesh.coarsen(np.zeros(8, int)).simplified()
    assert made.n_faces == 7
    assert sorted(made.face_tags["inlet"].tolist()) == [0] * 6 + [7]
    with pytest.raises(OptionError, match="tolerance must be 0 in 3-D"):
        mesh.simplified(0.1)


# --- solving -----------------------------------------------------------------------------------------------


def energy(registry: Registry, mesh: Mesh, problem: Diffusion, **options: object) -> float:
    solver = registry.build("solver", "direct", **options)
    solution = solver.solve(problem, Hierarchy(mesh, mesh.graph, [], [], True))
    system = solver.discretisation.assemble(problem, mesh)
    return float(solution.x @ (system.A @ solution.x))


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_energies_of_a_penalty_that_goes_by_heights_are_the_same(degree: int) -> None:
    from agglo_core.registry import default

    fine = samples.squares(12)
    problem = Diffusion(kappa=np.random.default_rng(degree).random(12) + 0.1, source=np.arange(12.0))
    x, y = np.round(fine.cell_centroids.T * 12 - 0.5).astype(int)
    mesh = fine.coarsen(by_first_cell((x // 3) * 4 + y // 4))
    before, after = (
        energy(default(), each, problem, degree=degree, penalty=10.0) for each in (mesh, mesh.simplified())
    )
    assert mesh.simplified().n_faces < 0.4 * mesh.n_faces
    assert after == pytest.approx(before, rel=1e-12)


@pytest.mark.parametrize("penalty", [10.0, "sharp"])
@pytest.mark.parametrize("seed", range(3))
def test_energies_are_the_same_whatever_the_penalty_where_the_solution_does_not_jump(
    seed: int, penalty: object
) -> None:
    from agglo_core.registry import default

    fine = samples.squares(12) if seed else samples.voronoi(150, seed=seed)
    mesh = fine.coarsen(random_parts(fine, 16, seed, 0.0))
    tag = np.where(mesh.face_cells[:, 1] < 0, 1, 0)
    mesh = Mesh(mesh.points, mesh.face_offsets, mesh.face_vertices, mesh.face_cells, {}, {"boundary": tag})

    def exact(p: np.ndarray) -> np.ndarray:
        return 1 + p[:, 0] - 2 * p[:, 1] + p[:, 0] ** 2 + 3 * p[:, 0] * p[:, 1]

    problem = Diffusion(source=-2.0, dirichlet={1: exact})
    found = []
    for each in (mesh, mesh.simplified()):
        solver = default().build("solver", "direct", degree=2, penalty=penalty)
        how = solver.discretisation
        solution = solver.solve(problem, Hierarchy(each, each.graph, [], [], True))
        np.testing.assert_allclose(solution.x, how.project(each, exact), atol=1e-10)
        found.append(solution.x)
    np.testing.assert_allclose(found[0], found[1], atol=1e-11)
    assert mesh.simplified().n_faces < mesh.n_faces
