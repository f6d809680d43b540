"""Metrics: hand values, shapely as oracle for circles, invariance, slow reference implementations."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings, strategies as st
from scipy.optimize import linprog
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist
from shapely.affinity import rotate, scale

from agglo_core import samples
from agglo_core.arrays import frozen_float, frozen_int
from agglo_core.errors import MeshError, OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.measure import measure_levels
from agglo_core.mesh import Mesh
from agglo_core.registry import default
from agglo_core.shapes.circle import circles
from agglo_core.shapes.metrics import (
    Cells,
    CentredCircleRatio,
    CircleRatio,
    Components,
    Cut,
    DiameterRatio,
    InterfaceLength,
    NormalisedCut,
    UniformityFactor,
    UniformityFactor99,
)

EVERY = {
    "UF": UniformityFactor(),
    "UF99": UniformityFactor99(),
    "CR": CircleRatio(),
    "CRc": CentredCircleRatio(),
    "diameter_ratio": DiameterRatio(h_star=0.3),
    "interface_length": InterfaceLength(),
    "cut": Cut(),
    "ncut": NormalisedCut(),
    "components": Components(),
    "cells": Cells(),
}


def _ragged(mesh: Mesh, k: int, seed: int, swaps: float = 0.06) -> np.ndarray:
    """Labels of about ``k`` agglomerates with holes, islands and pinch vertices."""
    rng = np.random.default_rng(seed)
    labels = cKDTree(rng.random((k, 2))).query(mesh.cell_centroids)[1]
    astray = rng.random(mesh.n_cells) < swaps
    labels = np.where(astray, rng.integers(0, k, mesh.n_cells), labels)
    return np.unique(labels, return_inverse=True)[1]


def _cells_of(mesh: Mesh) -> np.ndarray:
    loops = mesh.boundary_loops
    corners = np.insert(loops.vertices, loops.loop_offsets[1:], loops.vertices[loops.loop_offsets[:-1]])
    owner = np.repeat(np.arange(mesh.n_cells), np.diff(loops.loop_offsets) + 1)
    return shapely.polygons(shapely.linearrings(mesh.points[corners], indices=owner))


def _whole(mesh: Mesh) -> Mesh:
    return mesh.coarsen(np.zeros(mesh.n_cells, int))


def _measure(metric, mesh: Mesh) -> np.ndarray:
    return metric.measure(mesh, np.arange(mesh.n_cells))


# -- circles ------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.1])
@pytest.mark.parametrize(
    ("mesh", "value"), [(samples.squares(3), 0.5**0.5), (samples.hexagons(3), 0.75**0.5)]
)
def test_circles_of_regular_cells_are_exact(mesh: Mesh, value: float, angle: float) -> None:
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    loops = mesh.boundary_loops
    turned = Mesh.from_polygons(mesh.points @ turn + 1e4, (loops.loop_offsets, loops.vertices))
    for metric in (CircleRatio(), CentredCircleRatio()):
        np.testing.assert_allclose(_measure(metric, turned), value, rtol=1e-9)


@pytest.mark.parametrize("n", [12, 13, 60])
def test_ring_is_exact(n: int) -> None:
    ring = _whole(samples.ring(n))
    c = np.cos(np.pi / n)  # largest circle: from an inner corner to the two outer edges around it
    radius = _measure(CircleRatio(), ring)[0] * ring.h / 2
    assert radius == pytest.approx(0.5 * c / (1 + c), rel=1e-9)
    assert _measure(CentredCircleRatio(), ring)[0] == 0.0


@pytest.mark.parametrize("n", [2, 7, 100, 400])
def test_strips_are_exact(n: int) -> None:
    strip = _whole(samples.strip(n))
    assert _measure(CircleRatio(), strip)[0] == pytest.approx(1 / np.hypot(1, n), rel=1e-9)


def test_triangle_has_its_incircle_and_its_centroid_circle() -> None:
    mesh = samples.triangles(2)
    diameter, leg = mesh.h, 0.5
    np.testing.assert_allclose(_measure(CircleRatio(), mesh) * diameter, 2 * leg - diameter, rtol=1e-9)
    np.testing.assert_allclose(
        _measure(CentredCircleRatio(), mesh) * diameter / 2, leg / (3 * 2**0.5), rtol=1e-9
    )


def test_l_shape_is_exact() -> None:
    shape = Mesh.from_polygons([(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)], [range(6)])
    radius = 2 - 2**0.5  # touches both outer sides and the inner corner
    assert _measure(CircleRatio(), shape)[0] == pytest.approx(2 * radius / 18**0.5, rel=1e-9)


def test_the_circle_of_a_cell_does_not_depend_on_its_neighbours() -> None:
    """The faces of a cell point as its neighbours of lower number go: here two meet at the inner corner."""
    dart = np.array([(0.866, -0.066), (-0.352, 0.908), (-0.422, -0.362), (-0.693, -0.884)])
    middle = dart.mean(axis=0)
    tips = [(dart[[i, i - 3]].mean(axis=0) - middle) * 1.3 + middle for i in (1, 3)]
    alone = _measure(CircleRatio(), Mesh.from_polygons(dart, [range(4)]))[0]
    joined = Mesh.from_polygons(np.vstack((dart, tips)), [[2, 1, 4], [0, 3, 5], [0, 1, 2, 3]])
    assert _measure(CircleRatio(), joined)[2] == pytest.approx(alone, rel=1e-9)
    exact = shapely.maximum_inscribed_circle(shapely.Polygon(dart), tolerance=1e-6).length
    assert alone * pdist(dart).max() / 2 == pytest.approx(exact, rel=1e-4)


@pytest.mark.parametrize(("angle", "aspect"), [(0.0, 1000), (0.7, 1000), (0.7, 30), (0.3, 1)])
def test_convex_cells_have_their_incircles(angle: float, aspect: float) -> None:
    wide = samples.voronoi(40, seed=5)
    points = (
        wide.points
        * [aspect, 1]
        @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    )
    loops = wide.boundary_loops
    thin = Mesh.from_polygons(points, (loops.loop_offsets, loops.vertices))
    ratio = _measure(CircleRatio(), thin)
    for cell in range(thin.n_cells):  # convex: the largest circle is a linear program
        corners = points[loops.vertices[loops.loop_offsets[cell] : loops.loop_offsets[cell + 1]]]
        edge = np.roll(corners, -1, axis=0) - corners
        normal = np.stack((edge[:, 1], -edge[:, 0]), axis=1) / np.linalg.norm(edge, axis=1)[:, None]
        rows = np.column_stack((normal, np.ones(len(edge))))
        best = linprog([0, 0, -1], rows, (normal * corners).sum(axis=1), bounds=[(None, None)] * 3).x[2]
        assert ratio[cell] == pytest.approx(2 * best / thin.cell_diameters[cell], rel=1e-8)


def _outline(radii: np.ndarray, angles: np.ndarray) -> np.ndarray:
    return np.stack((radii * np.cos(angles), radii * np.sin(angles)), axis=1)


def test_many_edges() -> None:
    half, turn = np.pi * np.linspace(0, 1, 1000), 2 * np.pi * np.arange(4000) / 4000
    crescent = np.concatenate((_outline(np.ones(1000), half), _outline(np.full(1000, 0.95), half[::-1])))
    ellipse = _outline(np.ones(4000), turn) * [1, 0.01]
    for outline, radius in ((crescent, 0.025), (ellipse, 0.01)):
        cell = Mesh.from_polygons(outline, [range(len(outline))])
        assert _measure(CircleRatio(), cell)[0] * cell.h / 2 == pytest.approx(radius, rel=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_ragged_outlines_agree_with_shapely(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.random(150)) * 2 * np.pi
    winding = np.linspace(0, 12, 150)
    inner = _outline(1 + winding, winding)
    outer = _outline(1 + winding + rng.uniform(0.1, 0.4, 150), winding)
    star = _outline(rng.uniform(0.2, 1, 150), angle)
    for outline in (star, star * [1, 0.03], np.concatenate((outer, inner[::-1]))):
        cell = Mesh.from_polygons(outline + 100, [range(len(outline))])
        exact = shapely.maximum_inscribed_circle(shapely.Polygon(outline), tolerance=3e-5 * cell.h).length
        assert _measure(CircleRatio(), cell)[0] / 2 == pytest.approx(exact / cell.h, abs=1.3e-4)


@st.composite
def _shapes(draw: st.DrawFn) -> shapely.MultiPolygon:
    """Stars minus stars: concave, with holes, in pieces, with collinear vertices, stretched and turned."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    stars = []
    for n, size in zip(draw(st.tuples(st.integers(3, 25), st.integers(3, 9))), (1.0, 0.7), strict=True):
        star = _outline(rng.uniform(draw(st.sampled_from((0.05, 0.6))), 1.0, n), np.arange(n) * 2 * np.pi / n)
        inserted = [star, star + rng.random((n, 1)) * (np.roll(star, -1, axis=0) - star)]
        stars.append(shapely.Polygon(size * np.stack(inserted, axis=1).reshape(-1, 2) + 0.3 * rng.random(2)))
    shape = stars[0].difference(stars[1]) if draw(st.booleans()) else stars[0]
    stretched = scale(shape, 1.0, draw(st.sampled_from((1.0, 0.1, 1e-3))))
    parts = [part for part in shapely.get_parts(rotate(stretched, rng.uniform(0, 90))) if part.area > 1e-9]
    return shapely.MultiPolygon(parts or [shapely.box(0, 0, 1, 1)])


