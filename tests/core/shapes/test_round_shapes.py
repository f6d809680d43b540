"""Inertia ratio and isoperimetric quotient: closed forms, sums over cells in slow loops, descent in 3-D."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings, strategies as st
from scipy.spatial import cKDTree

from agglo_core import samples
from agglo_core.mesh import Mesh
from agglo_core.registry import default
from agglo_core.shapes.round_shapes import InertiaRatio, IsoperimetricQuotient

J, QUOTIENT = InertiaRatio(), IsoperimetricQuotient()


def whole(metric, mesh: Mesh) -> float:
    """The value of the mesh as one agglomerate."""
    return metric.measure(mesh, np.zeros(mesh.n_cells, int))[0]


def polygon(points) -> Mesh:
    return Mesh.from_polygons(np.asarray(points, float), [range(len(points))])


def ellipse(n: int, a: float, b: float) -> Mesh:
    t = 2 * np.pi * np.arange(n) / n
    return polygon(np.stack([a * np.cos(t), b * np.sin(t)], axis=1))


def box(a: float, b: float, c: float) -> Mesh:
    unit = samples.boxes(3)
    return Mesh(unit.points * (a, b, c), unit.face_offsets, unit.face_vertices, unit.face_cells)


def ragged(mesh: Mesh, k: int, seed: int) -> np.ndarray:
    """Labels of about ``k`` agglomerates with holes and loose cells."""
    rng = np.random.default_rng(seed)
    labels = cKDTree(rng.random((k, mesh.dim))).query(mesh.cell_centroids)[1]
    labels = np.where(rng.random(mesh.n_cells) < 0.1, rng.integers(0, k, mesh.n_cells), labels)
    return np.unique(labels, return_inverse=True)[1]


def slow_inertias(simplices: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Measures and moments of inertia of sets of triangles or tetrahedra ``(n, d + 1, d)``, one by one.

    That of a simplex of measure V with d + 1 corners at v about any point is
    V (Σ |v|² + |Σ v|²) / ((d + 1)(d + 2)).
    """
    d = simplices.shape[2]
    found = []
    for part in range(labels.max() + 1):
        own = simplices[labels == part]
        sizes = [abs(np.linalg.det(each[1:] - each[0])) / math.factorial(d) for each in own]
        centre = sum(size * each.mean(axis=0) for size, each in zip(sizes, own, strict=True)) / sum(sizes)
        inertia = 0.0
        for size, each in zip(sizes, own, strict=True):
            arms = each - centre
            inertia += size * ((arms**2).sum() + (arms.sum(axis=0) ** 2).sum()) / ((d + 1) * (d + 2))
        found.append((sum(sizes), inertia))
    return tuple(np.array(found).T)


def triangles_of(mesh: Mesh) -> np.ndarray:
    loops = mesh.boundary_loops
    assert (np.diff(loops.loop_offsets) == 3).all()
    return mesh.points[loops.vertices].reshape(-1, 3, 2)


def tetrahedra_of(mesh: Mesh) -> np.ndarray:
    offsets, vertices = mesh.cell_vertices
    assert (np.diff(offsets) == 4).all()
    return mesh.points[vertices].reshape(-1, 4, 3)


@pytest.mark.parametrize(
    ("points", "value"),
    [
        ([(0, 0), (1, 0), (1, 1), (0, 1)], 3 / math.pi),
        ([(0, 0), (3, 0), (3, 1), (0, 1)], 9 / (5 * math.pi)),
        ([(0, 0), (2, 0), (1, 3**0.5)], 3 * 3**0.5 / (2 * math.pi)),
        ([(0, 0), (3, 0), (0, 4)], 36 / (2 * math.pi * 6 * (9 + 16 + 25) / 36)),
        ([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], 27 / (11 * math.pi)),
    ],
    ids=["square", "bar", "equilateral", "right", "L"],
)
@pytest.mark.parametrize("shift", [0.0, 1e5])
def test_closed_forms(points, value: float, shift: float) -> None:
    turn = np.array([[math.cos(0.7), math.sin(0.7)], [-math.sin(0.7), math.cos(0.7)]])
    for moved in (np.asarray(points) + shift, np.asarray(points) @ turn, np.asarray(points) * 1e-6):
        assert whole(J, polygon(moved)) == pytest.approx(value, rel=1e-9)


def test_a_disc_has_one_and_an_ellipse_twice_the_product_over_the_sum_of_squares() -> None:
    assert 1 - 1e-4 < whole(J, ellipse(400, 1, 1)) < 1
    assert whole(J, ellipse(400, 3, 1)) == pytest.approx(2 * 3 / (9 + 1), rel=1e-3)
    assert whole(QUOTIENT, ellipse(400, 1, 1)) == pytest.approx(1, rel=1e-3)


