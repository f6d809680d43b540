"""Shape metrics in space: hand values, hulls and half-spaces of scipy as oracles, slow loops."""

from __future__ import annotations

import math
from itertools import combinations, pairwise

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection
from solid_parts import MESHES, area_vector, outer_faces, planes, prism, ragged, turned

from agglo_core import samples
from agglo_core.arrays import frozen_float, frozen_index, frozen_int
from agglo_core.errors import MeshError
from agglo_core.mesh import Mesh
from agglo_core.shapes.round_shapes import IsoperimetricQuotient
from agglo_core.shapes.shape_metrics import BoxRatio, Convexity, EdgeRatio, FaceRatio, StarShapedness
from agglo_core.shapes.solid_boxes import solid_box_ratios
from agglo_core.shapes.solid_hulls import solid_hulls
from agglo_core.shapes.solid_triangles import face_triangles

EVERY = {
    "isoperimetric": IsoperimetricQuotient(),
    "convexity": Convexity(),
    "star_shapedness": StarShapedness(),
    "box_ratio": BoxRatio(),
    "face_ratio": FaceRatio(),
}


def measured(mesh: Mesh, labels: np.ndarray) -> dict[str, np.ndarray]:
    return {name: metric.measure(mesh, np.asarray(labels)) for name, metric in EVERY.items()}


# -- hand values --------------------------------------------------------------------------------