@given(shape=_shapes())
@settings(max_examples=40)
def test_circles_of_any_outline_agree_with_a_slow_search(shape: shapely.MultiPolygon) -> None:
    rings = shapely.get_rings([shapely.orient_polygons(part) for part in shape.geoms])
    points, starts = shapely.get_coordinates(rings), np.cumsum([0, *shapely.get_num_coordinates(rings)])
    keep = np.ones(len(points), bool)
    keep[starts[1:] - 1] = False  # the repeated first vertex
    loops = starts - np.arange(len(starts))
    centre, diameter = np.array(shape.centroid.coords), pdist(points).max()
    radius, centred = circles(
        frozen_float(points[keep]),
        frozen_int([0, len(rings)]),
        frozen_int(loops),
        frozen_int(np.arange(loops[-1])),
        frozen_float(centre),
        frozen_float([diameter]),
    )[0]
    about = shape.boundary.distance(shape.centroid) if shape.contains(shape.centroid) else 0.0
    assert centred == pytest.approx(about, rel=1e-9, abs=1e-12)
    slow = max(shapely.maximum_inscribed_circle(part, tolerance=1e-6 * radius).length for part in shape.geoms)
    assert slow <= radius * (1 + 1.2e-5) + 1.1e-9 * diameter
    assert radius <= slow * (1 + 1e-3)  # in thin shapes the slow search ends early


