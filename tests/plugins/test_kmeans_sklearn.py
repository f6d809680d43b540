"""The paper's k-means: scikit-learn itself as the oracle, degenerate data, no side effects."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from sklearn.cluster import KMeans

import agglo_core as agglo
from agglo_core.graph import Graph
from agglo_kmeans.sklearn_kmeans import SklearnKMeans


def cloud(centroids, weights=None):
    return Graph.from_arrays(np.zeros(len(centroids) + 1, int), [], centroids, weights=weights)


def sides_of(graph, seed=0, **options):
    return SklearnKMeans(**options).bisect(graph, np.random.default_rng(seed))


def energy(graph, sides):
    total = 0.0
    for side in (0, 1):
        points, weights = graph.centroids[sides == side], graph.weights[sides == side]
        total += (weights[:, None] * (points - np.average(points, axis=0, weights=weights)) ** 2).sum()
    return total


@pytest.mark.parametrize("seed", range(3))
def test_the_library_s_own_result(seed):
    graph = agglo.samples.random_triangles(60, seed).graph
    state = int(np.random.default_rng(seed).integers(2**31))
    model = KMeans(2, n_init=10, random_state=state).fit(graph.centroids, sample_weight=graph.weights)
    sides = sides_of(graph, seed)
    assert np.isclose(energy(graph, sides), energy(graph, model.labels_), rtol=1e-3)
    assert len(set(sides.tolist())) == 2


def test_two_clusters_are_separated_at_any_scale_and_place():
    rng = np.random.default_rng(1)
    points = np.r_[rng.random((20, 2)), rng.random((30, 2)) + np.array([3, 1])]
    for scale in (1e-9, 1.0, 1e9):
        sides = sides_of(cloud(points * scale))
        assert sides[:20].tolist() == [sides[0]] * 20
        assert sides[20:].tolist() == [1 - sides[0]] * 30


def test_weights_pull_the_separator():
    points = np.c_[[0.0, 1.0, 2.1], np.zeros(3)]
    even, heavy = sides_of(cloud(points)), sides_of(cloud(points, [1, 50, 50]))
    assert even[0] == even[1] != even[2]
    assert heavy[0] == heavy[1] != heavy[2]
    pulled = sides_of(cloud(points, [50, 50, 1]))
    assert pulled[0] != pulled[1] == pulled[2]


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("weights", [[1, 1, 1, 1], [0, 0, 0, 0], [0, 0, 0, 1], [1, 0, 0, 0]])
@pytest.mark.parametrize("distinct", [1, 2, 4])
def test_degenerate_data_split_without_a_warning(dim, weights, distinct):
    points = np.zeros((4, dim))
    points[:distinct, 0] = np.arange(distinct)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sides = sides_of(cloud(points, weights))
    assert set(sides.tolist()) == {0, 1}
    assert sides.dtype == np.int64


@pytest.mark.parametrize("n", [1, 2, 3])
def test_few_nodes(n):
    sides = sides_of(cloud(np.c_[np.arange(n), np.zeros(n)]))
    assert set(sides.tolist()) == ({0} if n == 1 else {0, 1})


def test_the_seed_decides_and_global_state_is_left_alone():
    graph = agglo.samples.voronoi(80, seed=5).graph
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    assert np.array_equal(sides_of(graph, 3), sides_of(graph, 3))
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002


def test_the_paper_s_squares_through_the_pipeline():
    mesh = agglo.samples.paper("squares")
    labels = agglo.agglomerate(mesh, bisector="kmeans_sklearn", h_star=np.sqrt(2) / 4).levels[0]
    assert len(np.unique(mesh.graph.components(labels))) == len(np.unique(labels))
    assert np.allclose(agglo.quality(mesh, labels, metrics=("CR",))["CR"], np.sqrt(0.5), atol=1e-4)


@pytest.mark.parametrize("n_init", [0, -1, 1.5, True])
def test_options_outside_their_range_are_refused(n_init):
    with pytest.raises(agglo.errors.OptionError, match="n_init"):
        SklearnKMeans(n_init)