_CUBES = {
    "cube": (2, np.zeros(8, int), (math.pi / 6, 1, 1, 1, 1)),
    "L": (2, np.repeat([0, 0, 0, 1], 2), (36 * math.pi * 36 / 22**3, 6 / 7, 1 / 3, 1, 1 / 2)),
    "without a corner": (
        2,
        np.append(np.zeros(7, int), 1),
        (36 * math.pi * 49 / 24**3, 7 / (8 - 1 / 6), 1 / 7, 1, 1 / 4),
    ),
    "hollow": (3, (np.arange(27) == 13).astype(int), (36 * math.pi * 26**2 / 60**3, 26 / 27, 0, 1, 1 / 9)),
    "touching": (
        2,
        np.array([0, 1, 1, 1, 1, 1, 1, 0]),
        (36 * math.pi * 4 / 12**3, 1 / 2, 0, None, 1),
    ),
    "apart": (3, np.where(np.arange(27) // 9 == 1, 1, 0), (36 * math.pi * 18**2 / 60**3, 2 / 3, 0, 1, 1 / 3)),
}


@pytest.mark.parametrize("moved", [False, True])
@pytest.mark.parametrize(("n", "labels", "expected"), _CUBES.values(), ids=_CUBES)
def test_cubes_are_exact(n: int, labels: np.ndarray, expected: tuple[float, ...], moved: bool) -> None:
    mesh = samples.boxes(n)
    values = measured(turned(mesh) if moved else mesh, labels)
    for (name, value), wanted in zip(values.items(), expected, strict=True):
        if wanted is not None:
            assert value[0] == pytest.approx(wanted, rel=1e-9, abs=1e-9), name


@pytest.mark.parametrize("height", [0.4, 3.0])
@pytest.mark.parametrize("n", [3, 4, 6, 8])
def test_prisms_are_exact(n: int, height: float) -> None:
    values = measured(turned(prism(n, height)), np.zeros(1, int))
    area, side = n / 2 * math.sin(2 * math.pi / n), 2 * math.sin(math.pi / n)
    across = 2 * math.cos(math.pi / n) if n % 2 == 0 else 1 + math.cos(math.pi / n)
    long = {3: side, 4: across, 6: 2.0, 8: across}[n]
    expected = {
        "isoperimetric": 36 * math.pi * (area * height) ** 2 / (2 * area + n * side * height) ** 3,
        "convexity": 1.0,
        "star_shapedness": 1.0,
        "box_ratio": min(height, across) / max(height, long),
        "face_ratio": min(area / (side * height), side * height / area),
    }
    for name, value in expected.items():
        assert values[name][0] == pytest.approx(value, rel=1e-9), name


def test_a_regular_tetrahedron_is_exact() -> None:
    points = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)], float)
    mesh = Mesh.from_polyhedra(points, [[[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]])
    values = measured(turned(mesh), np.zeros(1, int))
    assert values["isoperimetric"][0] == pytest.approx(math.pi / (6 * math.sqrt(3)))
    assert values["box_ratio"][0] == pytest.approx(1.0)  # edges are diagonals of the faces of a cube
    assert values["face_ratio"][0] == pytest.approx(1.0)


# -- oracles ------------------------------------------------------------------------------------


def _slow_rectangle(points: np.ndarray) -> tuple[float, float]:
    """Sides of the narrowest rectangle around points of the plane."""
    corners = points[ConvexHull(points).vertices]
    along = np.roll(corners, -1, axis=0) - corners
    along = along[np.hypot(*along.T) > 1e-8 * np.ptp(points)]
    along /= np.hypot(*along.T)[:, None]
    sides = [(np.ptp(corners @ [-u[1], u[0]]), np.ptp(corners @ u)) for u in along]
    narrow = min(side[0] for side in sides)
    return narrow, min(side[1] for side in sides if side[0] < narrow * (1 + 1e-9))


def slow_box_ratio(points: np.ndarray) -> float:
    """The narrowest of the boxes along normals of faces, and of all pairs of edges of the hull."""
    hull = ConvexHull(points)
    corners = points[hull.vertices]
    pairs = {tuple(sorted(pair)) for simplex in hull.simplices for pair in combinations(simplex.tolist(), 2)}
    edges = np.array([points[b] - points[a] for a, b in sorted(pairs)])
    edges /= np.linalg.norm(edges, axis=1)[:, None]
    across = np.cross(edges[:, None], edges).reshape(-1, 3)
    sizes = np.linalg.norm(across, axis=1)
    across = across[sizes > 1e-6] / sizes[sizes > 1e-6, None]
    directions = np.concatenate((hull.equations[:, :3], across))
    widths = np.ptp(corners @ directions.T, axis=0)
    ratios = [0.0]
    for normal in directions[widths < widths.min() * (1 + 1e-9)]:
        plane = np.linalg.svd(normal[None])[2][1:]
        ratios.append(widths.min() / _slow_rectangle(corners @ plane.T)[1])
    return max(ratios)


def slow_kernel_volume(faces: list[np.ndarray]) -> float:
    """Intersection of half-spaces about the centre of the largest ball in all of them."""
    half = planes(faces)
    limits = np.column_stack((half[:, :3], np.ones(len(half))))
    best = linprog([0, 0, 0, -1], limits, -half[:, 3], bounds=[(None, None)] * 3 + [(0, None)])
    if best.status != 0 or best.x[3] < 1e-9:
        return 0.0
    return ConvexHull(HalfspaceIntersection(half, best.x[:3]).intersections).volume


def _slow_face_ratio(faces: list[np.ndarray]) -> float:
    """Areas of patches of faces that share an edge and have one normal."""
    half = planes(faces)
    areas = [np.linalg.norm(area_vector(corners)) for corners in faces]
    loops = [[*map(tuple, corners), tuple(corners[0])] for corners in faces]
    edges = [{frozenset(pair) for pair in pairwise(loop)} for loop in loops]
    patch = list(range(len(faces)))
    for i, j in combinations(range(len(faces)), 2):
        if half[i, :3] @ half[j, :3] > 1 - 1e-12 and edges[i] & edges[j]:
            patch = [patch[i] if p == patch[j] else p for p in patch]
    sums = [sum(a for a, q in zip(areas, patch, strict=True) if q == p) for p in set(patch)]
    return min(sums) / max(sums)


def _check_shapes(mesh: Mesh, labels: np.ndarray, parts: range) -> None:
    values = measured(mesh, labels)
    measures = np.bincount(labels, mesh.cell_measures)
    for part in parts:
        faces = outer_faces(mesh, labels, part)
        corners = np.unique(np.concatenate(faces), axis=0)
        surface = sum(np.linalg.norm(area_vector(each)) for each in faces)
        expected = {
            "isoperimetric": 36 * math.pi * measures[part] ** 2 / surface**3,
            "convexity": measures[part] / ConvexHull(corners).volume,
            "star_shapedness": slow_kernel_volume(faces) / measures[part],
            "box_ratio": slow_box_ratio(corners),
            "face_ratio": _slow_face_ratio(faces),
        }
        for name, value in expected.items():
            assert values[name][part] == pytest.approx(value, rel=1e-6, abs=1e-6), (name, part)


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("swaps", [0.0, 0.05])
def test_agree_with_slow_references(name: str, swaps: float) -> None:
    mesh = MESHES[name]()
    _check_shapes(mesh, ragged(mesh, 40, seed=3, swaps=swaps), range(3))


@pytest.mark.slow
@pytest.mark.parametrize("name", MESHES)
def test_agree_with_slow_references_on_many(name: str) -> None:
    mesh = MESHES[name]()
    for seed, swaps in ((5, 0.0), (6, 0.05)):
        labels = ragged(mesh, 45, seed=seed, swaps=swaps)
        _check_shapes(mesh, labels, range(min(labels.max() + 1, 12)))


def _of_clouds(
    points: np.ndarray, offsets: np.ndarray
) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, ...]]:
    """Return volumes and box ratios of clouds, and their hulls; arrays have the types of the metrics."""
    points, offsets = frozen_float(points), frozen_int(offsets)
    volumes, ends, triangles, beside = solid_hulls(points, offsets, frozen_index(np.arange(len(points))))
    hulls = frozen_int(ends), frozen_index(triangles), frozen_index(beside)
    return volumes, solid_box_ratios(points, *hulls), hulls