def test_a_ring_has_that_of_its_area_and_its_two_radii() -> None:
    assert whole(J, samples.ring(400)) == pytest.approx((1 - 0.5**2) ** 2 / (1 - 0.5**4), rel=1e-3)


@pytest.mark.parametrize("sides", [(1, 1, 1), (1, 2, 5)])
def test_boxes(sides: tuple[float, float, float]) -> None:
    volume = math.prod(sides)
    inertia = volume * sum(side**2 for side in sides) / 12
    ball = 0.6 * volume * (3 * volume / (4 * math.pi)) ** (2 / 3)
    a, b, c = sides
    assert whole(J, box(*sides)) == pytest.approx(ball / inertia, rel=1e-12)
    surface = 2 * (a * b + b * c + c * a)
    assert whole(QUOTIENT, box(*sides)) == pytest.approx(36 * math.pi * volume**2 / surface**3, rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_ragged_parts_of_triangles_agree_with_sums_over_the_triangles(seed: int) -> None:
    mesh = samples.random_triangles(300, seed=seed)
    labels = ragged(mesh, 30, seed)
    areas, inertias = slow_inertias(triangles_of(mesh), labels)
    np.testing.assert_allclose(mesh.coarsen(labels).cell_inertias, inertias, rtol=1e-9)
    np.testing.assert_allclose(J.measure(mesh, labels), areas**2 / (2 * math.pi * inertias), rtol=1e-9)


@pytest.mark.parametrize("seed", range(2))
def test_ragged_parts_of_tetrahedra_agree_with_sums_over_the_tetrahedra(seed: int) -> None:
    mesh = samples.tetrahedra(4)
    labels = ragged(mesh, 12, seed)
    volumes, inertias = slow_inertias(tetrahedra_of(mesh), labels)
    np.testing.assert_allclose(mesh.coarsen(labels).cell_inertias, inertias, rtol=1e-9)
    balls = 0.6 * volumes * (3 * volumes / (4 * math.pi)) ** (2 / 3)
    np.testing.assert_allclose(J.measure(mesh, labels), balls / inertias, rtol=1e-9)


def test_cells_agree_with_triangulations_of_shapely() -> None:
    mesh = samples.voronoi(60, seed=4)
    loops = mesh.boundary_loops
    cells = np.split(mesh.points[loops.vertices], loops.loop_offsets[1:-1])
    pieces = [shapely.delaunay_triangles(shapely.Polygon(cell)).geoms for cell in cells]  # cells are convex
    triangles = np.array([shapely.get_coordinates(each)[:3] for cell in pieces for each in cell])
    labels = np.repeat(np.arange(len(cells)), [len(cell) for cell in pieces])
    np.testing.assert_allclose(mesh.cell_inertias, slow_inertias(triangles, labels)[1], rtol=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(0.2, 2.0), min_size=3, max_size=20), st.floats(1.0, 20.0))
def test_no_polygon_is_rounder_than_a_disc_and_stretching_a_disc_makes_it_worse(
    radii: list[float], stretch: float
) -> None:
    t = 2 * np.pi * np.arange(len(radii)) / len(radii)
    star = np.array(radii)[:, None] * np.stack([np.cos(t), np.sin(t)], axis=1)
    for points in (star, star * (stretch, 1.0)):
        assert 0.0 < whole(J, polygon(points)) < 1.0
    assert whole(J, ellipse(24, stretch, 1.0)) <= whole(J, ellipse(24, 1.0, 1.0)) * (1 + 1e-12)


def test_moves_of_the_quotient_in_space_are_what_measuring_twice_says() -> None:
    mesh = samples.tetrahedra(3)
    graph = mesh.graph
    labels = np.unique(np.floor(mesh.cell_centroids * 2).astype(int) @ [4, 2, 1], return_inverse=True)[1]
    before = QUOTIENT.measure(mesh, labels).sum()
    sources = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    other = labels[sources] != labels[graph.indices]
    cells, parts = sources[other][::7], labels[graph.indices][other][::7]
    for cell, part, change in zip(cells, parts, QUOTIENT.changes(graph, labels, cells, parts), strict=True):
        moved = labels.copy()
        moved[cell] = part
        assert QUOTIENT.measure(mesh, moved).sum() - before == pytest.approx(change, abs=1e-12)


@pytest.mark.parametrize(("name", "metric"), [("J", J), ("isoperimetric", QUOTIENT)])
def test_metrics_are_declared_under_their_names(name: str, metric: object) -> None:
    assert type(default().build("metric", name)) is type(metric)
