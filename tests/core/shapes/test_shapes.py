"""Shape metrics: hand values, shapely and slow references as oracles, invariance under similarities."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings, strategies as st
from scipy.spatial import ConvexHull, cKDTree

from agglo_core import samples
from agglo_core.arrays import frozen_float, frozen_index, frozen_int
from agglo_core.errors import MeshError
from agglo_core.mesh import Mesh
from agglo_core.registry import default
from agglo_core.shapes.planar_shapes import box_ratios, convex_hulls
from agglo_core.shapes.round_shapes import IsoperimetricQuotient
from agglo_core.shapes.shape_metrics import BoxRatio, Convexity, EdgeRatio, StarShapedness

EVERY = {
    "isoperimetric": IsoperimetricQuotient(),
    "convexity": Convexity(),
    "star_shapedness": StarShapedness(),
    "box_ratio": BoxRatio(),
    "edge_ratio": EdgeRatio(),
}
L_SHAPE = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)]
CROSS = [(1, 0), (2, 0), (2, 1), (3, 1), (3, 2), (2, 2), (2, 3), (1, 3), (1, 2), (0, 2), (0, 1), (1, 1)]
U_SHAPE = [(0, 0), (3, 0), (3, 2), (2, 2), (2, 1), (1, 1), (1, 2), (0, 2)]


def _measured(mesh: Mesh, labels: np.ndarray | None = None) -> dict[str, np.ndarray]:
    labels = np.arange(mesh.n_cells) if labels is None else labels
    return {name: metric.measure(mesh, labels) for name, metric in EVERY.items()}


def _moved(points: np.ndarray, angle: float, factor: float, shift: tuple[float, float]) -> np.ndarray:
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    return factor * (np.asarray(points, float) @ turn) + shift


def _values(points, angle: float = 0.0, factor: float = 1.0, shift=(0.0, 0.0)) -> dict[str, float]:
    """Metrics of one polygon, turned, scaled and moved."""
    mesh = Mesh.from_polygons(_moved(points, angle, factor, shift), [range(len(points))])
    return {name: values[0] for name, values in _measured(mesh).items()}


def _ragged(mesh: Mesh, k: int, seed: int, swaps: float) -> np.ndarray:
    """Labels of about ``k`` agglomerates; with swaps they get holes, islands and pinch vertices."""
    rng = np.random.default_rng(seed)
    labels = cKDTree(rng.random((k, 2))).query(mesh.cell_centroids)[1]
    labels = np.where(rng.random(mesh.n_cells) < swaps, rng.integers(0, k, mesh.n_cells), labels)
    return np.unique(labels, return_inverse=True)[1]


def _parts(mesh: Mesh, labels: np.ndarray) -> list[shapely.Geometry]:
    """The agglomerates as united by shapely."""
    loops = mesh.boundary_loops
    cells = [
        shapely.Polygon(mesh.points[loops.vertices[a:b]]) for a, b in pairwise(loops.loop_offsets.tolist())
    ]
    members = [np.flatnonzero(labels == part) for part in range(labels.max() + 1)]
    return [shapely.union_all([cells[c] for c in cs]) for cs in members]


def _rings(shape: shapely.Geometry) -> list[np.ndarray]:
    """Closed rings of a shape, the inside on the left."""
    parts = shapely.get_parts(shapely.orient_polygons(shape, exterior_cw=False))
    return [shapely.get_coordinates(ring) for part in parts for ring in (part.exterior, *part.interiors)]


def _slow_kernel_area(shape: shapely.Geometry) -> float:
    """Intersection of half planes, each a square as large as anything that could matter."""
    rings = _rings(shape)
    if len(rings) > 1:
        return 0.0
    kernel = shape.envelope
    for a, b in pairwise(rings[0]):
        along = (b - a) / np.linalg.norm(b - a)
        left = np.array([-along[1], along[0]])
        corners = a + 10 * np.array([-along, along, along + left, left - along])
        kernel = kernel.intersection(shapely.Polygon(corners))
    return kernel.area


def _slow_box_ratio(shape: shapely.Geometry) -> float:
    """The narrowest of the boxes along the hull's edges."""
    corners = shapely.get_coordinates(shape.convex_hull)
    boxes = []
    for along in np.diff(corners, axis=0):
        along = along / np.linalg.norm(along)
        length, width = np.ptp(corners @ along), np.ptp(corners @ [-along[1], along[0]])
        boxes.append((width, width / length))
    return min(boxes)[1]


def _slow_edge_ratio(shape: shapely.Geometry) -> float:
    lengths = []
    for ring in _rings(shape):
        away = np.linalg.norm(ring[:-1] - ring[:-1].mean(axis=0), axis=1)
        corner = int(away.argmax())  # the farthest is a corner; simplify keeps the first vertex
        ring = shapely.LinearRing(np.roll(ring[:-1], -corner, axis=0)).simplify(1e-9, preserve_topology=False)
        lengths.extend(np.linalg.norm(np.diff(shapely.get_coordinates(ring), axis=0), axis=1))
    return min(lengths) / max(lengths)