def test_needle_stays_cheap_and_close() -> None:
    needle = Mesh.from_polygons([(0, 0), (1, 0), (0.3, 1e-5)], [range(3)])
    radius = _measure(CircleRatio(), needle)[0] / 2
    assert radius == pytest.approx(1e-5 / needle.face_measures.sum(), rel=1e-3)


@pytest.mark.parametrize(
    ("mesh", "k", "swaps"),
    [
        (samples.voronoi(3000, seed=1), 200, 0.06),
        (samples.random_triangles(1500, seed=2), 200, 0.0),
        (samples.triangles(30), 120, 0.1),
    ],
    ids=["holes", "triangles", "pinches"],
)
def test_circles_agree_with_shapely(mesh: Mesh, k: int, swaps: float) -> None:
    labels = _ragged(mesh, k, seed=3, swaps=swaps)
    ratio, centred = CircleRatio().measure(mesh, labels), CentredCircleRatio().measure(mesh, labels)
    cells, diameters = _cells_of(mesh), mesh.coarsen(labels).cell_diameters
    for part in range(labels.max() + 1):
        shape = shapely.union_all(cells[labels == part])
        size = 1 / diameters[part]
        unit = scale(shape, size, size, origin=shape.centroid)
        exact = shapely.maximum_inscribed_circle(unit, tolerance=1e-5).length
        assert ratio[part] / 2 == pytest.approx(exact, rel=1e-3)
        inside = shape.contains(shape.centroid)
        about = shape.boundary.distance(shape.centroid) if inside else 0.0
        assert centred[part] * diameters[part] / 2 == pytest.approx(about, rel=1e-6, abs=1e-9)


def _upright_lines(shape: shapely.Geometry) -> list[shapely.LineString]:
    """What vertical lines just beside each vertex, and a little further from it, share with a shape."""
    corners, (left, low, right, high) = shapely.get_coordinates(shape), shape.bounds
    lines: list[shapely.LineString] = []
    beside = np.array([1e-9 * (right - left), 0.25 * (high - low), 0.5 * (high - low)])
    for x in np.add.outer(corners[:, 0], np.concatenate((-beside, beside))).ravel():
        found = shape.intersection(shapely.LineString([(x, low - 1), (x, high + 1)]))
        lines += [part for part in shapely.get_parts(found) if part.length > 0]
    return lines


