"""The model in space: moments and frames, exact forward, cuts that obey geometry, weights, training."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import agglo_core as agglo
from agglo_core import Graph, OptionError, samples
from agglo_core.arrays import frozen_float
from agglo_core.split.straight_cuts import SweepBisection
from agglo_gnn.plane.fast import FastGNN
from agglo_gnn.space.kernels import PRIOR, directions
from agglo_gnn.space.moments import describe_solids
from agglo_gnn.space.network import SPATIAL_FEATURES, SPATIAL_SHAPES, initial_spatial, spatial_network
from agglo_gnn.space.pieces import solid_graphs
from agglo_gnn.training.cut_costs import cut_costs

pytestmark = pytest.mark.slow  # the kernels take a quarter of a minute to compile

PAIRS = [(0, 1, 2), (0, 2, 1), (1, 2, 0), (1, 0, 2), (2, 0, 1), (2, 1, 0)]


def sides_of(graph, bisector=None):
    return (bisector or FastGNN()).bisect_level(graph, np.zeros(graph.n_blocks, np.uint64))


def arrays(seed):
    rng = np.random.default_rng(seed)
    return {key: 0.3 * rng.standard_normal(shape) for key, shape in SPATIAL_SHAPES.items()}


def described(level):
    return describe_solids(level.offsets, level.centroids, level.weights, level.measures)


def rotation(seed):
    turn = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    return turn * np.linalg.det(turn)


def same_cut(one, other):
    return np.array_equal(one, other) or np.array_equal(one, 1 - other)


@pytest.fixture(scope="module")
def level() -> Graph:
    """Pieces of a mesh of Voronoi cells."""
    mesh = samples.voronoi3d(400, 3)
    return mesh.graph.split(agglo.agglomerate(mesh, n_parts=5).levels[0])[0]


def test_moments_are_those_along_the_frame(level):
    even, odd, frames, moments, cells, shares, sections = described(level)
    for b in range(level.n_blocks):
        rows = slice(level.offsets[b], level.offsets[b + 1])
        x, w = cells[rows] @ frames[b].T, shares[rows]
        second = np.einsum("n,ni,nj->ij", w, x, x)
        third = np.einsum("n,ni,nj,nk->ijk", w, x, x, x)
        fourth = np.einsum("n,ni,nj,nk,nl->ijkl", w, x, x, x, x)
        expected = np.concatenate([each.ravel() for each in (second, third, fourth)])
        np.testing.assert_allclose(moments[b], expected, atol=1e-12)
        np.testing.assert_allclose(frames[b] @ frames[b].T, np.eye(3), atol=1e-12)
        assert np.trace(second) == pytest.approx(3)
        assert sections[b] == pytest.approx(level.measures[rows].sum() ** (-2 / 3))
        for at, (i, j, k) in enumerate(PAIRS):
            t, f = third, fourth
            np.testing.assert_allclose(even[b, at, :6], [*np.diag(second)[[i, j, k]], *_fourths(f, i, j, k)])
            mixed = [f[i, i, j, j], f[i, i, k, k], f[j, j, k, k]]
            products = [t[i, i, i] ** 2, t[i, i, i] * t[i, j, j], t[i, i, i] * t[i, k, k]]
            squares = [t[j, j, j] ** 2, t[i, i, j] ** 2, t[i, i, k] ** 2]
            np.testing.assert_allclose(even[b, at, 6:15], [*mixed, *products, *squares], atol=1e-12)
            assert even[b, at, 15] == pytest.approx(3 / np.cbrt(len(w)))
            tilts = [second[i, j], f[i, i, i, j], f[i, j, j, j], f[i, j, k, k], t[i, i, i] * t[i, i, j]]
            tilts += [t[i, j, j] * t[i, i, j], t[i, j, j] * t[j, j, j], t[i, i, i] * t[j, j, j]]
            tilts += [t[i, k, k] * t[j, k, k], t[i, j, k] * t[k, k, k]]
            np.testing.assert_allclose(odd[b, at], tilts, atol=1e-12)
    assert len(SPATIAL_FEATURES) == even.shape[2] + odd.shape[2]


def _fourths(fourth, *axes):
    return [fourth[i, i, i, i] / 3 for i in axes]


def test_axes_of_a_turned_cube_are_its_edges():
    mesh = samples.boxes(6)
    turn = rotation(2)
    frame = described(replace(mesh, points=mesh.points @ turn.T).graph)[2][0]
    np.testing.assert_allclose(np.sort(np.abs(frame @ turn), axis=1), np.sort(np.eye(3), axis=1), atol=1e-8)


def slow_directions(even, odd, frame, net):
    """The network, written out pair by pair."""
    weight1, bias1, weight2, bias2 = net
    scores, found = PRIOR * even[::2, 0], frame.copy()
    for at, (i, j, _) in enumerate(PAIRS):
        out = np.maximum(even[at] @ weight1 + bias1, 0) @ weight2 + bias2
        scores[i] += out[0]
        found[i] += (out[1:] @ odd[at]) * frame[j]
    return scores, found


def test_the_kernel_is_the_network(level):
    even, odd, frames, _, cells, shares, _ = described(level)
    net = tuple(frozen_float(values) for values in arrays(1).values())
    for b in range(level.n_blocks):
        rows = slice(level.offsets[b], level.offsets[b + 1])
        local = np.ascontiguousarray(cells[rows].T)
        scores, found = directions(local.shape[1], local, shares[rows], 3.0, net)
        expected = slow_directions(even[b], odd[b], frames[b], net)
        np.testing.assert_allclose(scores, expected[0], rtol=1e-9)
        np.testing.assert_allclose(found, expected[1], atol=1e-9)


def test_the_network_in_torch_is_the_same(level):
    torch = pytest.importorskip("torch")
    even, odd, frames = described(level)[:3]
    values = arrays(2)
    tensors = [torch.tensor(each) for each in (even, odd, frames)]
    scores, found = spatial_network({key: torch.tensor(value) for key, value in values.items()}, *tensors)
    for b in range(level.n_blocks):
        expected = slow_directions(even[b], odd[b], frames[b], tuple(values.values()))
        np.testing.assert_allclose(scores[b], expected[0], rtol=1e-9)
        np.testing.assert_allclose(found[b], expected[1], atol=1e-9)


def slow_cost(graph, sides):
    """cut · ∛V (1/V₁ + 1/V₂) + max(15, 4 √n) (1 − B/T)."""
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    cut = graph.interface[sides[rows] != sides[graph.indices]].sum() / 2
    volume, mean = np.bincount(sides, graph.measures), graph.measures @ graph.centroids / graph.measures.sum()
    means = np.stack([np.bincount(sides, graph.measures * x) / volume for x in graph.centroids.T], axis=1)
    within = graph.measures @ ((graph.centroids - means[sides]) ** 2).sum(axis=1)
    total = graph.measures @ ((graph.centroids - mean) ** 2).sum(axis=1)
    return cut * np.cbrt(volume.sum()) * (1 / volume).sum() + max(15, 4 * np.sqrt(graph.n)) * within / total


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("n", [25, 80, 500])
def test_the_cheapest_threshold_near_the_mean_is_taken(n, seed):
    graph = samples.voronoi3d(n, seed).graph
    even, odd, frames, _, cells, shares, _ = described(graph)
    scores, found = slow_directions(even[0], odd[0], frames[0], FastGNN().net(3))
    costs = []
    for row in found[scores >= scores.max() - (0.5 if n >= 40 else np.inf)]:
        heights = cells @ row
        band = max(0.45, 3 / np.cbrt(n)) * np.sqrt(shares @ heights**2)
        for threshold in np.linspace(-band, band, 33)[1:-1]:
            sides = (heights > threshold).astype(np.int64)
            if 0 < sides.sum() < n:
                costs.append(slow_cost(graph, sides))
    assert slow_cost(graph, sides_of(graph)) == pytest.approx(min(costs), rel=1e-9)


@pytest.mark.parametrize(("n", "seed"), [(12, 1), (60, 2), (400, 1)])
def test_turning_scaling_shifting_and_renumbering_change_nothing(n, seed):
    mesh = samples.voronoi3d(n, 5)
    sides = sides_of(mesh.graph)
    moved = replace(mesh, points=40.0 * mesh.points @ rotation(seed).T + 1e3)
    assert same_cut(sides, sides_of(moved.graph))
    order = np.random.default_rng(seed).permutation(n)
    assert same_cut(sides[order], sides_of(mesh.graph.subgraph(order, [0, n])))


@pytest.mark.parametrize("mesh", [samples.boxes(8), samples.tetrahedra(6)])
def test_cubes_become_cubes(mesh):
    labels = agglo.agglomerate(mesh, bisector="gnn", h_star=np.sqrt(3) / 2).levels[0]
    assert labels.max() == 7
    np.testing.assert_allclose(agglo.quality(mesh, labels, metrics=("UF",))["UF"], 1)
    np.testing.assert_allclose(np.bincount(labels, mesh.cell_measures), 1 / 8)


def test_both_sides_are_there_whatever_the_weights_say():
    pieces = list(solid_graphs(np.random.default_rng(8), 200))
    for bisector in (FastGNN(), FastGNN(arrays(3)), FastGNN({k: 0 * v for k, v in arrays(0).items()})):
        for graph in pieces:
            ones = np.add.reduceat(sides_of(graph, bisector), graph.offsets[:-1])
            assert ((ones > 0) & (ones < np.diff(graph.offsets))).all()


def test_what_was_learned_cuts_cheaper_than_axes_and_than_seven_directions():
    costs = {"learned": [], "untrained": [], "sweep": []}
    tools = {"learned": FastGNN(), "untrained": FastGNN(initial_spatial(0)), "sweep": SweepBisection()}
    for graph in solid_graphs(np.random.default_rng(4), 900):
        large = graph.take(np.flatnonzero(np.diff(graph.offsets) >= 100))
        for key, tool in tools.items():
            if large.n_blocks:
                costs[key].append(cut_costs(large, sides_of(large, tool)))
    means = {key: np.concatenate(values).mean() for key, values in costs.items()}
    assert means["learned"] < 0.995 * means["untrained"]
    assert means["learned"] < 0.995 * means["sweep"]


def test_weights_serve_one_dimension():
    plane, space = samples.squares(4).graph, samples.boxes(3).graph
    assert set(sides_of(space, FastGNN(arrays(1)))) == {0, 1}
    with pytest.raises(OptionError, match="for 3-D meshes, given a 2-D one"):
        sides_of(plane, FastGNN(arrays(1)))
    with pytest.raises(OptionError, match="these names and shapes"):
        FastGNN(arrays(1) | {"dense1.bias": np.zeros(3)})


def test_looking_ahead_is_for_the_plane():
    with pytest.raises(OptionError, match="lookahead works in 2-D only"):
        agglo.agglomerate(samples.boxes(4), bisector=("gnn", {"lookahead": 3}), h_factor=2.0)


def test_training_repeats_itself_and_starts_from_the_longest_axis():
    pytest.importorskip("torch")
    from agglo_gnn.space.train import train_solids

    one, metrics = train_solids(5, steps=4, pieces=60, validation=40)
    two, _ = train_solids(5, steps=4, pieces=60, validation=40)
    assert {key: value.shape for key, value in one.items()} == dict(SPATIAL_SHAPES)
    for key in one:
        np.testing.assert_array_equal(one[key], two[key])
    assert 0.8 < metrics["ratio"] < 1.1
    np.testing.assert_array_equal(initial_spatial(5)["dense2.weight"], 0)
    with pytest.raises(OptionError, match="1 or more"):
        train_solids(0, steps=0)