# -- hand values --------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, 0.7])
@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ([(0, 0), (1, 0), (1, 1), (0, 1)], (math.pi / 4, 1, 1, 1, 1)),
        ([(0, 0), (4, 0), (4, 1), (0, 1)], (16 * math.pi / 100, 1, 1, 1 / 4, 1 / 4)),
        ([(0, 0), (2, 0), (4, 0), (4, 1), (1, 1), (0, 1)], (16 * math.pi / 100, 1, 1, 1 / 4, 1 / 4)),
        ([(0, 0), (1, 0), (0, 1)], (2 * math.pi / (2 + 2**0.5) ** 2, 1, 1, 1 / 2, 0.5**0.5)),
        (
            [(math.cos(t), math.sin(t)) for t in np.arange(6) * math.pi / 3],
            (math.pi / 12**0.5, 1, 1, 0.75**0.5, 1),
        ),
        (L_SHAPE, (20 * math.pi / 144, 5 / 7, 1 / 5, 2 / 3, 1 / 3)),
        (CROSS, (20 * math.pi / 144, 5 / 7, 1 / 5, 1, 1)),
        (U_SHAPE, (20 * math.pi / 144, 5 / 6, 0, 2 / 3, 1 / 3)),
    ],
    ids=["square", "rectangle", "hanging", "triangle", "hexagon", "L", "cross", "U"],
)
def test_hand_values(points, expected: tuple[float, ...], angle: float) -> None:
    values = _values(points, angle)
    np.testing.assert_allclose(list(values.values()), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("n", [12, 60])
def test_ring_is_exact(n: int) -> None:
    ring = samples.ring(n)
    values = _measured(ring, np.zeros(ring.n_cells, int))
    side = 2 * math.sin(math.pi / n)  # of the polygon inscribed in the unit circle; the hole has radius 1/2
    area = n / 2 * math.sin(2 * math.pi / n) * 0.75
    assert values["isoperimetric"][0] == pytest.approx(4 * math.pi * area / (1.5 * n * side) ** 2)
    assert values["convexity"][0] == pytest.approx(0.75)
    assert values["star_shapedness"][0] == 0.0
    assert values["edge_ratio"][0] == pytest.approx(0.5)


def test_parts_that_only_touch_are_not_star_shaped() -> None:
    diagonal = _measured(samples.squares(2), np.array([0, 1, 1, 0]))
    np.testing.assert_array_equal(diagonal["star_shapedness"], [0, 0])
    np.testing.assert_allclose(diagonal["convexity"], 2 / 3)
    np.testing.assert_allclose(diagonal["box_ratio"], 1 / 2)


def test_values_do_not_depend_on_the_cells_inside() -> None:
    halves = np.repeat([0, 1], [8, 8])
    for name, values in _measured(samples.squares(4), halves).items():
        np.testing.assert_allclose(values, _values([(0, 0), (2, 0), (2, 1), (0, 1)])[name], err_msg=name)


# -- oracles ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mesh", "k", "swaps"),
    [
        (samples.voronoi(600, seed=1), 60, 0.06),
        (samples.voronoi(600, seed=2), 200, 0.0),
        (samples.random_triangles(400, seed=3), 150, 0.0),
        (samples.triangles(14), 60, 0.1),
        (samples.squares(16), 60, 0.0),
    ],
    ids=["holes", "convex", "triangles", "pinches", "squares"],
)
def test_agree_with_shapely(mesh: Mesh, k: int, swaps: float) -> None:
    labels = _ragged(mesh, k, seed=3, swaps=swaps)
    values, shapes = _measured(mesh, labels), _parts(mesh, labels)
    expected = {
        "isoperimetric": [4 * math.pi * shape.area / shape.length**2 for shape in shapes],
        "convexity": [shape.area / shape.convex_hull.area for shape in shapes],
        "star_shapedness": [_slow_kernel_area(shape) / shape.area for shape in shapes],
        "box_ratio": [_slow_box_ratio(shape) for shape in shapes],
        "edge_ratio": [_slow_edge_ratio(shape) for shape in shapes],
    }
    for name, exact in expected.items():
        np.testing.assert_allclose(values[name], exact, rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("seed", range(3))
def test_hulls_agree_with_scipy_and_boxes_with_a_slow_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    counts = rng.integers(3, 60, 40)
    offsets = frozen_int(np.append(0, np.cumsum(counts)))
    points = frozen_float(rng.normal(size=(offsets[-1], 2)))
    vertices = frozen_index(np.arange(offsets[-1]))
    areas, hull_offsets, hull = convex_hulls(points, offsets, vertices)
    ratios = box_ratios(points, frozen_int(hull_offsets), frozen_int(hull))
    for c, (a, b) in enumerate(pairwise(offsets)):
        exact = ConvexHull(points[a:b])
        found = hull[hull_offsets[c] : hull_offsets[c + 1]]
        assert areas[c] == pytest.approx(exact.volume, rel=1e-12)
        turned = np.roll(exact.vertices + a, -int(np.flatnonzero(exact.vertices + a == found[0])[0]))
        np.testing.assert_array_equal(found, turned)
        assert ratios[c] == pytest.approx(_slow_box_ratio(shapely.MultiPoint(points[a:b])), rel=1e-9)


def test_repeated_and_collinear_vertices_leave_the_hull() -> None:
    points = frozen_float([(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1), (1, 1)])
    vertices = frozen_index([8, 4, 4, 1, 2, 0, 6, 7, 0, 3, 5, 2])
    areas, offsets, hull = convex_hulls(points, frozen_int([0, len(vertices)]), vertices)
    np.testing.assert_array_equal(areas, [4])
    np.testing.assert_array_equal(offsets, [0, 4])
    np.testing.assert_array_equal(hull, [0, 2, 4, 6])


def _star(radii: np.ndarray) -> np.ndarray:
    """Polygon around the origin, star-shaped about it."""
    t = np.arange(len(radii)) * 2 * np.pi / len(radii)
    return np.stack((radii * np.cos(t), radii * np.sin(t)), axis=1)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(0.3, 2.0), min_size=4, max_size=24))