@pytest.mark.parametrize("aspect", [50, 1000])
def test_thin_agglomerates_have_circles_about_their_longest_lines(aspect: float) -> None:
    plain = samples.voronoi(600, seed=8)
    labels, loops = _ragged(plain, 40, seed=8), plain.boundary_loops
    mesh = Mesh.from_polygons(plain.points * [aspect, 1], (loops.loop_offsets, loops.vertices))
    cells, diameters = _cells_of(mesh), mesh.coarsen(labels).cell_diameters
    radii = CircleRatio().measure(mesh, labels) * diameters / 2
    for part in range(labels.max() + 1):
        shape = shapely.union_all(cells[labels == part])
        lines = _upright_lines(shape)
        reached = shapely.distance(shape.boundary, shapely.centroid(lines)).max()
        assert reached - max(1e-5 * reached, 1e-7 * diameters[part]) <= radii[part]
        assert radii[part] <= shapely.length(lines).max() / 2 * (1 + 1e-6)
        assert radii[part] == pytest.approx(reached, rel=0.03)


# -- the rest -----------------------------------------------------------------------------------


def test_diameters_agree_with_all_pairs() -> None:
    mesh = samples.voronoi(300, seed=4)
    labels = _ragged(mesh, 20, seed=4)
    corners = [
        np.unique(mesh.face_vertices.reshape(-1, 2)[(mesh.face_cells == c).any(axis=1)]) for c in range(300)
    ]
    diameters = np.array(
        [
            pdist(
                mesh.points[np.unique(np.concatenate([corners[c] for c in np.flatnonzero(labels == part)]))]
            ).max()
            for part in range(labels.max() + 1)
        ]
    )
    np.testing.assert_allclose(UniformityFactor().measure(mesh, labels), diameters / diameters.max())
    np.testing.assert_allclose(
        UniformityFactor99().measure(mesh, labels), diameters / np.percentile(diameters, 99)
    )
    np.testing.assert_allclose(DiameterRatio(h_star=0.2).measure(mesh, labels), diameters / 0.2)


def test_counting_metrics_agree_with_slow_references() -> None:
    mesh = samples.voronoi(300, seed=5)
    labels = _ragged(mesh, 20, seed=5)
    k = labels.max() + 1
    length, edges, volume = np.zeros(k), np.zeros(k), np.zeros(k)
    for (a, b), measure in zip(mesh.face_cells, mesh.face_measures, strict=True):
        if b >= 0:
            for cell in (a, b):
                volume[labels[cell]] += 1
                if labels[a] != labels[b]:
                    length[labels[cell]] += measure
                    edges[labels[cell]] += 1
    np.testing.assert_allclose(InterfaceLength().measure(mesh, labels), length)
    np.testing.assert_array_equal(Cut().measure(mesh, labels), edges)
    np.testing.assert_allclose(NormalisedCut().measure(mesh, labels), edges / volume)
    np.testing.assert_array_equal(
        Cells().measure(mesh, labels), [(labels == part).sum() for part in range(k)]
    )


def test_components_are_counted_per_part() -> None:
    mesh = samples.squares(4)
    checkered = np.add.outer(np.arange(4), np.arange(4)).ravel() % 2
    np.testing.assert_array_equal(Components().measure(mesh, checkered), [8, 8])
    np.testing.assert_array_equal(Components().measure(mesh, np.repeat([0, 1, 0, 2], 4)), [2, 1, 1])


