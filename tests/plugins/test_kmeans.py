"""Batched 2-means: Lloyd's fixed points of low energy, deterministic, one block at a time; k-way k-means."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import agglo_core as agglo
from agglo_core import Graph, OptionError, Target
from agglo_kmeans.kmeans import KMeans


def cloud(centroids, weights=None, sizes=None):
    """Graph without edges: k-means looks at centroids and weights alone."""
    n = len(centroids)
    graph = Graph.from_arrays(np.zeros(n + 1, int), [], centroids, weights=weights)
    return graph if sizes is None else graph.subgraph(np.arange(n), np.concatenate(([0], np.cumsum(sizes))))


def sides_of(graph):
    return KMeans().bisect_level(graph, np.zeros(graph.n_blocks, np.uint64))


def energy(graph, sides):
    """Weighted sum of squared distances to the means."""
    total = 0.0
    for side in (0, 1):
        points, weights = graph.centroids[sides == side], graph.weights[sides == side]
        total += (weights[:, None] * (points - np.average(points, axis=0, weights=weights)) ** 2).sum()
    return total


def best_energy(graph):
    """Over all divisions by a line, which is where the optimum lies."""
    angles = np.linspace(0, np.pi, 720)
    orders = np.argsort(graph.centroids @ np.stack((np.cos(angles), np.sin(angles))), axis=0).T
    divisions = np.argsort(np.unique(orders, axis=0), axis=1)[None] >= np.arange(1, graph.n)[:, None, None]
    return min(energy(graph, sides) for sides in np.unique(divisions.reshape(-1, graph.n), axis=0))


def grid(*counts):
    axes = [np.arange(k) + 0.5 for k in counts]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(counts))


def same_split(one, other):
    return np.array_equal(one, other) or np.array_equal(one, 1 - other)


@settings(max_examples=100)
@given(st.integers(2, 80), st.sampled_from([2, 3]), st.integers(0, 2**32 - 1))
def test_every_cell_is_on_the_side_of_the_nearer_mean(n, dim, seed):
    rng = np.random.default_rng(seed)
    graph = cloud(rng.random((n, dim)) * rng.uniform(0.2, 1, dim), rng.random(n) + 0.05)
    sides = sides_of(graph)
    assert set(sides.tolist()) == {0, 1}
    means = [
        np.average(graph.centroids[sides == s], axis=0, weights=graph.weights[sides == s]) for s in (0, 1)
    ]
    distance = [((graph.centroids - mean) ** 2).sum(axis=1) for mean in means]
    assert (distance[0] - distance[1])[sides == 0].max() <= 1e-6
    assert (distance[1] - distance[0])[sides == 1].max() <= 1e-6


def test_energy_is_close_to_the_best_possible():
    ratios = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        graph = cloud(rng.random((14, 2)), rng.random(14) + 0.2)
        ratios.append(energy(graph, sides_of(graph)) / best_energy(graph))
    assert min(ratios) >= 1 - 1e-9
    assert np.median(ratios) <= 1.001
    assert max(ratios) <= 1.15


@pytest.mark.parametrize("counts", [(8, 4), (4, 8), (7, 3), (8, 4, 4), (3, 6, 2), (2, 2, 5)])
def test_boxes_are_halved_across_their_longest_side(counts):
    points = grid(*counts)
    sides, longest = sides_of(cloud(points)), int(np.argmax(counts))
    if counts[longest] % 2 == 0:
        assert same_split(sides, (points[:, longest] > counts[longest] / 2).astype(int))
    for other in set(range(len(counts))) - {longest}:
        for place in np.unique(points[:, longest]):  # a slice across may be cut only in the middle
            if abs(place - counts[longest] / 2) > 1:
                assert len(set(sides[points[:, longest] == place])) == 1, other


@pytest.mark.parametrize("counts", [(8, 8), (16, 16), (4, 4), (2, 2), (4, 4, 4)])
@pytest.mark.parametrize("seed", range(6))
def test_turned_squares_and_cubes_are_halved_along_the_grid(counts, seed):
    points = grid(*counts)
    frame = np.linalg.qr(np.random.default_rng(seed).standard_normal((len(counts),) * 2))[0]
    sides = sides_of(cloud(points @ frame.T + 1e6))
    straight = [(points[:, k] > counts[k] / 2).astype(int) for k in range(len(counts))]
    assert any(same_split(sides, half) for half in straight)


def test_a_cell_on_the_separator_is_not_a_matter_of_rounding():
    points = np.stack((np.arange(5.0), np.zeros(5)), axis=1)
    assert sorted(np.bincount(sides_of(cloud(points)))) == [2, 3]
    expected = sides_of(cloud(points))
    for seed in range(20):
        noise = 1e-13 * np.random.default_rng(seed).standard_normal(points.shape)
        assert same_split(sides_of(cloud(points + noise)), expected)


def test_weights_move_the_means():
    points = np.stack(([0.0, 1.2, 2.0, 3.0], np.zeros(4)), axis=1)
    assert same_split(sides_of(cloud(points, [1, 1, 1, 1])), np.array([0, 0, 1, 1]))
    assert same_split(sides_of(cloud(points, [100, 1, 1, 1])), np.array([0, 1, 1, 1]))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("weights", [None, [0, 0, 0], [1, 0, 0], [0, 0, 1], [1e-300, 1, 1e300]])
def test_coincident_centroids_and_odd_weights_still_split(dim, weights):
    assert set(sides_of(cloud(np.ones((3, dim)), weights)).tolist()) == {0, 1}
    spread = np.eye(3)[:, :dim]
    assert set(sides_of(cloud(spread, weights)).tolist()) == {0, 1}


def test_one_node_is_side_zero():
    assert sides_of(cloud(np.ones((1, 2)))).tolist() == [0]


@pytest.mark.parametrize("dim", [2, 3])
def test_a_level_is_its_blocks(dim):
    rng = np.random.default_rng(7)
    sizes = [1, 2000, 2, 3, 16, 1, 500, 2]
    pieces = [rng.random((size, dim)) * 10.0 ** rng.integers(-6, 6) for size in sizes]
    level = cloud(np.concatenate(pieces), rng.random(sum(sizes)) + 0.1, sizes)
    together = sides_of(level)
    assert together.dtype == np.int64
    np.testing.assert_array_equal(
        together, np.concatenate([sides_of(level[b]) for b in range(level.n_blocks)])
    )
    turned = np.arange(level.n_blocks)[::-1]
    order = np.concatenate([np.arange(level.offsets[b], level.offsets[b + 1]) for b in turned])
    np.testing.assert_array_equal(sides_of(level.take(turned)), together[order])


# --- k-way ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sample", ["voronoi:n=400,seed=3", "boxes:6"])
def test_partition_covers_the_graph_with_compact_parts(sample):
    graph, k = agglo.samples.from_spec(sample).graph, 20
    labels = KMeans().partition(graph, Target(parts=k), 0)
    assert labels.shape == (graph.n,)
    assert labels.min() >= 0
    assert labels.max() < k
    assert len(np.unique(labels)) == k
    measures = np.bincount(labels, graph.measures)
    assert measures.max() / measures.mean() < 2
    rough = KMeans(iterations=0).partition(graph, Target(parts=k), 0)
    assert within(graph, labels) < within(graph, rough)


def within(graph, labels):
    used, number = np.unique(labels, return_inverse=True)
    total = np.bincount(number, graph.weights)
    means = np.stack([np.bincount(number, graph.weights * x) / total for x in graph.centroids.T], axis=1)
    assert len(used) == len(total)
    return float((graph.weights[:, None] * (graph.centroids - means[number]) ** 2).sum())


def test_partition_without_weights_and_to_the_last_cell():
    graph = cloud(np.random.default_rng(0).random((12, 2)), np.zeros(12))
    assert 1 < len(np.unique(KMeans().partition(graph, Target(parts=4), 0))) <= 4
    spread = cloud(grid(4, 3))
    assert len(np.unique(KMeans().partition(spread, Target(parts=12), 0))) == 12
    assert set(KMeans().partition(spread, Target(parts=1), 0).tolist()) == {0}


@pytest.mark.parametrize("iterations", [-1, 1.5, "8", True, None])
def test_iterations_must_be_a_whole_number(iterations):
    with pytest.raises(OptionError, match="iterations"):
        KMeans(iterations=iterations)


def test_large_pieces_are_cut_alike_wherever_they_lie():
    """Pieces of which a sample serves, which is of the same cells whatever their numbers and the axes."""
    mesh, rng = agglo.samples.random_triangles(6000, seed=12), np.random.default_rng(2)
    order = rng.permutation(mesh.n_cells)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    moved = agglo.Mesh.from_polygons(
        mesh.points @ turn.T + 1000.0, [mesh.boundary_loops.vertices[3 * c : 3 * c + 3] for c in order]
    )
    assert mesh.n_cells > 8192
    one, two = (agglo.agglomerate(each, n_parts=8).levels[0] for each in (mesh, moved))
    assert len(np.unique(one[order] * 8 + two)) == 8


@pytest.mark.parametrize("spread", [True, False])
def test_large_pieces_are_halved_evenly(spread):
    """Whether a sample of the cells serves, or weights are alike in regions and all are needed."""
    rng = np.random.default_rng(4)
    points = rng.random((20_000, 2)) * [3.0, 1.0]
    weights = rng.uniform(0.5, 1.5, 20_000) if spread else np.where(points[:, 0] < 1.0, 1.0, 1.09)
    sides = sides_of(cloud(points, weights))
    bar = 0.5 * (points[sides == sides[points[:, 0].argmin()], 0].max() + 1.5)
    assert abs(np.bincount(sides, weights)[0] / weights.sum() - 0.5) < 0.02
    assert abs(bar - 1.5) < 0.05