def test_kernels_of_star_polygons_agree_with_half_planes(radii: list[float]) -> None:
    polygon = _star(np.array(radii))
    shape = shapely.Polygon(polygon)
    value = _values(polygon)["star_shapedness"]
    assert value > 0  # the origin sees everything
    assert value == pytest.approx(_slow_kernel_area(shape) / shape.area, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("teeth", [2, 3, 6])
def test_combs_are_not_star_shaped(teeth: int) -> None:
    top = [(x, y) for i in range(teeth) for x, y in ((2 * i, 1), (2 * i, 3), (2 * i + 1, 3), (2 * i + 1, 1))]
    comb = [(0, 0), (2 * teeth - 1, 0), *reversed(top[1:-1])]
    assert _values(comb)["star_shapedness"] == 0.0


def test_box_of_an_acute_triangle_lies_on_its_longest_side() -> None:
    for angle in np.linspace(0.0, 6.0, 40):  # sides 13, 14, 15: the boxes on all three have the same area
        values = _values([(0, 0), (14, 0), (5, 12)], angle)
        assert values["box_ratio"] == pytest.approx(168 / 15 / 15)


@settings(max_examples=25, deadline=None)
@given(length=st.floats(1.0, 9.0), dents=st.lists(st.floats(0.1, 0.9), max_size=5), angle=st.floats(0.0, 6.3))
def test_box_of_a_dented_rectangle_is_the_rotated_rectangle_of_shapely(length, dents, angle: float) -> None:
    places = np.linspace(0.0, length, len(dents) + 2)[1:-1]
    polygon = np.array([(0, 0), (length, 0), (length, 1), *zip(places[::-1], dents, strict=True), (0, 1)])
    box = shapely.minimum_rotated_rectangle(shapely.Polygon(_moved(polygon, angle, 1.0, (0.0, 0.0))))
    sides = np.linalg.norm(np.diff(shapely.get_coordinates(box)[:3], axis=0), axis=1)
    assert _values(polygon, angle)["box_ratio"] == pytest.approx(sides.min() / sides.max(), rel=1e-9)


# -- invariance ---------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(
    radii=st.lists(st.integers(2, 9), min_size=4, max_size=16),
    angle=st.floats(0.0, 6.3),
    exponent=st.floats(-6.0, 6.0),
    shift=st.tuples(st.floats(-100.0, 100.0), st.floats(-100.0, 100.0)),
)
def test_similarities_change_nothing(radii, angle: float, exponent: float, shift) -> None:
    polygon, factor = _star(np.array(radii, float)), 10.0**exponent
    moved = _values(polygon, angle, factor, (factor * shift[0], factor * shift[1]))
    for name, value in _values(polygon).items():
        assert moved[name] == pytest.approx(value, rel=1e-9, abs=1e-9), name


@pytest.mark.parametrize("name", EVERY)
def test_declared_bounds_hold_and_the_coarse_mesh_gives_the_same(name: str) -> None:
    metric = EVERY[name]
    mesh = samples.voronoi(400, seed=7)
    labels = _ragged(mesh, 40, seed=7, swaps=0.03)
    values = metric.measure(mesh, labels)
    assert values.shape == (labels.max() + 1,)
    assert values.dtype == np.float64
    assert (values >= metric.bounds[0]).all()
    assert (values <= metric.bounds[1]).all()
    coarse = mesh.coarsen(labels)
    np.testing.assert_array_equal(metric.measure(coarse, np.arange(coarse.n_cells)), values)


# -- declarations and refusals ------------------------------------------------------------------


@pytest.mark.parametrize("name", EVERY)
def test_declared_under_their_names(name: str) -> None:
    assert type(default().build("metric", name)) is type(EVERY[name])


@pytest.mark.parametrize("name", EVERY)
def test_labels_with_gaps_are_refused(name: str) -> None:
    with pytest.raises(MeshError, match="gaps"):
        EVERY[name].measure(samples.squares(2), np.array([0, 0, 2, 2]))
