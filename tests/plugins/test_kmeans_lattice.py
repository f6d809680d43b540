"""Hexagonal lattices as starts of k-way partitions, and the option effort that starts from them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from agglo_core import Graph, Target, agglomerate, samples
from agglo_core.arrays import frozen_int
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.refine.compactness.refiner import CompactnessRefiner
from agglo_kmeans import kmeans, lattice
from agglo_kmeans.kmeans import KMeans
from agglo_kmeans.lattice import lattice_parts

inertia, value = OBJECTIVES["compactness"].value, OBJECTIVES["solver"].value
QUICK = ("kmeans", {"effort": "quick"})


@pytest.mark.parametrize("parts", [2, 5, 17, 30, 100])
def test_each_of_k_points_has_cells(parts: int) -> None:
    for mesh in (samples.squares(30), samples.voronoi(900, seed=parts), samples.brain()):
        labels = lattice_parts(mesh.graph, parts)
        assert labels is not None
        assert np.unique(labels).tolist() == list(range(parts))


@pytest.mark.parametrize("shift", [0.0, 0.25, 0.5])
def test_cells_belong_to_the_nearest_lattice_point(shift: float) -> None:
    graph = samples.voronoi(800, seed=3).graph
    places, k = graph.centroids, 40
    labels, distances = lattice._nearest(places, graph.measures, k, shift)
    # The lattice points follow from three distances to each.
    points = np.empty((k, 2))
    for p in range(k):
        x, d = places[labels == p], distances[labels == p]
        A = np.column_stack((2.0 * x, np.ones(len(x))))
        points[p] = np.linalg.lstsq(A, (x**2).sum(axis=1) - d**2, rcond=None)[0][:2]
    apart = np.linalg.norm(places[:, None] - points[None], axis=2)
    np.testing.assert_allclose(distances, apart.min(axis=1), atol=1e-9)
    np.testing.assert_allclose(distances, apart[np.arange(graph.n), labels], atol=1e-9)


def test_many_parts_have_nearly_the_inertia_of_hexagons() -> None:
    graph, k = samples.squares(100).graph, 100
    labels = lattice_parts(graph, k)
    assert labels is not None
    hexagons = k * 5 / (18 * 3**0.5) * (1 / k) ** 2
    assert inertia(graph, labels) < 1.04 * hexagons
    assert inertia(graph, KMeans()._lloyd(graph, k)) > 1.05 * hexagons


def test_lattices_move_with_the_mesh() -> None:
    mesh = samples.voronoi(500, seed=5)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    moved = replace(mesh, points=2.0 * mesh.points @ turn.T + 7.0)
    np.testing.assert_array_equal(lattice_parts(moved.graph, 31), lattice_parts(mesh.graph, 31))


def test_graphs_without_a_lattice() -> None:
    path = Graph.from_arrays([0, 1, 2], [1, 0], np.zeros((2, 2)), measures=np.zeros(2))
    assert lattice_parts(path, 2) is None
    assert lattice_parts(samples.tetrahedra(2).graph, 4) is None
    # Measures that are no areas would make a huge lattice.
    graph = samples.voronoi(50, seed=1).graph
    wide = Graph.from_arrays(graph.indptr, graph.indices, 1e9 * graph.centroids, measures=np.ones(50))
    assert lattice_parts(wide, 4) is None
    assert len(np.unique(KMeans(effort="quick").partition(wide, Target(parts=4), 1))) == 4
    # A large cell leaves fewer than eight lattice points with cells.
    x = np.array([0.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0])
    row = Graph.from_arrays(
        np.zeros(9, int), [], np.stack((x, 0 * x), axis=1), measures=np.array([100.0] + 7 * [0.01])
    )
    assert lattice_parts(row, 8) is None


def test_quick_parts_are_no_worse_than_the_polished_lattice_and_bisections() -> None:
    target = Target(parts=40)
    for graph in (samples.voronoi(640, seed=8).graph, samples.random_triangles(320, seed=8).graph):
        tool = KMeans(effort="quick")
        starts = [tool._around_lattice(graph, 40), tool._bisected(graph, target)]
        polished = [
            CompactnessRefiner().refine_parts(graph, each, frozen_int(np.zeros(40)), target)
            for each in starts
            if int(graph.components(each).max()) == 39
        ]
        found = tool.partition(graph, target, 1)
        assert value(graph, found) <= min(value(graph, each) for each in polished)


@pytest.mark.parametrize(
    "make", [samples.voronoi, lambda n, seed: samples.random_triangles(n // 2, seed=seed)]
)
def test_quick_parts_are_better_than_k_way_and_fewer_for_a_size(make) -> None:
    for seed in (41, 42):
        mesh = make(1500, seed=seed)
        graph, size = mesh.graph, 0.15
        quick, plain = (
            agglomerate(mesh, n_parts=94, method="kway", bisector=each).levels[0]
            for each in (QUICK, "kmeans")
        )
        assert value(graph, quick) < value(graph, plain) - 0.02
        quick = agglomerate(mesh, h_star=size, method="kway", bisector=QUICK).levels[0]
        merged = agglomerate(mesh, h_star=size, method="kway", merge=True).levels[0]
        assert quick.max() + 1 <= 0.95 * (merged.max() + 1)
        assert graph.part_diameters(quick).max() <= size * (1 + 1e-9)


@pytest.mark.parametrize("make", [samples.voronoi, samples.random_triangles])
def test_k_way_needs_fewer_parts_for_a_size_than_bisections(make) -> None:
    mesh = make(2000, seed=43)
    for size in (0.16, 0.3):  # at sizes slightly above √2 / 2ⁿ bisections of a square are as good
        counts = {}
        for method in ("kway", "recursive"):
            labels = agglomerate(mesh, h_star=size, method=method, merge=True).levels[0]
            assert mesh.graph.part_diameters(labels).max() <= size * (1 + 1e-9)
            counts[method] = labels.max() + 1
        assert counts["kway"] <= 0.92 * counts["recursive"]


@pytest.fixture
def lattices(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Graph, int]]:
    """Record the graphs and counts for which a lattice is made."""
    made: list[tuple[Graph, int]] = []

    def noted(graph: Graph, k: int):
        made.append((graph, k))
        return lattice_parts(graph, k)

    monkeypatch.setattr(kmeans, "lattice_parts", noted)
    return made


def test_each_region_has_its_own_lattice(lattices: list[tuple[Graph, int]]) -> None:
    mesh = samples.squares(20)
    right = (mesh.graph.centroids[:, 0] > 0.25).astype(int)  # relative to the centre of the square
    labels = agglomerate(mesh, n_parts=16, regions=right, method="kway", bisector=QUICK).levels[0]
    assert sorted((graph.n, k) for graph, k in lattices) == [(100, 4), (300, 12)]
    assert len(np.unique(labels + 100 * right)) == 16


def test_the_lattice_is_hexagonal_in_the_metric(lattices: list[tuple[Graph, int]]) -> None:
    mesh = samples.squares(24)
    metric = np.diag([1.0, 16.0])  # four times as high as wide
    agglomerate(mesh, n_parts=24, metric=metric, method="kway", bisector=QUICK)
    ((graph, k),) = lattices
    assert k == 24
    np.testing.assert_allclose(np.ptp(graph.centroids, axis=0), [23 / 24, 4 * 23 / 24])