def test_hulls_agree_with_scipy_and_boxes_with_slow_loops() -> None:
    rng = np.random.default_rng(0)
    clouds = [rng.normal(size=(n, 3)) for n in rng.integers(4, 60, 6)]
    for n in rng.integers(9, 60, 6):  # grids: many points in planes and on lines
        grid = np.unique(rng.integers(0, 4, size=(n, 3)).astype(float), axis=0)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        clouds += [grid, 1e-3 * grid @ turn + 1.0]
    offsets = np.cumsum([0, *map(len, clouds)])
    volumes, ratios, (ends, triangles, beside) = _of_clouds(np.concatenate(clouds), offsets)
    for c, cloud in enumerate(clouds):
        assert volumes[c] == pytest.approx(ConvexHull(cloud).volume, rel=1e-9)
        assert ratios[c] == pytest.approx(slow_box_ratio(cloud), rel=1e-6)
        rows = np.arange(ends[c], ends[c + 1])
        for row in rows:
            for side in range(3):
                shared = {*triangles[row][[side, (side + 1) % 3]]}
                assert shared <= {*triangles[beside[row, side]]}
                assert row in beside[beside[row, side]]


def test_thin_and_distant_hulls_keep_their_digits() -> None:
    cube = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    for scale in ((1e3, 1, 1e-3), (1, 1, 1e-6), (1, 1e-5, 1e-5)):
        volumes, ratios, _ = _of_clouds(cube * scale, np.array([0, 8]))
        assert volumes[0] == pytest.approx(np.prod(scale), rel=1e-9)
        assert ratios[0] == pytest.approx(min(scale) / max(scale), rel=1e-6)


# -- triangles of faces -------------------------------------------------------------------------

_STAR = [
    (math.cos(t) * r, math.sin(t) * r, 0.0)
    for t, r in zip(np.arange(12) * math.pi / 6, [2, 1] * 6, strict=True)
]
_FACES = {
    "square": [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)],
    "corners in line": [
        (0, 0, 0),
        (1, 0, 0),
        (2, 0, 0),
        (2, 1, 0),
        (2, 2, 0),
        (1, 2, 0),
        (0, 2, 0),
        (0, 1, 0),
    ],
    "notched": [(0, 0, 0), (3, 0, 0), (3, 3, 0), (2, 3, 0), (2, 1, 0), (1, 1, 0), (1, 3, 0), (0, 3, 0)],
    "star": _STAR,
}


@pytest.mark.parametrize("shift", range(4))
@pytest.mark.parametrize("corners", _FACES.values(), ids=_FACES)
def test_triangles_tile_a_face(corners: list[tuple[float, ...]], shift: int) -> None:
    points = np.roll(np.array(corners, float), shift, axis=0)
    n = len(points)
    vector = sum(np.cross(points[i], points[(i + 1) % n]) for i in range(n)) / 2
    starts, triangles = face_triangles(
        frozen_float(points), frozen_int([0, n]), frozen_int(np.arange(n)), frozen_float(vector[None])
    )
    assert starts.tolist() == [0, n - 2]
    a, b, c = points[triangles].transpose(1, 0, 2)
    areas = np.cross(b - a, c - a)[:, 2] / 2
    assert (areas > 1e-3).all()
    assert areas.sum() == pytest.approx(vector[2])


def test_a_face_that_is_not_flat_counts_as_its_triangles() -> None:
    mesh = samples.boxes(1)
    points = mesh.points.copy()
    points[np.flatnonzero((points == 1).all(axis=1))] += 0.5
    bent = Mesh(points, mesh.face_offsets, mesh.face_vertices, mesh.face_cells)
    values = measured(bent, np.zeros(1, int))
    hull = ConvexHull(points).volume
    assert values["convexity"][0] == pytest.approx(min(bent.cell_measures[0] / hull, 1.0))
    assert 0 < values["face_ratio"][0] < 1


# -- declarations and refusals ------------------------------------------------------------------


def test_edges_in_space_are_refused() -> None:
    with pytest.raises(MeshError, match="metric edge_ratio exists only for 2-D meshes"):
        EdgeRatio().measure(samples.boxes(2), np.repeat([0, 1], 4))


def test_a_cell_without_extent_is_an_error() -> None:
    flat = turned(samples.boxes(1))
    points = samples.boxes(1).points * (1.0, 1.0, 1e-14)
    thin = Mesh(points, flat.face_offsets, flat.face_vertices, flat.face_cells)
    with pytest.raises(MeshError, match="agglomerate 0 is too thin"):
        Convexity().measure(thin, np.zeros(1, int))


@pytest.mark.parametrize("name", EVERY)
def test_declared_bounds_hold_and_the_coarse_mesh_gives_the_same(name: str) -> None:
    metric = EVERY[name]
    mesh = samples.voronoi3d(200, seed=7)
    labels = ragged(mesh, 20, seed=7, swaps=0.03)
    values = metric.measure(mesh, labels)
    assert values.shape == (labels.max() + 1,)
    assert ((values >= 0) & (values <= 1)).all()
    coarse = mesh.coarsen(labels)
    np.testing.assert_array_equal(metric.measure(coarse, np.arange(coarse.n_cells)), values)