@pytest.mark.parametrize("broken", [False, True])
def test_nested_levels_are_measured_as_each_level_alone(broken: bool) -> None:
    mesh = samples.squares(8)
    x, y = (mesh.cell_centroids * 8).astype(int).T
    fine, coarse = 4 * (y // 2) + x // 2, 2 * (y // 4) + x // 4
    if broken:  # parts exchange cells, within a part of the coarse level and across two
        fine[[1, 2, 56, 63]] = fine[[2, 1, 63, 56]]
        coarse = np.array([0, 0, 1, 1, 0, 0, 1, 1, 2, 2, 3, 3, 2, 2, 3, 3])[fine]
    hierarchy = Hierarchy(mesh, mesh.graph, [fine, coarse], [{}, {}], nested=True)
    for labels, level in zip(hierarchy.levels, measure_levels(mesh, hierarchy), strict=True):
        np.testing.assert_array_equal(level.values["components"], Components().measure(mesh, labels))
        np.testing.assert_array_equal(level.values["CR"], CircleRatio().measure(mesh, labels))
        assert level.mesh.fingerprint == mesh.coarsen(labels).fingerprint
    assert broken == (level.values["components"].max() > 1)


def test_one_part_has_no_interface() -> None:
    mesh = samples.squares(3)
    whole = np.zeros(9, int)
    for metric in (InterfaceLength(), Cut(), NormalisedCut()):
        values = metric.measure(mesh, whole)
        assert values.dtype == np.float64
        np.testing.assert_array_equal(values, [0.0])


@pytest.mark.parametrize("name", EVERY)
def test_declared_bounds_and_homogeneity_hold(name: str) -> None:
    metric, factor = EVERY[name], 1000.0
    mesh = samples.voronoi(400, seed=6)
    labels = _ragged(mesh, 25, seed=6)
    loops = mesh.boundary_loops
    larger = Mesh.from_polygons(factor * mesh.points, (loops.loop_offsets, loops.vertices))
    values = metric.measure(mesh, labels)
    assert values.shape == (labels.max() + 1,)
    assert values.dtype == np.float64
    assert metric.better in ("high", "low")
    assert (values >= metric.bounds[0]).all()
    assert (values <= metric.bounds[1] * (1 + 1e-12)).all()
    np.testing.assert_allclose(metric.measure(larger, labels), factor**metric.homogeneity * values, rtol=1e-6)


@pytest.mark.parametrize(
    "name", [name for name, metric in EVERY.items() if getattr(metric, "shape_only", False)]
)
def test_shape_only_metrics_see_the_same_on_the_coarse_mesh(name: str) -> None:
    mesh = samples.voronoi(400, seed=7)
    labels = _ragged(mesh, 25, seed=7)
    coarse = mesh.coarsen(labels)
    np.testing.assert_array_equal(_measure(EVERY[name], coarse), EVERY[name].measure(mesh, labels))


@pytest.mark.parametrize("name", EVERY)
def test_metrics_are_declared_under_their_names(name: str) -> None:
    options = {"h_star": 0.3} if name == "diameter_ratio" else {}
    assert type(default().build("metric", name, **options)) is type(EVERY[name])


@pytest.mark.parametrize("name", EVERY)
def test_solids(name: str) -> None:
    mesh = samples.boxes(2)
    labels = np.repeat([0, 1], 4)
    expected = {
        "UF": 1,
        "UF99": 1,
        "CR": 1 / 3,
        "CRc": 1 / 3,
        "diameter_ratio": 1.5 / 0.3,
        "interface_length": 1,
        "cut": 4,
        "ncut": 4 / 12,
        "components": 1,
        "cells": 4,
    }
    np.testing.assert_allclose(EVERY[name].measure(mesh, labels), expected[name])


@pytest.mark.parametrize("h_star", [0.0, -1.0, np.nan, np.inf, "abc", True, None])
def test_bad_h_star_is_refused(h_star: object) -> None:
    with pytest.raises(OptionError, match="diameter_ratio: h_star must"):
        DiameterRatio(h_star=h_star)


@pytest.mark.parametrize("name", EVERY)
def test_labels_with_gaps_are_refused(name: str) -> None:
    with pytest.raises(MeshError, match="gaps"):
        EVERY[name].measure(samples.squares(2), np.array([0, 0, 2, 2]))


def test_overlapping_squares_end_soon() -> None:
    """Where they overlap is outside by the even-odd rule, so that no circle is known at first."""
    square = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
    points = np.concatenate((square, square + 0.5)) - 0.75
    loops, corners = frozen_int([0, 4, 8]), frozen_int(np.arange(8))
    diameter = 1.5 * np.sqrt(2.0)
    radii = circles(
        frozen_float(points),
        frozen_int([0, 2]),
        loops,
        corners,
        frozen_float([[0.0, 0.0]]),
        frozen_float([diameter]),
    )
    # The circle in the corner of a square touches the corner of the other one.
    np.testing.assert_allclose(radii, [[0.5 * np.sqrt(2.0) / (1.0 + np.sqrt(2.0)), 0.0]], rtol=2e-5)
