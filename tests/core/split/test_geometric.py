"""Geometric bisectors: exact halves, invariances, a level is its blocks, an obvious reference."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from agglo_core.graph import Graph
from agglo_core.graph.blocks import principal_frames, split_at_median
from agglo_core.split.geometric import CoordinateBisection, InertialBisection

BISECTORS = [CoordinateBisection(), InertialBisection()]


def cloud(centroids, weights=None, sizes=None):
    """Graph without edges: geometric bisectors look at centroids and weights alone."""
    n = len(centroids)
    graph = Graph.from_arrays(np.zeros(n + 1, int), [], centroids, weights=weights)
    return graph if sizes is None else graph.subgraph(np.arange(n), np.concatenate(([0], np.cumsum(sizes))))


def grid(*counts):
    return np.stack(np.meshgrid(*(np.arange(k) + 0.5 for k in counts), indexing="ij"), -1).reshape(
        -1, len(counts)
    )


def rotation(rng, dim):
    q = np.linalg.qr(rng.standard_normal((dim, dim)))[0]
    return q * np.sign(np.linalg.det(q))


def sides_of(bisector, graph):
    return bisector.bisect_level(graph, np.zeros(graph.n_blocks, np.uint64))


def same_split(a, b):
    return np.array_equal(a, b) or np.array_equal(a, 1 - b)


@pytest.mark.parametrize("bisector", BISECTORS)
@pytest.mark.parametrize("counts", [(8, 4), (4, 8), (7, 3), (6, 3, 2), (2, 5, 3)])
def test_boxes_are_cut_across_their_longest_side(bisector, counts):
    points = grid(*counts)
    sides = sides_of(bisector, cloud(points))
    longest = int(np.argmax(counts))
    if counts[longest] % 2 == 0:
        assert same_split(sides, (points[:, longest] > counts[longest] / 2).astype(int))
    low = points[sides == 0, longest], points[sides == 1, longest]
    gap = max(low[0].max(), low[1].max()) - min(low[0].max(), low[1].max())
    assert gap > 0
    assert abs(np.sum(sides == 0) - np.sum(sides == 1)) <= 1


@pytest.mark.parametrize("counts", [(8, 8), (16, 16), (4, 4, 4)])
@pytest.mark.parametrize("seed", range(5))
def test_inertial_halves_a_turned_square_and_cube_along_the_grid(counts, seed):
    rng = np.random.default_rng(seed)
    points = grid(*counts)
    sides = sides_of(InertialBisection(), cloud(points @ rotation(rng, len(counts)).T + 1e6))
    straight = [(points[:, k] > counts[k] / 2).astype(int) for k in range(len(counts))]
    assert any(same_split(sides, half) for half in straight)


def test_split_at_median_of_weights():
    graph = cloud(np.c_[np.arange(5.0), np.zeros(5)], weights=[1, 1, 1, 1, 4])
    x = graph.centroids
    assert split_at_median(graph, x[:, 0], x[:, 1:]).tolist() == [0, 0, 0, 0, 1]
    assert split_at_median(graph, -x[:, 0], x[:, 1:]).tolist() == [1, 1, 1, 1, 0]


def test_ties_are_broken_by_the_perpendicular_not_by_numbering():
    rng = np.random.default_rng(0)
    points = grid(3, 4)[:, ::-1] * [1.0, 0.5]  # 4 long, rows of 3: the median falls between rows
    points = np.r_[points, [[2.0, 5.0]]]
    whole = cloud(points)
    expected = split_at_median(whole, whole.centroids[:, 0], whole.centroids[:, 1:])
    for _ in range(5):
        order = rng.permutation(len(points))
        graph = cloud(points[order])
        noisy = graph.centroids[:, 0] + 1e-12 * rng.standard_normal(graph.n)
        sides = split_at_median(graph, noisy, graph.centroids[:, 1:])
        expected = split_at_median(
            cloud(points), cloud(points).centroids[:, 0], cloud(points).centroids[:, 1:]
        )
        assert np.array_equal(sides, expected[order])


@pytest.mark.parametrize("bisector", BISECTORS)
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("weights", [[1, 1, 1], [0, 0, 0], [1, 0, 0], [0, 0, 1], [1e-300, 1, 1e300]])
def test_coincident_centroids_and_odd_weights_still_split(bisector, dim, weights):
    sides = sides_of(bisector, cloud(np.ones((3, dim)), weights=weights))
    assert set(sides.tolist()) == {0, 1}


@pytest.mark.parametrize("bisector", BISECTORS)
def test_one_node_is_side_zero(bisector):
    assert sides_of(bisector, cloud(np.ones((1, 2)))).tolist() == [0]


def obvious_median(projection, weights):
    """Cut of the sorted nodes that leaves the least difference of weight."""
    order = np.argsort(projection)
    cuts = [abs(weights[order[:m]].sum() - weights[order[m:]].sum()) for m in range(1, len(order))]
    sides = np.ones(len(order), int)
    sides[order[: int(np.argmin(cuts)) + 1]] = 0
    return sides


@settings(max_examples=25, deadline=None)
@given(st.integers(2, 40), st.integers(0, 2**32 - 1))
def test_median_against_an_obvious_reference(n, seed):
    rng = np.random.default_rng(seed)
    graph = cloud(rng.random((n, 2)), weights=rng.random(n) + 0.01)
    sides = split_at_median(graph, graph.centroids[:, 0], graph.centroids[:, 1:])
    assert np.array_equal(sides, obvious_median(graph.centroids[:, 0], graph.weights))


@settings(max_examples=25, deadline=None)
@given(st.integers(2, 60), st.sampled_from([2, 3]), st.integers(0, 2**32 - 1))
def test_inertial_follows_the_mesh(n, dim, seed):
    """Renumbering, rotation, shift and scale change nothing but the names of the sides."""
    rng = np.random.default_rng(seed)
    points, weights = rng.random((n, dim)) * np.arange(1, dim + 1), rng.random(n) + 0.5
    order = rng.permutation(n)
    moved = (points @ rotation(rng, dim).T * 10.0 ** rng.integers(-6, 6))[order]
    sides = sides_of(InertialBisection(), cloud(points, weights))
    assert same_split(sides_of(InertialBisection(), cloud(moved, weights[order])), sides[order])


@settings(max_examples=25, deadline=None)
@given(st.integers(2, 60), st.sampled_from([2, 3]), st.integers(0, 2**32 - 1))
def test_principal_frames_are_orthonormal_and_ordered(n, dim, seed):
    rng = np.random.default_rng(seed)
    graph = cloud(rng.random((n, dim)), rng.random(n) + 0.1)
    frames, coordinates = principal_frames(graph)
    assert np.allclose(frames[0] @ frames[0].T, np.eye(dim), atol=1e-12)
    weights = graph.weights / graph.weights.sum()
    assert np.allclose(weights @ coordinates, 0, atol=1e-9)
    assert np.allclose((graph.centroids - weights @ graph.centroids) @ frames[0].T, coordinates, atol=1e-9)
    seconds = weights @ coordinates**2
    assert (np.diff(seconds) <= 1e-12).all()
    eigenvalues = np.linalg.eigvalsh(
        (graph.centroids - weights @ graph.centroids).T
        * weights
        @ (graph.centroids - weights @ graph.centroids)
    )[::-1]
    if eigenvalues[1] < 0.9 * eigenvalues[0]:
        assert np.isclose(seconds[0], eigenvalues[0])


@pytest.mark.parametrize("bisector", BISECTORS)
@pytest.mark.parametrize("dim", [2, 3])
def test_a_level_is_its_blocks(bisector, dim):
    rng = np.random.default_rng(7)
    sizes = [1, 2000, 2, 3, 16, 1, 500, 2]
    points = np.concatenate(
        [
            rng.random((size, dim)) * 10.0 ** rng.integers(-8, 8) if size != 16 else grid(4, 2, 2)[:, :dim]
            for size in sizes
        ]
    )
    level = cloud(points, 10.0 ** rng.integers(-9, 9, len(points)), sizes)
    together = sides_of(bisector, level)
    apart = np.concatenate([sides_of(bisector, level[b]) for b in range(level.n_blocks)])
    assert np.array_equal(together, apart)
    assert together.dtype == np.int64
