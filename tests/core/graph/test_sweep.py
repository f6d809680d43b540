"""Sweep rounding against a slow reference implementation, and the bisector along rotated principal axes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import agglo_core as agglo
from agglo_core import OptionError, samples
from agglo_core.graph.sweep import sweep
from agglo_core.split.straight_cuts import SweepBisection


def cost(graph, sides):
    """cut · √A (1/A₁ + 1/A₂) + max(15, 4 √n) (1 − B/T), from its definition."""
    owner = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    cut = graph.interface[sides[owner] != sides[graph.indices]].sum() / 2
    area = np.bincount(sides, graph.measures, minlength=2)
    mean = np.average(graph.centroids, axis=0, weights=graph.measures)
    between = 0.0
    for side in (0, 1):
        chosen = sides == side
        middle = np.average(graph.centroids[chosen], axis=0, weights=graph.measures[chosen])
        between += area[side] * ((middle - mean) ** 2).sum()
    total = (graph.measures[:, None] * (graph.centroids - mean) ** 2).sum()
    power = 1 - 1 / graph.dim
    return cut * area.sum() ** (1 - power) * (1 / area).sum() + max(15, 4 * np.sqrt(graph.n)) * (
        1 - between / total
    )


def thresholds(graph, score):
    shares = graph.measures / graph.measures.sum()
    mean = (shares * score).sum()
    reach = 2 * np.sqrt((shares * (score - mean) ** 2).sum())
    low, high = max(score.min(), mean - reach), min(score.max(), mean + reach)
    return low + (high - low) * np.arange(1, 32) / 32


def slow_sweep(graph, scores):
    """All thresholds of all columns, one partition at a time."""
    trials = [(score > t).astype(int) for score in scores.T for t in thresholds(graph, score)]
    return min(trials, key=lambda sides: cost(graph, sides))


@settings(max_examples=25, deadline=None)
@given(st.integers(6, 60), st.integers(1, 3), st.integers(0, 10**6))
def test_the_best_threshold_is_found(n, columns, seed):
    graph = samples.voronoi(n, seed).graph
    scores = np.random.default_rng(seed).standard_normal((n, columns))
    sides = sweep(graph, scores)
    assert set(sides.tolist()) == {0, 1}
    assert cost(graph, sides) == pytest.approx(cost(graph, slow_sweep(graph, scores)), rel=1e-7)


def test_the_best_threshold_is_found_in_space():
    graph = samples.boxes(4).graph
    scores = np.random.default_rng(3).standard_normal((graph.n, 2))
    assert cost(graph, sweep(graph, scores)) == pytest.approx(cost(graph, slow_sweep(graph, scores)))


def test_scores_count_only_by_their_order_up_to_scale_and_shift():
    graph = samples.voronoi(50, 1).graph
    score = np.random.default_rng(0).standard_normal(50)
    np.testing.assert_array_equal(sweep(graph, score), sweep(graph, 1e-3 * score + 0.25))


def test_one_sided_probabilities_are_rounded_to_two_sides():
    graph = samples.squares(4).graph
    probability = 0.9 + 1e-3 * graph.centroids[:, 0]
    np.testing.assert_array_equal(sweep(graph, probability), graph.centroids[:, 0] > 0)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_constant_scores_are_halved(n):
    sides = sweep(samples.strip(n).graph, np.full(n, 3.7))
    assert len(np.unique(sides)) == min(n, 2)


def test_cells_without_weight_still_leave_two_sides():
    strip = samples.strip(6).graph
    graph = agglo.Graph.from_arrays(strip.indptr, strip.indices, strip.centroids, weights=np.zeros(6))
    np.testing.assert_array_equal(sweep(graph, graph.centroids[:, 0]), [0, 0, 0, 1, 1, 1])


@pytest.mark.parametrize(
    ("scores", "words"),
    [
        (np.zeros(3), "scores must have shape"),
        (np.zeros((16, 0)), "scores must have shape"),
        (np.where(np.arange(16) == 5, np.nan, 0.0), "node 5 has nan"),
        (np.where(np.arange(16) == 2, np.inf, 0.0), "node 2 has inf"),
    ],
)
def test_bad_scores_are_refused(scores, words):
    with pytest.raises(OptionError, match=words):
        sweep(samples.squares(4).graph, scores)


@pytest.mark.parametrize("n", [16, 20, 24])
def test_squares_become_squares(n):
    mesh = samples.squares(n)
    labels = agglo.agglomerate(mesh, bisector="sweep", h_star=np.sqrt(2) / 4).levels[0]
    quality = agglo.quality(mesh, labels)
    assert labels.max() == 15
    np.testing.assert_allclose(quality["UF"], 1)
    np.testing.assert_allclose(quality["CR"], np.sqrt(0.5), atol=1e-4)


@pytest.mark.parametrize("angle", [0.1, 0.7, np.pi / 4, 2.0])
def test_turning_the_mesh_turns_the_cut(angle):
    points = np.random.default_rng(4).random((200, 2))
    mesh = samples.clouds.voronoi_mesh(points, "v")
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    loops = mesh.boundary_loops
    turned = agglo.Mesh.from_polygons(mesh.points @ turn * 7 + 3, (loops.loop_offsets, loops.vertices))
    seeds = np.zeros(1, np.uint64)
    one = SweepBisection().bisect_level(mesh.graph, seeds)
    other = SweepBisection().bisect_level(turned.graph, seeds)
    assert np.array_equal(one, other) or np.array_equal(one, 1 - other)


def test_cuts_cost_no_more_than_those_of_two_means():
    kmeans = agglo.plugins.default().build("bisector", "kmeans")
    seeds = np.zeros(1, np.uint64)
    for seed in range(10):
        graph = samples.random_triangles(60, seed).graph
        ours, theirs = (b.bisect_level(graph, seeds) for b in (SweepBisection(), kmeans))
        assert cost(graph, ours) <= 1.02 * cost(graph, theirs)


def test_edges_of_a_block_are_listed_once():
    from agglo_core.compiled.thresholds import edge_room, edges_of_block

    mesh = samples.voronoi(60, 3)
    graph = mesh.graph.split(agglo.agglomerate(mesh, n_parts=4).levels[0])[0]
    room = edge_room(graph.offsets, graph.indptr)
    matrix = graph.to_scipy().toarray()
    for start, stop in zip(graph.offsets[:-1], graph.offsets[1:], strict=True):
        count = edges_of_block(start, stop - start, graph.indptr, graph.indices, graph.interface, room)
        found = np.zeros((stop - start, stop - start))
        np.add.at(found, (room[0][:count], room[1][:count]), room[2][:count])
        np.testing.assert_array_equal(found, np.triu(matrix[start:stop, start:stop], 1))
